"""What a physics step costs, and how long a first one takes."""

import os
import subprocess
import sys
import tempfile
import time

import numpy as np

import surface_gym as sg
from benchmarks.figure import Figure
from surface_gym.physics.rollout import run_implicit
from surface_gym.physics.types import STATE_SIZE, VX, X, Y, make_scratch

DT = 0.005  # [s]
REPEATS = 300

# What the project asks of itself.
MOST_STEP = {"S": 0.40, "B": 1.10}  # [us]
MOST_IMPORT = 0.6  # [s]
MOST_FIRST_STEP = 8.0  # [s] in an empty cache
MOST_FIRST_ENV = 8.0  # [s] the import included
MOST_CACHED = 1.0  # [s]
MOST_SIZE_RATIO = 1.10


def _step_time(
    surface: sg.Surface, size: str, y: float, speed: float, steps: int, dt: float
) -> float:
    """[us] a step, the median of repeated runs from the same start on one core."""
    parcel = sg.layouts.box(size)
    grid, body = surface.grid, parcel.body
    scratch = make_scratch()
    states = np.zeros((steps + 1, STATE_SIZE))
    reports = np.zeros(steps + 1, dtype=np.int64)
    states[0, [X, Y, VX]] = sg.layouts.start(size)[0], y, speed
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        done = run_implicit(grid, body, states, reports, scratch, dt)
        times.append((time.perf_counter() - begin) / done)
    return 1e6 * float(np.median(times))


def step_figures() -> list[Figure]:
    """Cost of a 5 ms step while the paper's layout sorts a box at 1.5 m/s."""
    return [
        Figure(
            f"step of {1000 * DT:g} ms, {size}-box",
            _step_time(
                sg.layouts.sorting(size), size, sg.layouts.LINE_Y, speed=1.5, steps=200, dt=DT
            ),
            "us",
            most=MOST_STEP[size],
        )
        for size in ("S", "B")
    ]


def size_figures() -> list[Figure]:
    """The same motion on 10 x 10 and on 2000 x 2000 modules: the ratio of the step's costs."""
    rng = np.random.default_rng(0)
    pattern = rng.choice([0.0, np.pi / 4, -np.pi / 4, np.pi / 2], (10, 10))
    times = []
    for tiles in (1, 200):
        axis = np.tile(pattern, (tiles, tiles))
        surface = sg.Surface(axis=axis, rotor=np.ones(axis.shape, dtype=bool))
        times.append(_step_time(surface, "S", y=0.5, speed=1.0, steps=2000, dt=1e-4))
    return [
        Figure("step on 2000 x 2000 over 10 x 10 modules", times[1] / times[0], "", MOST_SIZE_RATIO)
    ]


def _seconds(code: str, environment: dict[str, str]) -> float:
    result = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(result.stdout)


def start_figures() -> list[Figure]:
    """Import, and the first step of a new process with an empty and with a filled cache: of a
    simulation, and of an environment with its import.
    """
    importing = """
import time
begin = time.perf_counter()
import surface_gym
print(time.perf_counter() - begin)
"""
    making = """
import time
begin = time.perf_counter()
import gymnasium as gym
import surface_gym
env = gym.make("SmartSurface/Sort-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.perf_counter() - begin)
"""
    stepping = """
import time
import surface_gym as sg
scene = sg.layouts.sorting(), sg.layouts.box("S"), sg.layouts.start("S")
begin = time.perf_counter()
sg.simulate(*scene, velocity=(1.5, 0.0, 0.0), duration=0.005)
print(time.perf_counter() - begin)
"""
    figures = [
        Figure(
            "import surface_gym",
            float(np.median([_seconds(importing, {}) for _ in range(5)])),
            "s",
            most=MOST_IMPORT,
        )
    ]
    for name, code, most, most_cached in (
        ("first simulated step", stepping, MOST_FIRST_STEP, MOST_CACHED),
        ("first gym.make, reset and step", making, MOST_FIRST_ENV, MOST_CACHED),
    ):
        with tempfile.TemporaryDirectory() as folder:
            cache = {"NUMBA_CACHE_DIR": folder}
            first = _seconds(code, cache)
            cached = float(np.median([_seconds(code, cache) for _ in range(3)]))
        figures.append(Figure(f"{name}, empty cache", first, "s", most=most))
        figures.append(Figure(f"{name}, from the cache", cached, "s", most=most_cached))
    return figures
