"""Comparison with MuJoCo as in Section 6 of the paper: 37 tilts, one push, convergence, speed."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property
from typing import Final

import numpy as np

from surface_gym import layouts
from surface_gym.paper.runs import COARSE, Integration, displacement, load_data
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.physics.types import Array
from surface_gym.simulation import expect_tipping, simulate
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation import simulation
from surface_gym.validation.simulation import RECIPE, Recipe

PARCEL = Parcel(Rectangle(0.25, 0.25), mass=5.48, com_height=0.1, inertia=5.70e-2)  # Table 5
# Names of the compared models.
MUJOCO: Final = "MuJoCo"
IMPLICIT: Final = "implicit"
EXPLICIT: Final = "explicit"
INTEGRATIONS = {
    IMPLICIT: Integration(IMPLICIT, 1e-3),
    EXPLICIT: COARSE,  # our inferred step of Section 5
}
UNIT = np.array([1e3, 1e3, 1.0])  # factors from [m, m, deg] to [mm, mm, deg]


@dataclass(frozen=True)
class SlopeCase:
    """A start of a box on the sorting layout of Figure 7."""

    tilt: float  # [deg]
    speed: float = 0.0  # [m/s] along x
    duration: float = 1.0  # [s]

    @property
    def name(self) -> str:
        return f"{self.tilt:g} deg" if self.speed == 0.0 else f"v0 = {self.speed:g} m/s"

    @cached_property
    def surface(self) -> Surface:
        """The sorting layout at the tilt."""
        return layouts.sorting(tilt=math.radians(self.tilt))

    @property
    def pose(self) -> tuple[float, float, float]:
        """(x, y, theta) [m, m, rad] at the start."""
        return layouts.start("S")

    @property
    def velocity(self) -> tuple[float, float, float]:
        """(vx, vy, omega) [m/s, m/s, rad/s] at the start."""
        return (self.speed, 0.0, 0.0)

    def mujoco(self, recipe: Recipe = RECIPE) -> Trajectory:
        return simulation.simulate(
            self.surface, PARCEL, self.pose, self.velocity, self.duration, recipe
        )

    @expect_tipping()
    def analytic(self, integration: Integration = INTEGRATIONS[IMPLICIT]) -> Trajectory:
        """Run the case by the model of Section 3; `integration` is a method and its time step."""
        start = (self.pose, self.velocity, self.duration)
        return simulate(self.surface, PARCEL, *start, integration.dt, integration.method)


PUSHED = SlopeCase(tilt=0.0, speed=0.9)
LONG = SlopeCase(tilt=5.0, duration=1.8)  # Figure 12c


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """Three runs of a case: by MuJoCo, by our implicit method and by our explicit method."""

    case: SlopeCase
    by: dict[str, Trajectory]  # by name of the model


def run_case(case: SlopeCase) -> ComparedRun:
    """Run a case in MuJoCo, and by the implicit and the explicit method."""
    analytic = {name: case.analytic(each) for name, each in INTEGRATIONS.items()}
    return ComparedRun(case, {MUJOCO: case.mujoco(), **analytic})


def displacements(runs: Sequence[ComparedRun], model: str) -> Array:
    """Return each run's displacement from start to end, shape (runs, 3) [m, m, deg].

    `model` is "MuJoCo", or the method of our model: "implicit" or "explicit".
    """
    return np.array([displacement(run.by[model]) for run in runs])


def is_sorted(case: SlopeCase, trajectory: Trajectory) -> bool:
    """Return whether no rotor is under the box at the end of a trajectory."""
    under = simulation.elements_under(case.surface, PARCEL, trajectory.pose[-1])
    return not (under & case.surface.rotor).any()


def sorts_from(runs: Sequence[ComparedRun], model: str) -> float | None:
    """Return the tilt [deg] at and above which a model sorts, or None if the largest tilt fails."""
    least = None
    for run in sorted(runs, key=lambda run: -run.case.tilt):
        if not is_sorted(run.case, run.by[model]):
            break
        least = run.case.tilt
    return least


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors by Eq. (5), with a row per run, or a row of means and a row of standard deviations."""

    absolute: Array  # (rows, 3) [mm, mm, deg] Eq. (5a)
    percent: Array  # (rows, 3) [%] Eq. (5b)

    def summary(self) -> "Errors":
        """Return errors with two rows, the mean and the standard deviation over the runs."""

        def rows(values: Array) -> Array:
            deviation = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(3)
            return np.stack([values.mean(axis=0), deviation])

        return Errors(rows(self.absolute), rows(self.percent))


def compute_errors(runs: Sequence[ComparedRun], model: str) -> Errors:
    """Compute a model's error in each run: MuJoCo's displacement minus the model's displacement."""
    mujoco = displacements(runs, MUJOCO)
    difference = mujoco - displacements(runs, model)
    return Errors(difference * UNIT, 100.0 * difference / mujoco)


@dataclass(frozen=True, eq=False)
class PaperErrors:
    """Errors between Adams and the MATLAB model, as the paper states them (Section 6.2)."""

    table7: Errors  # mean and standard deviation
    tilted: Errors  # one run: 10 deg
    pushed: Errors  # one run: v0 = 0.9 m/s
    sorts_from: float  # [deg]


def load_paper_errors() -> PaperErrors:
    """Read the errors in Table 7 and in Section 6.2 from the package's data file."""
    printed = load_data()["validation"]
    rows = [printed["table7"][row] for row in ("mean", "sd")]
    percent = [[row[f"e{axis}_percent"] for axis in ("x", "y", "theta")] for row in rows]
    absolute = [[row[key] for key in ("ex_mm", "ey_mm", "etheta_deg")] for row in rows]
    tilted, pushed = (
        Errors(np.array([printed[key]["abs"]]) * UNIT, np.array([printed[key]["percent"]]))
        for key in ("gamma10", "v09")
    )
    table7 = Errors(np.array(absolute), np.array(percent))
    return PaperErrors(table7, tilted, pushed, printed["completes_from_gamma_deg"])


def adams_displacement(run: str) -> tuple[Array, Array]:
    """Return lower and upper bounds (3,) [m, m, deg] of Adams's absolute displacement in a run.

    Section 6.2 has two rounded errors: |e|, and |e %| = 100 |e| / |displacement by Adams|. The
    bounds follow from the rounding. The runs are "gamma10" (tilt 10 deg) and "v09" (0.9 m/s,
    level).
    """
    numbers = load_data()["validation"][run]
    errors, percents = np.abs(numbers["abs"]), np.abs(numbers["percent"])
    error_rounding, percent_rounding = _half_digits(errors), _half_digits(percents)
    return (
        100.0 * (errors - error_rounding) / (percents + percent_rounding),
        100.0 * (errors + error_rounding) / (percents - percent_rounding),
    )


def _half_digits(values: Array) -> Array:
    """Return half a unit of the last digit (n,) of printed values (n,)."""
    digits = [Decimal(repr(value)).as_tuple().exponent for value in values.tolist()]
    return np.array([0.5 * 10.0 ** int(digit) for digit in digits])


CASES = (SlopeCase(5.0), SlopeCase(14.0), PUSHED)  # cases of convergence and speed
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
    """Effect of one changed MuJoCo parameter (see `Recipe`) on the result of a case."""

    case: SlopeCase
    change: str
    shift: Array  # (3,) [mm, mm, deg] difference from the unchanged recipe
    error: Array  # (3,) [mm, mm, deg] difference from the implicit method


def run_variant(job: tuple[SlopeCase, Recipe]) -> tuple[float, float, float]:
    """Run a case with a recipe in MuJoCo; return the displacement (x, y, theta) [m, m, deg]."""
    case, recipe = job
    return displacement(case.mujoco(recipe))


def compare_variants(ends: Sequence[tuple[float, float, float]]) -> tuple[Variant, ...]:
    """Compare every variant with the first variant and with the analytic model.

    `ends` are the displacements (3,) [m, m, deg] of all JOBS, in the order of JOBS.
    """
    table = np.reshape(ends, (len(CASES), len(VARIANTS), 3))
    return tuple(
        Variant(case, change, UNIT * (end - rows[0]), UNIT * (end - displacement(case.analytic())))
        for case, rows in zip(CASES, table, strict=True)
        for change, end in zip(VARIANTS, rows, strict=True)
    )


ACCURACY = 1.0  # [%] of the displacement in x, y and theta, relative to the method's own fine step
LEAST_TIME = 0.5  # [s] minimum duration of timing


@dataclass(frozen=True)
class TimedMethod:
    """A method of simulation, the time steps to try, and the time step of the reference."""

    name: str
    run: Callable[[SlopeCase, float], Trajectory]
    fine: float  # [s]
    steps: tuple[float, ...]  # [s] increasing


@dataclass(frozen=True)
class MethodSpeed:
    """Speed of a method at its largest accurate time step."""

    method: str
    step: float  # [s]
    error: float  # [%] largest over the cases and over x, y and theta
    rate: float  # [-] simulated seconds per second


METHODS = (
    TimedMethod(
        MUJOCO,
        lambda case, step: case.mujoco(replace(RECIPE, step=step)),
        fine=2.5e-5,
        steps=(5e-5, 1e-4, 2e-4, 3e-4, 4e-4, 5e-4),
    ),
    TimedMethod(
        IMPLICIT,
        lambda case, step: case.analytic(Integration(IMPLICIT, step)),
        fine=1e-5,
        steps=(1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 1e-2),
    ),
    TimedMethod(
        EXPLICIT,
        lambda case, step: case.analytic(Integration(EXPLICIT, step)),
        fine=2e-6,
        steps=(2e-5, 5e-5, 1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 1e-3, 2e-3, 5e-3),
    ),
)


def measure(method: TimedMethod) -> MethodSpeed:
    """Time a method at its largest accurate time step.

    At this step and at all shorter steps of the method, all errors are at most `ACCURACY`, 1 %.
    """

    def ends(step: float) -> Array:
        return np.array([displacement(method.run(case, step)) for case in CASES])

    fine = ends(method.fine)
    step, error = 0.0, np.inf
    for trial in method.steps:
        trial_error = float(np.abs(100.0 * (ends(trial) - fine) / fine).max())
        if trial_error > ACCURACY:
            break
        step, error = trial, trial_error
    if step == 0.0:
        raise ValueError(
            f"steps of {method.name} must hold one within {ACCURACY:g} % of its fine solution, "
            f"got {trial_error:.2f} % at {method.steps[0]:g} s"
        )
    return MethodSpeed(method.name, step, error, _rate(method, step))


def _rate(method: TimedMethod, step: float) -> float:
    """Return simulated seconds per real second in the fastest round, with steps of `step` [s]."""
    best, spent = np.inf, 0.0
    while spent < LEAST_TIME:
        start = time.perf_counter()
        for case in CASES:
            method.run(case, step)
        taken = time.perf_counter() - start
        best, spent = min(best, taken), spent + taken
    return float(sum(case.duration for case in CASES) / best)
