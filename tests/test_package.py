"""The package as a whole: what importing it brings, its names, pickles and copies."""

import copy
from dataclasses import fields

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym import registration
from surface_gym.cli import COMMANDS
from surface_gym.flow.base import StreamTask
from surface_gym.tasks import TASKS
from tests.environments import IDS, TWINS, every_id, run_python

HEAVY = {
    "torch", "pygame", "matplotlib", "stable_baselines3", "mujoco", "rich", "tyro", "pandas", "ray",
    "onnx", "optuna", "osqp", "scipy.optimize",
}  # fmt: skip
SIMULATE = (
    "import surface_gym as sg\n"
    "sg.simulate(sg.layouts.sorting(), sg.layouts.box('S'), (1.0, 1.0, 0.0), duration=0.1)"
)
HELP = "from surface_gym.cli import main\ntry: main([{!r}, '--help'])\nexcept SystemExit: pass"


@pytest.mark.parametrize(
    ("program", "said", "most", "needed"),
    [
        ("import surface_gym", "", 4, set()),
        (SIMULATE, "", 65, set()),
        *(
            # Options of `train` are those of algorithms, which ask tasks.
            (
                HELP.format(name), f"usage: surface-gym {name} [", 70 if name == "train" else 16,
                {"tyro", "rich"},
            )
            for name in COMMANDS
        ),
    ],
    ids=["import", "simulate", *COMMANDS],
)  # fmt: skip
def test_few_modules_are_loaded_and_none_that_is_not_needed(program, said, most, needed):
    printed = run_python("-W", "error", "-c", f"{program}\nimport sys; print(*sys.modules)")
    assert said in printed
    loaded = printed.splitlines()[-1].split()
    assert set(loaded) & HEAVY <= needed
    compiles = program in (SIMULATE, HELP.format("train"))
    assert compiles or "numba" not in loaded
    assert sum(name.startswith("surface_gym") for name in loaded) <= most


def test_every_public_name_is_there():
    assert set(sg.__all__) <= set(dir(sg))
    assert all(hasattr(sg, name) for name in sg.__all__)
    assert callable(sg.simulate)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = sg.nothing


SURFACE = sg.layouts.sorting("B", tilt=0.1)
PARCELS = {
    "rectangle": sg.layouts.box("S"),
    "disc": sg.Parcel(sg.Disc(0.2), mass=3.0, com_offset=(0.01, 0.02)),
    "polygon": sg.Parcel(sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.0, 0.3)]), inertia=0.2),
}


@pytest.mark.parametrize("twin", [*TWINS, copy.copy])
@pytest.mark.parametrize("kind", PARCELS)
def test_twins_are_alike(kind, twin):
    """They simulate the same, before and after a run, and are read-only too."""
    parcel, start = PARCELS[kind], ((1.0, 1.0, 0.3), (1.0, 0.2, -0.5), 0.3)
    run = sg.simulate(SURFACE, parcel, *start)
    surface, other = twin(SURFACE), twin(parcel)
    for same in (
        sg.simulate(surface, other, *start),
        sg.simulate(twin(surface), twin(other), *start),
        twin(run),
    ):
        assert same.end == run.end
        for name in ("time", "pose", "velocity", "tipping"):
            assert getattr(same, name).tobytes() == getattr(run, name).tobytes()
    for field in fields(SURFACE):
        np.testing.assert_array_equal(getattr(surface, field.name), getattr(SURFACE, field.name))
    for array in (surface.axis, surface.rotor, twin(PARCELS["polygon"].base).vertices):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = True


def test_every_task_has_its_id():
    assert sorted(f"SmartSurface/{name.capitalize()}-v0" for name in TASKS) == sorted(IDS)
    limits = {
        name: None if issubclass(kind, StreamTask) else kind.periods
        for name, kind in registration.TASKS.items()
        if name in registration.SHIPPED  # other tests register tasks of their own
    }
    assert list(limits.items()) == list(registration.PERIODS.items())


@every_id
def test_an_id_makes_its_task_and_limits_episodes(env_id):
    env, limit = gym.make(env_id), gym.spec(env_id).max_episode_steps
    assert type(env.unwrapped) is sg.SmartSurfaceEnv
    assert type(env.unwrapped.config.task) is TASKS[env_id[13:-3].lower()]
    assert limit is not None
    assert env.spec.max_episode_steps == limit
    assert gym.make_vec(env_id, num_envs=2).spec.max_episode_steps == limit
