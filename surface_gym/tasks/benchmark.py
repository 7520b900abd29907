"""Benchmarks of tasks: the starts that methods are compared on, and the columns of the tables."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from surface_gym.tasks.base import Task

Numbers = NDArray[np.float64]

DRAWN = 500  # starts of a benchmark that draws them
PARCELS = ("S", "B")
SIDES = (1, -1)


class Runs(Protocol):
    """Results of one method: every seed on the same starts."""

    @property
    def success(self) -> NDArray[np.bool_]:
        """(seeds, starts) whether each succeeded."""

    @property
    def time(self) -> Numbers:
        """(seeds, starts) [s] until the end."""

    def metric(self, name: str) -> Numbers:
        """(seeds, starts) size of one of the task's metrics."""


@dataclass(frozen=True)
class Column:
    """A column of a task's table beside the success rates."""

    name: str
    label: str
    meaning: str
    value: Callable[[Runs, Runs], float]  # of a method and of the fixed layout; nan: none
    form: str = ".2f"
    scale: float = 1.0  # to the label's unit
    every_start: bool = False  # undefined where a method did not run on all starts


@dataclass(frozen=True)
class ErrorPlot:
    """The metric whose distribution is drawn."""

    metric: str
    label: str
    scale: float = 1.0  # to the label's unit
    limit: float | None = None  # [label's unit] of success; None: success is something else


@dataclass(frozen=True, eq=False)
class SpeedGrid:
    """Starts of every parcel at every entry speed to either side, in this order."""

    speeds: Numbers  # (speeds,) [m/s]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of parcels, speeds and sides."""
        return (len(PARCELS), len(self.speeds), len(SIDES))

    @property
    def starts(self) -> tuple[dict[str, Any], ...]:
        """Options of each start."""
        return tuple(
            {"speed": speed, "side": side, "parcel": parcel}
            for parcel in PARCELS
            for speed in self.speeds.tolist()
            for side in SIDES
        )

    def success(self, runs: Runs, parcel: str) -> NDArray[np.bool_]:
        """(seeds, speeds) whether a parcel succeeded to both sides."""
        return np.asarray(self._of(runs.success, parcel).all(axis=-1))

    def success_rate(self, runs: Runs, parcel: str) -> float:
        """[-] of one parcel's starts."""
        return float(self._of(runs.success, parcel).mean())

    def slower_time(self, runs: Runs, parcel: str) -> Numbers:
        """(seeds, speeds) [s] of the slower side; inf where it failed."""
        time: Numbers = self._of(np.where(runs.success, runs.time, np.inf), parcel)
        return np.asarray(time.max(axis=-1))

    def minimum_speed(self, runs: Runs, parcel: str) -> float:
        """[m/s] from which on every start of every seed succeeds; nan if the fastest does not."""
        fails = np.nonzero(~self.success(runs, parcel).all(axis=0))[0]
        first = 0 if len(fails) == 0 else int(fails[-1]) + 1
        return float(self.speeds[first]) if first < len(self.speeds) else float("nan")

    def worst_time(self, runs: Runs, fixed: Runs, parcel: str) -> float:
        """[-] greatest time over the fixed layout's, at the speeds at which that one succeeds."""
        reference = self.slower_time(fixed, parcel)[0]
        managed = np.isfinite(reference)
        return float((self.slower_time(runs, parcel)[:, managed] / reference[managed]).max())

    def _of(self, values: NDArray[Any], parcel: str) -> NDArray[Any]:
        return np.asarray(values.reshape(-1, *self.shape)[:, PARCELS.index(parcel)])


@dataclass(frozen=True, eq=False)
class Benchmark:
    """The starts that methods are compared on, and the columns of the task's table."""

    task: "Task"
    columns: tuple[Column, ...]
    starts: tuple[dict[str, Any], ...] = ({},) * DRAWN  # options; what they leave open is drawn
    description: str = f"{DRAWN} starts drawn by the task's own law"
    example: dict[str, Any] = field(default_factory=dict)  # options of the start that is filmed
    example_description: str = "a start drawn by the task"
    error: ErrorPlot | None = None
    grid: SpeedGrid | None = None  # of starts whose times are compared by entry speed


def median_column(
    metric: str, label: str, meaning: str, form: str = ".2f", scale: float = 1.0
) -> Column:
    """Compute the median size of a metric over starts."""
    return Column(
        metric, label, meaning, lambda runs, _: float(np.median(runs.metric(metric))), form, scale
    )


def high_column(metric: str, label: str, form: str = ".2f", scale: float = 1.0) -> Column:
    """Compute the size of a metric that nine in ten starts stay below."""
    return Column(
        f"{metric}_90", label, "nine in ten are better",
        lambda runs, _: float(np.quantile(runs.metric(metric), 0.9)), form, scale,
    )  # fmt: skip


def default_benchmark(task: "Task") -> Benchmark:
    """Drawn starts, the size of every metric, and the time of an episode."""
    columns = []
    for name in task.metrics:
        label = name.replace("_", " ")
        columns += [
            median_column(name, f"{label} median", "its size, median over starts"),
            high_column(name, f"{label} 90"),
        ]
    time = Column(
        "time", "time [s]", "of an episode, median over starts",
        lambda runs, _: float(np.median(runs.time)),
    )  # fmt: skip
    first = task.metrics[0] if task.metrics else None
    error = None if first is None else ErrorPlot(first, first.replace("_", " "))
    return Benchmark(task, (*columns, time), error=error)
