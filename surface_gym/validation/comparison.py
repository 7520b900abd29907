"""The runs of Section 6 and their errors: one box and one layout with 37 tilts and one push."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property

import numpy as np

from surface_gym import layouts
from surface_gym.paper import runs
from surface_gym.paper.runs import COARSE, Integration, load_data
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.physics.types import Array
from surface_gym.simulation import expect_tipping, simulate
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation import simulation

PARCEL = Parcel(Rectangle(0.25, 0.25), mass=5.48, com_height=0.1, inertia=5.70e-2)  # Table 5
IMPLICIT = Integration("implicit", 1e-3)
EXPLICIT = COARSE  # our inferred step of Section 5
UNIT = np.array([1e3, 1e3, 1.0])  # factors from [m, m, deg] to [mm, mm, deg]


@dataclass(frozen=True)
class SlopeCase:
    """One start on the sorting layout of Figure 7."""

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

    def mujoco(self, recipe: simulation.Recipe = simulation.RECIPE) -> Trajectory:
        return simulation.simulate(
            self.surface, PARCEL, self.pose, self.velocity, self.duration, recipe
        )

    @expect_tipping()
    def analytic(self, integration: Integration = IMPLICIT) -> Trajectory:
        """Run the case by the model of Section 3."""
        start = (self.pose, self.velocity, self.duration)
        return simulate(self.surface, PARCEL, *start, integration.dt, integration.method)


PUSHED = SlopeCase(tilt=0.0, speed=0.9)
LONG = SlopeCase(tilt=5.0, duration=1.8)  # Figure 12c


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """A case by MuJoCo and by the analytic model."""

    case: SlopeCase
    mujoco: Trajectory
    implicit: Trajectory  # at 1 ms
    explicit: Trajectory  # at 5 ms


Model = Callable[[ComparedRun], Trajectory]  # selects one trajectory of a run


def run_case(case: SlopeCase) -> ComparedRun:
    """Run a case in MuJoCo and by both methods of the analytic model."""
    return ComparedRun(case, case.mujoco(), case.analytic(IMPLICIT), case.analytic(EXPLICIT))


def displacement(trajectory: Trajectory) -> Array:
    """Return the displacement (3,) [m, m, deg] from start to end."""
    return np.array(runs.displacement(trajectory))


def is_sorted(case: SlopeCase, trajectory: Trajectory) -> bool:
    """Return whether no rotor is under the base at the end: it is out of the sorting zone."""
    under = simulation.elements_under(case.surface, PARCEL, trajectory.pose[-1])
    return not (under & case.surface.rotor).any()


def sorts_from(runs: Sequence[ComparedRun], model: Model) -> float | None:
    """Return the smallest tilt [deg] such that its run and all steeper runs sort, or None."""
    least = None
    for run in sorted(runs, key=lambda run: -run.case.tilt):
        if not is_sorted(run.case, model(run)):
            break
        least = run.case.tilt
    return least


@dataclass(frozen=True, eq=False)
class ErrorSummary:
    """Values of Table 7: rows are mean and standard deviation, columns x, y and theta."""

    title: str
    percent: Array  # (2, 3) [%]
    absolute: Array  # (2, 3) [mm, mm, deg]


@dataclass(frozen=True, eq=False)
class DisplacementErrors:
    """MuJoCo's displacements minus the analytic model's, by run."""

    absolute: Array  # (runs, 3) [mm, mm, deg] Eq. (5a)
    percent: Array  # (runs, 3) [%] relative to MuJoCo's, Eq. (5b)

    def summary(self, title: str) -> ErrorSummary:
        """Compute mean and standard deviation over the runs."""

        def rows(values: Array) -> Array:
            deviation = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(3)
            return np.stack([values.mean(axis=0), deviation])

        return ErrorSummary(title, rows(self.percent), rows(self.absolute))


def compute_errors(runs: Sequence[ComparedRun], model: Model) -> DisplacementErrors:
    """Compute the errors of one analytic model over the runs."""
    mujoco = np.array([displacement(run.mujoco) for run in runs])
    difference = mujoco - np.array([displacement(model(run)) for run in runs])
    return DisplacementErrors(difference * UNIT, 100.0 * difference / mujoco)


@dataclass(frozen=True, eq=False)
class PaperErrors:
    """Errors between Adams and MATLAB in Section 6.2."""

    table7: ErrorSummary
    tilted: DisplacementErrors  # one run: 10 deg
    pushed: DisplacementErrors  # one run: v0 = 0.9 m/s
    sorts_from: float  # [deg]


def load_paper_errors() -> PaperErrors:
    """Read Table 7 and numbers of Section 6.2 from the package's data file."""
    printed = load_data()["validation"]
    rows = [printed["table7"][row] for row in ("mean", "sd")]
    percent = [[row[f"e{axis}_percent"] for axis in ("x", "y", "theta")] for row in rows]
    absolute = [[row[key] for key in ("ex_mm", "ey_mm", "etheta_deg")] for row in rows]
    tilted, pushed = (
        DisplacementErrors(
            np.array([printed[key]["abs"]]) * UNIT, np.array([printed[key]["percent"]])
        )
        for key in ("gamma10", "v09")
    )
    table7 = ErrorSummary("Adams / MATLAB, printed", np.array(percent), np.array(absolute))
    return PaperErrors(table7, tilted, pushed, printed["completes_from_gamma_deg"])


def adams_displacement(run: str) -> tuple[Array, Array]:
    """Return bounds (3,) [m, m, deg] of Adams's absolute displacement from its printed errors.

    Section 6.2 states the errors |e| and |e %| = 100 |e| / |displacement by Adams| for two runs:
    "gamma10" (tilt 10 deg) and "v09" (0.9 m/s on a level surface).
    """
    numbers = load_data()["validation"][run]
    errors, percents = np.abs(numbers["abs"]), np.abs(numbers["percent"])
    error_rounding, percent_rounding = _half_digits(errors), _half_digits(percents)
    return (
        100.0 * (errors - error_rounding) / (percents + percent_rounding),
        100.0 * (errors + error_rounding) / (percents - percent_rounding),
    )


def _half_digits(values: Array) -> Array:
    """Return half a unit of the last printed digit."""
    digits = [Decimal(repr(value)).as_tuple().exponent for value in values.tolist()]
    return np.array([0.5 * 10.0 ** int(digit) for digit in digits])
