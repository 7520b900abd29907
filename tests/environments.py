"""The environments the tests loop over: every id, kind of action and kind of sensor."""

import copy
import gc
import os
import pickle
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import ArrayLike

import surface_gym as sg
from surface_gym import actions, registration, sensors
from surface_gym.config import REWARD, EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.env import make_batch
from surface_gym.parcel import Base
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.tasks.start import Start

STREAMS = tuple(name for name, periods in registration.PERIODS.items() if periods is None)
ON_SLOPES = tuple(name for name in STREAMS if registration.TASKS[name].takes_away)
FLOW = registration.env_id(registration.DEFAULT_STREAM)
# Tasks of one parcel; streams have tests of their own.
LATER = registration.env_id("park")  # comes last, so that the others' cells stay as they were
IDS = sorted(
    map(registration.env_id, {*registration.SHIPPED}.difference(STREAMS)),
    key=lambda env_id: (env_id == LATER, env_id),
)
ACTIONS = tuple(actions.KINDS)
SENSORS = sensors.KINDS
SORT = "SmartSurface/Sort-v0"

every_id = pytest.mark.parametrize("env_id", IDS)
every_kind_of_action = pytest.mark.parametrize("actions", ACTIONS)
every_sensor = pytest.mark.parametrize("sensor", SENSORS, ids=lambda kind: kind.__name__)

# Code is compiled for each id, kind of action and kind of sensor together, which takes seconds.
# These hold every pair of the three once. By day each id and each kind of action is tried at least
# once, Slow with a sensor that learns and the others with exact sensors; other sensors are tried
# where everything varies. All pairs are tried at night.
LEARNING = "SmartSurface/Slow-v0", "halves"
CELLS = [
    (env_id, actions, SENSORS[(row + column) % len(SENSORS)])
    for row, env_id in enumerate(IDS)
    for column, actions in enumerate(ACTIONS)
]
CELLS_BY_DAY = [
    each
    for each in CELLS
    if each[:2] == LEARNING or (each[2] is sensors.Exact and each[0] != LEARNING[0])
]
every_cell = pytest.mark.parametrize(
    ("env_id", "actions", "sensor"),
    [
        pytest.param(
            *cell,
            id=f"{cell[0]}-{cell[1]}-{cell[2].__name__}",
            marks=() if cell in CELLS_BY_DAY else pytest.mark.nightly,
        )
        for cell in CELLS
    ],
)

PITCH, ORIGIN = 0.1, 0.05  # [m] between elements of the tasks' lines, and of the first

# Choices of the default orientations, by the angle of the axis.
ROLL, MINUS_45, PLUS_45 = 3, 2, 1

# Starts that every reset option of a task fixes together.
OPTIONS: dict[str, dict[str, Any]] = {
    "SmartSurface/Sort-v0": {"speed": 1.3, "parcel": "B", "side": -1},
    "SmartSurface/Slow-v0": {"speed": 1.3, "parcel": "B", "ratio": 0.4},
    "SmartSurface/Stop-v0": {"speed": 1.3, "parcel": "B", "position": 1.2},
    "SmartSurface/Track-v0": {
        "speed": 0.7, "parcel": "B", "path": ((0.5, 1.0), (2.0, 1.3), (4.0, 1.0)), "tilt": 0.2,
    },
    "SmartSurface/Orient-v0": {"speed": 1.3, "parcel": "B", "angle": 0.5},
    "SmartSurface/Park-v0": {
        "speed": 1.3, "parcel": "B", "ahead": 0.7, "aside": 0.1, "angle": 0.3,
    },
}  # fmt: skip

# Parcels of every kind of base.
TRIANGLE = sg.Parcel(sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.1, 0.3)]), com_offset=(0.01, -0.01))
HEPTAGON = sg.Parcel(
    sg.Polygon(0.15 * np.stack([f(np.arange(7) * 2 * np.pi / 7) for f in (np.cos, np.sin)], -1))
)
PARCELS = {
    "S": sg.layouts.box("S"),
    "long": sg.Parcel(sg.Rectangle(0.5, 0.3), mass=2.0),
    "disc": sg.Parcel(sg.Disc(0.16), com_height=0.2),
    "triangle": TRIANGLE,
    "heptagon": HEPTAGON,
}


def bare(env_id: str = SORT, **settings: Any) -> sg.SmartSurfaceEnv:
    """The environment of an id without Gymnasium's wrappers, so without a time limit."""
    return gym.make(env_id, disable_env_checker=True, **settings).unwrapped


def cell(env_id: str, actions: str) -> dict[str, Any]:
    """A kind of action and the sensor that an id has with it in CELLS."""
    (sensor,) = (each[2] for each in CELLS if each[:2] == (env_id, actions))
    return {"actions": actions, "sensors": sensor()}


def same_choice(env: sg.SmartSurfaceEnv, choice: int) -> Any:
    """The action that sets every module it reaches to one orientation."""
    kind = env.config.action_kind
    return kind.encode(np.full((1, kind.size), choice))[0]


def terms(info: dict[str, Any]) -> dict[str, Any]:
    """The terms of a reward by their names, of one environment or of many."""
    return {n.removeprefix(REWARD): value for n, value in info.items() if n.startswith(REWARD)}


Step = tuple[np.ndarray, float, bool, bool, dict[str, Any]]


def played_out(env: gym.Env, action: Any, **options: Any) -> list[Step]:
    """Every step of an episode of one action, begun with some options."""
    env.reset(seed=0, options=options)
    played = [env.step(action)]
    while not played[-1][2]:
        played.append(env.step(action))
    return played


def steps(env: gym.Env, seed: int, episodes: int = 1, longest: int = 200) -> Iterator[Step]:
    """Every step of some episodes of random actions."""
    env.action_space.seed(seed)
    env.reset(seed=seed)
    for _ in range(episodes):
        for _ in range(longest):
            step = env.step(env.action_space.sample())
            yield step
            if step[2] or step[3]:
                break
        env.reset()


def assert_same(first: Any, second: Any, place: str = "") -> None:
    """Equal to the bit, types included: arrays, tuples and dicts of them. nan equals nan."""
    assert type(first) is type(second), place
    if isinstance(first, dict):
        assert list(first) == list(second), place
        for name in first:
            assert_same(first[name], second[name], f"{place}[{name!r}]")
    elif isinstance(first, tuple):
        assert len(first) == len(second), place
        for number, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_same(one, other, f"{place}[{number}]")
    elif isinstance(first, np.ndarray) and first.dtype == object:
        assert_same(tuple(first), tuple(second), place)
    elif isinstance(first, np.ndarray):
        assert first.dtype == second.dtype, place
        np.testing.assert_array_equal(first, second, place)
    else:
        assert first == second or (first != first and second != second), place


def run_python(*arguments: str, folder: Path | None = None, **environment: str) -> str:
    """What Python prints in a process of its own; an error of it fails the test."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env={**os.environ, **environment},
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def outside(base: Base, pose: ArrayLike, x: Any, y: Any, about: Any = (0.0, 0.0)) -> np.ndarray:
    """The greatest F_lambda of Section 3.2 at points: at most 0 within a base.

    Args:
        base: base, of which the point `about` lies at the pose.
        pose: (3,) [m, m, rad].
        x: [m] of the points.
        y: [m] of the points.
        about: (2,) [m] in the base's own frame.
    """
    dx, dy = x - pose[0], y - pose[1]
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    own = cosine * dx + sine * dy + about[0], cosine * dy - sine * dx + about[1]
    return base.functions(*own).max(axis=0)


def growth(step: Callable[[], None], warm: int, steps: int) -> float:
    """[bytes] by which memory grows a step, after some."""
    tracemalloc.start()
    try:
        for _ in range(warm):
            step()
        gc.collect()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(steps):
            step()
        gc.collect()
        return (tracemalloc.get_traced_memory()[0] - before) / steps
    finally:
        tracemalloc.stop()


def by_pickle(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


TWINS = [by_pickle, copy.deepcopy]


def put(batch: Batch, start: Start, i: int = 0) -> None:
    chosen = np.array([i])
    batch.place(chosen, start)
    batch.begin(chosen)


def batch_with(start: Start, seed: int = 0, **settings: Any) -> Batch:
    """A batch of one environment on which a start was put; what it draws comes from the seed."""
    batch = Batch(EnvConfig(**settings), 1)
    batch.reset_cache.seed(0, np.random.default_rng(seed))
    put(batch, start)
    return batch


def begun(config: EnvConfig, num_envs: int = 1, seed: int = 0, options: Any = ()) -> Any:
    """A batch of environments that have begun, each by the next seed."""
    batch = make_batch(config, num_envs)
    for i in range(num_envs):
        batch.seed(i, np.random.default_rng(seed + i))
    batch.reset(np.arange(num_envs), options)
    return batch


def pair(make: Callable[..., Any] = bare, **settings: Any) -> tuple[Any, Any]:
    """Two equal environments that have begun and sample the same actions."""
    both = make(**settings), make(**settings)
    for env in both:
        env.reset(seed=0)
        env.action_space.seed(0)
    return both


NUM_ENVS = 3
LIMIT = 14  # control periods of an episode, so that some run out of time
every_mode = pytest.mark.parametrize("mode", AutoresetMode, ids=lambda mode: mode.name)
EVERYTHING_VARIES: dict[str, Any] = {
    "actuators": Actuators(axis_speed=8.0, stuck_share=0.1),
    "randomisation": Randomisation(
        friction=0.2, rolling=0.2, mass=0.2, size=0.05, com_offset=0.2, stiffness=0.3,
        lateral=0.01, heading=0.05,
    ),
}  # fmt: skip

PARCELS_VARY: dict[str, Any] = {
    "actions": "quadrants",
    "actuators": Actuators(axis_speed=8.0),
    "randomisation": Randomisation(size=0.05, friction=0.1),
}

# Each id and each kind of sensor, of which other code is compiled where axes turn: seconds each.
every_varying = pytest.mark.parametrize(
    ("env_id", "sensor"),
    [
        pytest.param(env_id, sensor, id=f"{env_id}-{sensor.__name__}")
        for env_id, sensor in [(name, SENSORS[-1]) for name in IDS]
        + [(SORT, sensor) for sensor in SENSORS[:-1]]
    ],
)


def native(env_id: str = SORT, num_envs: int = NUM_ENVS, **settings: Any) -> VectorEnv:
    return gym.make_vec(env_id, num_envs=num_envs, **settings)


def single_of(env_id: str, limit: int, settings: dict[str, Any]) -> gym.Env:
    return gym.make(env_id, max_episode_steps=limit, disable_env_checker=True, **settings)


def singles(
    env_id: str, mode: AutoresetMode, limit: int = LIMIT, num_envs: int = NUM_ENVS, **settings: Any
) -> SyncVectorEnv:
    make = partial(single_of, env_id, limit, settings)
    return SyncVectorEnv([make] * num_envs, autoreset_mode=mode)
