"""The whole comparison: runs of Section 6, convergence of MuJoCo, and speed of the methods."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from surface_gym import parallel, trajectory
from surface_gym.paper.runs import Integration
from surface_gym.physics.types import Array
from surface_gym.validation import comparison, drawn
from surface_gym.validation.comparison import ComparedRun, ErrorSummary, SlopeCase
from surface_gym.validation.crowds import Crowd, CrowdRun, run_crowd
from surface_gym.validation.simulation import RECIPE, Recipe

DRAWS = 20  # surfaces per unevenness
MEETINGS = 30  # number of meetings of two parcels
CROWDS = 24  # number of crowds

CASES = (SlopeCase(5.0), SlopeCase(14.0), comparison.PUSHED)
VARIANTS = {
    "recipe": RECIPE,
    "step / 2": RECIPE.finer(2.0),
    "step x 2": RECIPE.finer(0.5),
    "stiffness x 2": RECIPE.stiffer(2.0),
    "stiffness / 2": RECIPE.stiffer(0.5),
    "rotors / 1000": RECIPE.lighter_rotors(1000.0),
}
JOBS = tuple((case, recipe) for case in CASES for recipe in VARIANTS.values())


@dataclass(frozen=True, eq=False)
class Variant:
    """A case with a changed recipe."""

    case: SlopeCase
    change: str
    shift: Array  # (3,) [mm, mm, deg] difference from the unchanged recipe
    error: Array  # (3,) [mm, mm, deg] difference from the implicit method


def run_variant(job: tuple[SlopeCase, Recipe]) -> Array:
    """Run a job, and return its displacement (3,) [m, m, deg]."""
    case, recipe = job
    return comparison.displacement(case.mujoco(recipe))


def compare_variants(ends: Sequence[Array]) -> tuple[Variant, ...]:
    """Compare the displacements of JOBS."""
    table = np.reshape(ends, (len(CASES), len(VARIANTS), 3))
    return tuple(
        Variant(
            case,
            change,
            comparison.UNIT * (end - rows[0]),
            comparison.UNIT * (end - comparison.displacement(case.analytic())),
        )
        for case, rows in zip(CASES, table, strict=True)
        for change, end in zip(VARIANTS, rows, strict=True)
    )


ACCURACY = 1.0  # [%] of the displacement in x, y and theta, relative to the method's own fine step
LEAST_TIME = 0.5  # [s] minimum duration of timing


@dataclass(frozen=True)
class TimedMethod:
    """A method to run a case, with steps to try and a reference step."""

    name: str
    run: Callable[[SlopeCase, float], trajectory.Trajectory]
    fine: float  # [s]
    steps: tuple[float, ...]  # [s] increasing


@dataclass(frozen=True)
class MethodSpeed:
    """Speed of a method at its largest accurate step."""

    method: str
    step: float  # [s]
    error: float  # [%] largest over the cases and over x, y and theta
    rate: float  # [-] simulated seconds per second


METHODS = (
    TimedMethod(
        "MuJoCo",
        lambda case, step: case.mujoco(replace(RECIPE, step=step)),
        fine=2.5e-5,
        steps=(5e-5, 1e-4, 2e-4, 3e-4, 4e-4, 5e-4),
    ),
    TimedMethod(
        "implicit",
        lambda case, step: case.analytic(Integration("implicit", step)),
        fine=1e-5,
        steps=(1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 1e-2),
    ),
    TimedMethod(
        "explicit",
        lambda case, step: case.analytic(Integration("explicit", step)),
        fine=2e-6,
        steps=(2e-5, 5e-5, 1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 1e-3, 2e-3, 5e-3),
    ),
)


def measure(method: TimedMethod) -> MethodSpeed:
    """Time a method at its largest step up to which every tried step is accurate."""
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
    return MethodSpeed(method.name, step, error, _rate(method, step))


def _ends(method: TimedMethod, step: float) -> Array:
    """Return the displacements (cases, 3) [m, m, deg]."""
    return np.array([comparison.displacement(method.run(case, step)) for case in CASES])


def _rate(method: TimedMethod, step: float) -> float:
    """Measure the simulated seconds per second; return the best round."""
    best, spent = np.inf, 0.0
    while spent < LEAST_TIME:
        start = time.perf_counter()
        for case in CASES:
            method.run(case, step)
        taken = time.perf_counter() - start
        best, spent = min(best, taken), spent + taken
    return float(sum(case.duration for case in CASES) / best)


@dataclass(frozen=True, eq=False)
class Study:
    """Results of `python -m surface_gym.validation`."""

    sweep: tuple[ComparedRun, ...]  # one run per tilt
    pushed: ComparedRun  # v0 = 0.9 m/s on the level
    long: ComparedRun  # Figure 12c
    convergence: tuple[Variant, ...]
    speeds: tuple[MethodSpeed, ...]
    spreads: tuple[drawn.PoseShifts, ...]  # empty unless requested
    meetings: tuple[drawn.MeetingRun, ...] = ()  # empty unless requested
    crowds: tuple[CrowdRun, ...] = ()  # empty unless requested

    @property
    def summaries(self) -> tuple[ErrorSummary, ErrorSummary]:
        """Table 7 against the implicit and against the explicit method."""
        implicit = comparison.compute_errors(self.sweep, lambda run: run.implicit)
        explicit = comparison.compute_errors(self.sweep, lambda run: run.explicit)
        return (
            implicit.summary(f"MuJoCo / {comparison.IMPLICIT}"),
            explicit.summary(f"MuJoCo / {comparison.EXPLICIT}"),
        )

    @property
    def sorts_from(self) -> dict[str, float | None]:
        """[deg] smallest tilt above which every tilt of the sweep is sorted, by method; None: none.

        The smallest tilt itself is sorted too.
        """
        return {
            "MuJoCo": comparison.sorts_from(self.sweep, lambda run: run.mujoco),
            "implicit": comparison.sorts_from(self.sweep, lambda run: run.implicit),
            "explicit": comparison.sorts_from(self.sweep, lambda run: run.explicit),
        }


def run_study(
    tilts: tuple[float, ...], with_unevenness: bool, with_touching: bool, workers: parallel.Workers,
    seed: int, console: Console,
) -> Study:  # fmt: skip
    """Run the comparison in parallel, then the timing on one core."""
    cases = (*(SlopeCase(tilt) for tilt in tilts), comparison.PUSHED, comparison.LONG)
    draws = drawn.draw_surfaces(DRAWS, seed) if with_unevenness else ()
    meetings = [drawn.Meeting(seed + k) for k in range(MEETINGS if with_touching else 0)]
    held = [Crowd(seed + k) for k in range(CROWDS if with_touching else 0)]
    parts: tuple[tuple[Any, Sequence[Any]], ...] = (
        (comparison.run_case, cases),
        (run_variant, JOBS),
        (drawn.run_draw, draws),
        (drawn.run_meeting, meetings),
        (run_crowd, held),
    )
    jobs = [
        partial(parallel.without_report, partial(function, each))
        for function, group in parts
        for each in group
    ]
    done = track(
        parallel.map_jobs(jobs, workers), "MuJoCo and the analytic model", total=len(jobs),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip
    found: dict[int, Any] = dict(done)
    results = iter(found[place] for place in range(len(jobs)))
    runs, variants, ends, meeting_runs, crowd_runs = (
        [next(results) for _ in group] for _, group in parts
    )
    with console.status("timing, one core"):
        speeds = tuple(measure(method) for method in METHODS)
    return Study(
        sweep=tuple(runs[:-2]), pushed=runs[-2], long=runs[-1],
        convergence=compare_variants(variants), speeds=speeds,
        spreads=drawn.compare_draws(draws, ends) if draws else (), meetings=tuple(meeting_runs),
        crowds=tuple(crowd_runs),
    )  # fmt: skip
