"""Practice: lanes seen exactly and lanes seen by a camera, side by side."""

import gymnasium as gym
import numpy as np
import pytest

from agents.learning.config import DQNConfig, PPOConfig
from agents.learning.practice import PRACTISED, SideBySide, make_practice
from agents.vec_env import SurfaceVecEnv
from surface_gym.randomisation import Randomisation
from surface_gym.registration import env_id
from surface_gym.sensors import Camera, Exact
from surface_gym.tasks import TASKS


def lanes(count: int, **kwargs: object) -> SurfaceVecEnv:
    return SurfaceVecEnv(
        gym.make_vec(
            "SmartSurface/Slow-v0",
            num_envs=count,
            actions="halves",
            autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
            **kwargs,
        )
    )


def test_lanes_side_by_side_are_those_apart() -> None:
    together = SideBySide([lanes(3), lanes(2, sensors=Camera())])
    apart = [lanes(3), lanes(2, sensors=Camera())]
    together.seed(10)
    apart[0].seed(10)
    apart[1].seed(13)
    first = together.reset()
    np.testing.assert_array_equal(first, np.concatenate([each.reset() for each in apart]))
    rng = np.random.default_rng(0)
    for _ in range(60):
        actions = rng.integers(0, 16, 5)
        observations, rewards, dones, infos = together.step(actions)
        parts = [each.step(some) for each, some in zip(apart, np.split(actions, [3]), strict=True)]
        np.testing.assert_array_equal(observations, np.concatenate([part[0] for part in parts]))
        np.testing.assert_array_equal(rewards, np.concatenate([part[1] for part in parts]))
        np.testing.assert_array_equal(dones, np.concatenate([part[2] for part in parts]))
        assert [bool(info) for info in infos] == dones.tolist()
    assert together.get_attr("num_envs", [0, 4]) == [3, 2]
    assert together.env_is_wrapped(gym.Wrapper, [1]) == [False]


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("task", TASKS)
def test_the_share_that_is_seen_by_a_camera(task: str, share: float) -> None:
    config = PPOConfig(task=task, lanes=8, batch_size=64, camera_share=share)
    practice = make_practice(config)
    assert practice.num_envs == 8
    of_each = practice.get_attr("settings")
    exact = [settings.sensors == Exact() for settings in of_each]
    assert exact == [True] * round(8 * (1 - share)) + [False] * round(8 * share)
    for settings, sees_all in zip(of_each, exact, strict=True):
        assert settings.randomisation == (Randomisation() if sees_all else Randomisation(0.2))
        assert settings.chosen_task == PRACTISED.get(task, TASKS[task]())
    assert practice.observation_space == gym.make(env_id(task), actions="halves").observation_space


def test_half_of_the_lanes_seen_exactly_are_on_zones_of_other_lengths() -> None:
    config = PPOConfig(task="slow", lanes=32, batch_size=64, camera_share=0.5, zones=(8, 24))
    of_each = make_practice(config).get_attr("settings")
    columns = [settings.chosen_plant.zone_columns for settings in of_each]
    assert columns == [16] * 8 + [8] * 4 + [24] * 4 + [16] * 16
    behind = {each.chosen_plant.columns - each.chosen_plant.zone_columns for each in of_each}
    assert len(behind) == 1


def test_sort_is_practised_in_a_mirror() -> None:
    """The same actions sort to either side."""
    practice = make_practice(DQNConfig(lanes=64, camera_share=0.0))
    practice.seed(0)
    practice.reset()
    sides = set()
    for _ in range(60):
        _, _, dones, infos = practice.step(np.full(64, 10))  # all axes at -45 deg
        for lane in np.nonzero(dones)[0]:
            if infos[lane]["is_success"]:
                sides.add(float(infos[lane]["terminal_observation"][-1]))
            assert infos[lane]["outcome"] != "wrong side"
    assert sides == {-1.0, 1.0}
