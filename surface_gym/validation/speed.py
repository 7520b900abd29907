"""Simulated seconds per second on one core, each method at the largest step that is accurate."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym.paper import Integration
from surface_gym.trajectory import Trajectory
from surface_gym.validation.cases import Case, displacement
from surface_gym.validation.convergence import CASES
from surface_gym.validation.recipe import RECIPE

ACCURACY = 1.0  # [%] of the displacement in x, y and theta, against the method's own fine step
LEAST_TIME = 0.5  # [s] for which a method is timed


@dataclass(frozen=True)
class Method:
    """Something that runs a case at a step, the steps to try and one to hold them against."""

    name: str
    run: Callable[[Case, float], Trajectory]
    fine: float  # [s]
    steps: tuple[float, ...]  # [s] increasing


@dataclass(frozen=True)
class Speed:
    """How fast a method is at its largest accurate step."""

    method: str
    step: float  # [s]
    error: float  # [%] the worst of the cases and of x, y and theta
    rate: float  # [-] simulated seconds per second


METHODS = (
    Method(
        "MuJoCo",
        lambda case, step: case.mujoco(replace(RECIPE, step=step)),
        fine=2.5e-5,
        steps=(5e-5, 1e-4, 2e-4, 3e-4, 4e-4, 5e-4),
    ),
    Method(
        "implicit",
        lambda case, step: case.analytic(Integration("implicit", step)),
        fine=1e-5,
        steps=(1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 1e-2),
    ),
    Method(
        "explicit",
        lambda case, step: case.analytic(Integration("explicit", step)),
        fine=2e-6,
        steps=(2e-5, 5e-5, 1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 1e-3, 2e-3, 5e-3),
    ),
)


def measure(method: Method) -> Speed:
    """Time a method at the largest step up to which every step tried is accurate.

    Raises:
        ValueError: not even the smallest step is.
    """
    fine = _ends(method, method.fine)
    step, error = 0.0, np.inf
    for trial in method.steps:
        trial_error = float(np.abs(100.0 * (_ends(method, trial) - fine) / fine).max())
        if trial_error > ACCURACY:
            break
        step, error = trial, trial_error
    if step == 0.0:
        raise ValueError(
            f"steps of {method.name} must hold one within {ACCURACY:g} % of its fine solution, "
            f"got {trial_error:.2f} % at {method.steps[0]:g} s"
        )
    return Speed(method.name, step, error, _rate(method, step))


def _ends(method: Method, step: float) -> NDArray[np.float64]:
    """(cases, 3) [m, m, deg]."""
    return np.array([displacement(method.run(case, step)) for case in CASES])


def _rate(method: Method, step: float) -> float:
    """Simulated seconds per second, the best of the rounds."""
    best, spent = np.inf, 0.0
    while spent < LEAST_TIME:
        start = time.perf_counter()
        for case in CASES:
            method.run(case, step)
        taken = time.perf_counter() - start
        best, spent = min(best, taken), spent + taken
    return float(sum(case.duration for case in CASES) / best)
