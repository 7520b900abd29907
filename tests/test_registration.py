"""The ids that Gymnasium knows."""

import subprocess
import sys

import gymnasium as gym

import surface_gym as sg
from surface_gym.tasks import TASKS
from tests.environments import IDS, every_id


def test_every_task_has_its_id() -> None:
    assert [f"SmartSurface/{name.capitalize()}-v0" for name in sorted(TASKS)] == IDS


@every_id
def test_an_id_makes_its_task(env_id: str) -> None:
    env = gym.make(env_id)
    assert type(env.unwrapped) is sg.SmartSurfaceEnv
    assert type(env.unwrapped.config.task) is TASKS[env_id[13:-3].lower()]


@every_id
def test_an_id_limits_episodes_for_both_faces(env_id: str) -> None:
    limit = gym.spec(env_id).max_episode_steps
    assert limit is not None
    assert gym.make(env_id).spec.max_episode_steps == limit
    assert gym.make_vec(env_id, num_envs=2).spec.max_episode_steps == limit


def test_the_module_may_be_named_in_the_id() -> None:
    code = (
        "import gymnasium as gym\n"
        "env = gym.make('surface_gym:SmartSurface/Sort-v0')\n"
        "vector = gym.make_vec('surface_gym:SmartSurface/Sort-v0', num_envs=2)\n"
        "print(type(env.unwrapped).__name__, type(vector).__name__)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["SmartSurfaceEnv", "SmartSurfaceVectorEnv"]
