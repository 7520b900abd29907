"""The package as a whole: what importing it brings, its names, pickles and copies."""

import copy
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import ENV_TASKS
from surface_gym.registration import PERIODS
from surface_gym.tasks import TASKS
from tests.environments import IDS, every_id

HEAVY = {
    "torch", "pygame", "matplotlib", "stable_baselines3", "mujoco", "rich", "tyro", "pandas", "ray",
}  # fmt: skip
SIMULATE = (
    "import surface_gym as sg\n"
    "sg.simulate(sg.layouts.sorting(), sg.layouts.box('S'), (1.0, 1.0, 0.0), duration=0.1)"
)
HELP = (
    "from surface_gym.agents.train_cli import main\ntry: main(['--help'])\nexcept SystemExit: pass"
)


@pytest.mark.parametrize(
    ("program", "most", "needed"),
    [
        ("import surface_gym", 3, set()),
        (SIMULATE, 65, set()),
        (HELP, 20, {"tyro", "rich"}),
    ],
    ids=["import", "simulate", "train --help"],
)
def test_few_modules_are_loaded_and_none_that_is_not_needed(
    program: str, most: int, needed: set[str]
) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"{program}\nimport sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = done.stdout.splitlines()[-1].split()
    assert set(loaded) & HEAVY <= needed
    assert sum(name.startswith("surface_gym") for name in loaded) <= most


def test_every_public_name_is_there() -> None:
    assert set(sg.__all__) <= set(dir(sg))
    assert all(hasattr(sg, name) for name in sg.__all__)
    assert callable(sg.simulate)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = sg.nothing


SURFACE = sg.layouts.sorting("B", tilt=0.1)
PARCELS = [
    sg.layouts.box("S"),
    sg.Parcel(sg.Disc(0.2), mass=3.0, com_offset=(0.01, 0.02)),
    sg.Parcel(sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.0, 0.3)]), inertia=0.2),
]


def by_pickle(value: object) -> object:
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize("twin", [by_pickle, copy.deepcopy, copy.copy])
@pytest.mark.parametrize("used", [False, True], ids=["new", "after a run"])
@pytest.mark.parametrize("parcel", PARCELS, ids=["rectangle", "disc", "polygon"])
def test_twins_simulate_the_same(twin: object, used: bool, parcel: sg.Parcel) -> None:
    surface = twin(SURFACE) if used else SURFACE
    first = sg.simulate(surface, parcel, (1.0, 1.0, 0.3), (1.0, 0.2, -0.5), 0.3)
    second = sg.simulate(twin(surface), twin(parcel), (1.0, 1.0, 0.3), (1.0, 0.2, -0.5), 0.3)
    assert first.pose.tobytes() == second.pose.tobytes()
    assert first.velocity.tobytes() == second.velocity.tobytes()


@pytest.mark.parametrize("twin", [by_pickle, copy.deepcopy])
def test_twins_have_the_same_fields(twin: object) -> None:
    surface = twin(SURFACE)
    np.testing.assert_array_equal(surface.axis, SURFACE.axis)
    np.testing.assert_array_equal(surface.rotor, SURFACE.rotor)
    assert (surface.tilt, surface.pitch, surface.origin) == (0.1, SURFACE.pitch, SURFACE.origin)
    run = sg.simulate(SURFACE, PARCELS[0], (1.0, 1.0, 0.0), duration=0.1)
    same = twin(run)
    assert same.end == run.end
    for field in ("time", "pose", "velocity", "tipping"):
        np.testing.assert_array_equal(getattr(same, field), getattr(run, field))


@pytest.mark.parametrize("twin", [by_pickle, copy.deepcopy, copy.copy])
def test_twins_are_read_only_too(twin: object) -> None:
    surface, polygon = twin(SURFACE), twin(PARCELS[2].base)
    for array in (surface.axis, surface.rotor, polygon.vertices):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = True


def test_every_task_has_its_id() -> None:
    assert [f"SmartSurface/{name.capitalize()}-v0" for name in sorted(TASKS)] == IDS
    limits = {name: None if name == "flow" else kind.periods for name, kind in ENV_TASKS.items()}
    assert list(limits.items()) == list(PERIODS.items())


@every_id
def test_an_id_makes_its_task(env_id: str) -> None:
    env = gym.make(env_id)
    assert type(env.unwrapped) is sg.SmartSurfaceEnv
    assert type(env.unwrapped.config.task) is TASKS[env_id[13:-3].lower()]


@every_id
def test_an_id_limits_episodes_of_both_environments(env_id: str) -> None:
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
