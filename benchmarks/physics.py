"""Time of a physics step, time of the first step in a process, and accuracy of the implicit step.

Accuracy is the difference from the paper's explicit method in steps of 10 microseconds.
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import surface_gym as sg
from benchmarks.figure import Figure
from surface_gym.physics.rollout import run_implicit
from surface_gym.physics.types import STATE_SIZE, VX, X, Y, make_scratch
from surface_gym.simulation import expect_tipping

DT = 0.005  # [s]
REPEATS = 300

# Requirements.
MOST_STEP = {"S": 0.40, "B": 1.10}  # [us]
MOST_IMPORT = 0.6  # [s]
MOST_FIRST_STEP = 8.0  # [s] with an empty cache
MOST_FIRST_ENV = 8.0  # [s] with the import
MOST_CACHED = 1.0  # [s]
MOST_SIZE_RATIO = 1.10
MOST_DRIVEN_RATIO = 1.10

# Comparison with the explicit method.
STEPS = (0.010, 0.005, 0.002, 0.001)  # [s]
FINE = 1e-5  # [s]
AXES = np.radians([0.0, 45.0, -45.0, 90.0])


def _step_time(
    surface: sg.Surface, size: str, y: float, speed: float, steps: int, dt: float
) -> float:
    """Return the time of a step [us]: the median of repeated runs from one start on one core."""
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
    """Measure a 5 ms step while the paper's layout sorts a box at 1.5 m/s."""
    figures = []
    for size in ("S", "B"):
        surface = sg.layouts.sorting(size)
        taken = _step_time(surface, size, sg.layouts.LINE_Y, speed=1.5, steps=200, dt=DT)
        name = f"step of {1000 * DT:g} ms, {size}-box"
        figures.append(Figure(name, taken, "us", most=MOST_STEP[size]))
    return figures


def size_figures() -> list[Figure]:
    """Measure the time of a step on 2000 x 2000 modules, relative to 10 x 10 modules."""
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


def drive_figures() -> list[Figure]:
    """Measure the time of a step on driven modules, relative to idle rotors.

    Idle rotors have random axes. Driven modules either run alike, so that the box soon moves with
    them, or have random velocities, so that the box always slips.
    """
    rng = np.random.default_rng(0)
    shape = 30, 40
    idle = sg.Surface(axis=rng.choice(AXES, shape), rotor=np.ones(shape, dtype=bool))
    kinds = {
        "alike": np.full((*shape, 2), (1.4, 0.5)),
        "at random": rng.uniform((0.5, -0.8), (1.5, 0.8), (*shape, 2)),
    }
    figures = []
    for size in ("S", "B"):
        surfaces = [idle, *(replace(idle, surface_velocity=each) for each in kinds.values())]
        times = [
            _step_time(surface, size, y=1.5, speed=1.5, steps=80, dt=DT) for surface in surfaces
        ]
        for kind, taken in zip(kinds, times[1:], strict=True):
            name = f"step with drives, {kind}, over one without, {size}-box"
            figures.append(Figure(name, taken / times[0], "", most=MOST_DRIVEN_RATIO))
    return figures


IMPORTING = """
import time
begin = time.perf_counter()
import surface_gym
print(time.perf_counter() - begin)
"""
MAKING = """
import time
begin = time.perf_counter()
import gymnasium as gym
import surface_gym
env = gym.make("SmartSurface/Sort-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.perf_counter() - begin)
"""
STEPPING = """
import time
import surface_gym as sg
scene = sg.layouts.sorting(), sg.layouts.box("S"), sg.layouts.start("S")
begin = time.perf_counter()
sg.simulate(*scene, velocity=(1.5, 0.0, 0.0), duration=0.005)
print(time.perf_counter() - begin)
"""


def _seconds(code: str, environment: dict[str, str]) -> float:
    """Run code in a new process with environment variables; return the time [s] that it prints."""
    result = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(result.stdout)


def start_figures() -> list[Figure]:
    """Measure the time of the import and of the first step in a new process.

    The first step is of a simulation, or of an environment (with the import). The cache is empty or
    filled.
    """
    importing = float(np.median([_seconds(IMPORTING, {}) for _ in range(5)]))
    figures = [Figure("import surface_gym", importing, "s", most=MOST_IMPORT)]
    for name, code, most in (
        ("first simulated step", STEPPING, MOST_FIRST_STEP),
        ("first gym.make, reset and step", MAKING, MOST_FIRST_ENV),
    ):
        with tempfile.TemporaryDirectory() as folder:
            cache = {"NUMBA_CACHE_DIR": folder}
            first = _seconds(code, cache)
            cached = float(np.median([_seconds(code, cache) for _ in range(3)]))
        figures.append(Figure(f"{name}, empty cache", first, "s", most=most))
        figures.append(Figure(f"{name}, from the cache", cached, "s", most=MOST_CACHED))
    return figures


@dataclass(frozen=True)
class Scene:
    """A random surface, parcel and start."""

    surface: sg.Surface
    parcel: sg.Parcel
    pose: tuple[float, float, float]
    velocity: tuple[float, float, float]
    duration: float  # [s]


def draw_scene(rng: np.random.Generator) -> Scene:
    """Draw a scene: random axes, tilt (0 to 15 deg), box, pose, velocity and duration."""
    surface = sg.Surface(
        axis=rng.choice(AXES, size=(30, 60)),
        rotor=rng.random((30, 60)) < 0.8,
        tilt=rng.choice([0.0, rng.uniform(0.0, np.radians(15.0))]),
    )
    return Scene(
        surface=surface,
        parcel=sg.layouts.box(str(rng.choice(["S", "B"]))),
        pose=(1.0, 1.5 + rng.uniform(-0.1, 0.1), rng.uniform(-np.pi, np.pi)),
        velocity=(rng.uniform(0.5, 2.7), rng.uniform(-0.5, 0.5), rng.uniform(-3.0, 3.0)),
        duration=rng.uniform(0.4, 1.0),
    )


def explicit_end(scene: Scene) -> np.ndarray | None:
    """Return the end pose (3,) by the explicit method at 10 us; None if the scene does not suit it.

    The paper's rules assume motion towards +x on the surface, so vx must stay positive.
    """
    start = scene.pose, scene.velocity, scene.duration
    run = sg.simulate(scene.surface, scene.parcel, *start, FINE, method="explicit")
    return run.pose[-1] if run.end == "duration" and run.velocity[:, 0].min() > 0.0 else None


@expect_tipping()
def measure_accuracy(scenes: int, seed: int, console: Console) -> dict[float, np.ndarray]:
    """Return the errors (scenes, 2) of position [mm] and angle [deg], by the time step [s]."""
    rng = np.random.default_rng(seed)
    errors: dict[float, list[tuple[float, float]]] = {dt: [] for dt in STEPS}
    for _ in track(range(scenes), "scenes at 10 microseconds", console=console, transient=True):
        fine = None
        while fine is None:
            scene = draw_scene(rng)
            fine = explicit_end(scene)
        start = scene.pose, scene.velocity, scene.duration
        for dt in STEPS:
            end = sg.simulate(scene.surface, scene.parcel, *start, dt).pose[-1]
            position = 1000.0 * np.hypot(*(end - fine)[:2])
            errors[dt].append((position, np.degrees(abs(end[2] - fine[2]))))
    return {dt: np.array(rows) for dt, rows in errors.items()}


def accuracy_table(errors: dict[float, np.ndarray]) -> Table:
    """Make a table of the median, 90th percentile and largest error for each time step."""
    count = len(next(iter(errors.values())))
    table = Table("step [ms]", title=f"implicit against explicit at 10 us, {count} random scenes")
    for quantity in ("position [mm]", "angle [deg]"):
        for statistic in ("median", "p90", "max"):
            table.add_column(f"{quantity}\n{statistic}", justify="right")
    for dt, rows in errors.items():
        percentiles = np.percentile(rows, (50, 90, 100), axis=0).T.ravel()
        table.add_row(f"{1000 * dt:g}", *(f"{value:.2f}" for value in percentiles))
    return table
