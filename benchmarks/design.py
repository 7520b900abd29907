"""Time to find the columns that a design needs, and its runs per second compared with MuJoCo's."""

import importlib.util
import math
import time
import timeit
from dataclasses import replace

import numpy as np

import surface_gym as sg
from benchmarks.figure import Figure
from surface_gym.design.case import Case
from surface_gym.design.columns import least_columns
from surface_gym.design.runs import line_for, make_runs, run_all

MUJOCO = importlib.util.find_spec("mujoco") is not None
SPEEDS = np.linspace(1.0, 2.7, 6)  # [m/s] at which the S-box is sorted
COPIES = 200  # of each of our runs, which are too short to be timed alone
PARCEL = sg.Parcel(sg.Rectangle(0.3, 0.4), mass=12.0)

# Requirements.
MOST_COLUMNS = 0.2  # [s] least columns for one parcel and speed, warm, on one core
LEAST_OVER_MUJOCO = 500.0  # runs a second over MuJoCo's, one core each


def design_figures() -> list[Figure]:
    """Measure the time of `least_columns`; if MuJoCo is installed, also runs per second of both."""
    case = Case(PARCEL, speed=1.2)
    least_columns(case)  # compiles
    best = min(timeit.repeat(lambda: least_columns(case), number=1, repeat=10))
    figures = [
        Figure("least columns, 0.3 m x 0.4 m at 1.2 m/s, 400 draws", best, "s", MOST_COLUMNS)
    ]
    return figures + (_beside_mujoco() if MUJOCO else [])


def _beside_mujoco() -> list[Figure]:
    """Measure runs per second of both programs, each at its largest time step within 1 % error."""
    from surface_gym import validation
    from surface_gym.validation.comparison import METHODS, measure
    from surface_gym.validation.simulation import RECIPE

    steps = {method.name: measure(method).step for method in METHODS if method.name != "explicit"}
    box = sg.layouts.box("S")
    line = line_for(box, 10)
    axes = np.full((1, line.rows, line.columns), math.pi / 4)
    runs = make_runs(np.repeat(SPEEDS, COPIES))
    begin = time.perf_counter()
    ends = run_all(line, axes, [box], runs, dt=steps["implicit"])
    ours = len(runs) / (time.perf_counter() - begin)

    surface, start = line.surface(axes[0]), line.start(box)
    recipe = replace(RECIPE, step=steps["MuJoCo"])
    spent = 0.0
    for speed, lasts in zip(SPEEDS.tolist(), ends.time[::COPIES].tolist(), strict=True):
        velocity = (speed, 0.0, 0.0)
        begin = time.perf_counter()
        validation.simulate(surface, box, start, velocity, recipe.step, recipe)
        built = time.perf_counter()
        validation.simulate(surface, box, start, velocity, lasts, recipe)
        spent += (time.perf_counter() - built) - (built - begin)  # without building the scene
    theirs = len(SPEEDS) / spent
    return [
        Figure(f"sorting runs at {1e3 * steps['implicit']:g} ms, one core", ours, "1/s"),
        Figure(f"MuJoCo's at {1e3 * steps['MuJoCo']:g} ms", theirs, "1/s"),
        Figure("sorting runs a second over MuJoCo's", ours / theirs, "", least=LEAST_OVER_MUJOCO),
    ]
