"""Errors as in Eq. (5) and Table 7."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from surface_gym.trajectory import Trajectory
from surface_gym.validation.cases import Run, displacement, is_sorted

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Summary:
    """A Table 7: rows are mean and standard deviation, columns x, y and theta."""

    title: str
    percent: Array  # (2, 3) [%]
    absolute: Array  # (2, 3) [mm, mm, deg]


@dataclass(frozen=True, eq=False)
class Errors:
    """MuJoCo's displacements less the analytic model's, run by run."""

    absolute: Array  # (runs, 3) [mm, mm, deg] Eq. (5a)
    percent: Array  # (runs, 3) [%] of MuJoCo's, Eq. (5b)

    def summary(self, title: str) -> Summary:
        """Mean and standard deviation over the runs."""

        def rows(values: Array) -> Array:
            deviation = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(3)
            return np.stack([values.mean(axis=0), deviation])

        return Summary(title, rows(self.percent), rows(self.absolute))


@dataclass(frozen=True)
class Target:
    """A bound that was asked for, and the value it holds for."""

    what: str
    bound: float
    measured: float
    unit: str

    @property
    def is_reached(self) -> bool:
        return self.measured <= self.bound


@dataclass(frozen=True, eq=False)
class PaperErrors:
    """What Section 6.2 prints of Adams against MATLAB."""

    table7: Summary
    tilted: Errors  # one run: 10 deg
    pushed: Errors  # one run: v0 = 0.9 m/s
    sorts_from: float  # [deg]


def errors(runs: Sequence[Run], model: Callable[[Run], Trajectory]) -> Errors:
    """Errors of one of the analytic trajectories of the runs."""
    mujoco = np.array([displacement(run.mujoco) for run in runs])
    difference = mujoco - np.array([displacement(model(run)) for run in runs])
    return Errors(difference * [1e3, 1e3, 1.0], 100.0 * difference / mujoco)


def targets(sweep: Errors, pushed: Errors) -> tuple[Target, ...]:
    """The bounds on MuJoCo against the implicit method at 1 ms.

    Args:
        sweep: of the tilts.
        pushed: of the one run with a speed.
    """
    absolute = np.abs(np.vstack([sweep.absolute, pushed.absolute])).max(axis=0)
    percent = np.abs(np.vstack([sweep.percent, pushed.percent])).max(axis=0)
    mean = np.abs(sweep.percent.mean(axis=0))
    return tuple(
        Target(f"{what} in {axis}", bound, float(measured), unit)
        for what, bounds, values, units in (
            ("worst run", (5.0, 4.0, 2.5), absolute, ("mm", "mm", "deg")),
            ("worst run", (1.0, 2.5, 6.0), percent, ("%", "%", "%")),
            ("mean over the tilts", (0.75, 1.5, 2.0), mean, ("%", "%", "%")),
        )
        for axis, bound, measured, unit in zip(
            ("x", "y", "theta"), bounds, values, units, strict=True
        )
    )


def sorts_from(runs: Sequence[Run], model: Callable[[Run], Trajectory]) -> float | None:
    """[deg] the least tilt from which on every run is sorted; None if the steepest is not."""
    least = None
    for run in sorted(runs, key=lambda run: -run.case.tilt):
        if not is_sorted(run.case, model(run)):
            break
        least = run.case.tilt
    return least


def paper_errors() -> PaperErrors:
    """Table 7 and the sentences of Section 6.2, from the package's copy of the paper's tables."""
    text = resources.files("surface_gym.paper").joinpath("data/targets.json").read_text("utf-8")
    printed = json.loads(text)["validation"]
    rows = [printed["table7"][row] for row in ("mean", "sd")]
    percent = [[row[f"e{axis}_percent"] for axis in ("x", "y", "theta")] for row in rows]
    absolute = [[row[key] for key in ("ex_mm", "ey_mm", "etheta_deg")] for row in rows]
    tilted, pushed = (
        Errors(
            np.array([printed[key]["abs"]]) * [1e3, 1e3, 1.0], np.array([printed[key]["percent"]])
        )
        for key in ("gamma10", "v09")
    )
    title = "Adams / MATLAB, printed"
    return PaperErrors(
        Summary(title, np.array(percent), np.array(absolute)),
        tilted,
        pushed,
        printed["completes_from_gamma_deg"],
    )
