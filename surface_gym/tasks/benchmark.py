"""Benchmarks of tasks: the scenarios that methods are compared on, and the columns of the tables.

A scenario of a task of one parcel is a list of starts, of a task on streams an offered stream.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from surface_gym.tasks.base import Task

Numbers = NDArray[np.float64]

DRAWN = 500  # starts of a benchmark that draws them
ENTRANCE = math.inf  # a rate: as many parcels as the entrance takes
# Kinds of methods that are compared on a stream unless it names others; "planner" is one more.
KINDS = ("baseline", "rule", "agent")
PARCELS = ("S", "B")
SIDES = (1, -1)


class Runs(Protocol):
    """Results of one method: every seed on the same episodes."""

    @property
    def success(self) -> NDArray[np.bool_]:
        """(seeds, starts) whether each succeeded."""

    @property
    def time(self) -> Numbers:
        """(seeds, starts) [s] until the end."""

    def metric(self, name: str) -> Numbers:
        """(seeds, starts) size of one of the task's metrics."""

    def mean(self, name: str) -> float:
        """Mean of a statistic of streams over episodes, by the parcels delivered; nan: none."""

    def most(self, name: str) -> float:
        """Largest value of a statistic of streams."""


@dataclass(frozen=True)
class ResultColumn:
    """A column of a task's table beside the success rates."""

    name: str
    label: str
    meaning: str
    value: Callable[[Runs, Runs], float]  # of a method and of the fixed layout; nan: none
    form: str = ".2f"
    scale: float = 1.0  # to the label's unit
    unit: str = ""  # behind the number
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
    columns: tuple[ResultColumn, ...]
    starts: tuple[dict[str, Any], ...] = ({},) * DRAWN  # options; what they leave open is drawn
    description: str = f"{DRAWN} starts drawn by the task's own law"
    example: dict[str, Any] = field(default_factory=dict)  # options of the start that is filmed
    example_description: str = "a start drawn by the task"
    error: ErrorPlot | None = None
    grid: SpeedGrid | None = None  # of starts whose times are compared by entry speed


def median_column(
    metric: str, label: str, meaning: str, form: str = ".2f", scale: float = 1.0
) -> ResultColumn:
    """Compute the median size of a metric over starts."""
    return ResultColumn(
        metric, label, meaning, lambda runs, _: float(np.median(runs.metric(metric))), form, scale
    )


def high_column(metric: str, label: str, form: str = ".2f", scale: float = 1.0) -> ResultColumn:
    """Compute the size of a metric that nine in ten starts stay below."""
    return ResultColumn(
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
    time = ResultColumn(
        "time", "time [s]", "of an episode, median over starts",
        lambda runs, _: float(np.median(runs.time)),
    )  # fmt: skip
    first = task.metrics[0] if task.metrics else None
    error = None if first is None else ErrorPlot(first, first.replace("_", " "))
    return Benchmark(task, (*columns, time), error=error)


@dataclass(frozen=True, eq=False)
class Offer:
    """A stream of parcels that is offered to every method.

    Args:
        name: for tables.
        task: with its stream, its exits, and how long it takes.
        rates: [parcels/h] offered: of several the first at which nearly all leave rightly, else the
            last; None: the stream's own; `ENTRANCE`: all that the entrance takes. Without a rate
            the highest is searched that a method sustains.
        group: of offers that a table shows together; only the first group is compared by default.
        arguments: of the environment beside the method's, as sensors that no preset has.
        kinds: of methods that are compared.
        most_touches: [-] per delivery allowed where controllers choose clearances in a trial.
    """

    name: str
    task: Any  # a `StreamTask`
    rates: tuple[float | None, ...] = (None,)
    group: str = ""
    arguments: dict[str, Any] = field(default_factory=dict)
    kinds: tuple[str, ...] = KINDS
    most_touches: float = 0.0

    @property
    def scenario(self) -> str:
        """The name by which results are kept."""
        return f"{self.name}, {self.group}" if self.group else self.name


@dataclass(frozen=True, eq=False)
class StreamBenchmark:
    """The streams that methods are compared on, and the columns of the task's table."""

    task: Any  # a `StreamTask`
    offers: tuple[Offer, ...]
    columns: tuple[ResultColumn, ...]  # beside the rate and the share of right parcels
    description: str  # of the offers
    presets: tuple[str, ...] = ("exact", "camera")  # of streams
    replications: int = 10
    warm_up: float = 0.0  # [s] at least, in which nothing counts
    filmed: str = ""  # name of the offer on film; "": the first
    held_out: tuple[Offer, ...] = ()  # that no agent trained on, with sensors of their own


def mean_column(
    name: str, label: str, meaning: str, form: str = ".1f", scale: float = 1.0, unit: str = ""
) -> ResultColumn:
    """Compute the mean of a statistic of streams, by the parcels delivered."""
    return ResultColumn(name, label, meaning, lambda runs, _: runs.mean(name), form, scale, unit)


def share_column(name: str, label: str, meaning: str) -> ResultColumn:
    """Compute a share [%] that is a statistic of streams."""
    return mean_column(name, label, meaning, ".2f", 100.0, " %")


TOUCHES = mean_column("touches_per_1000", "touches", "per 1000 parcels delivered", ".0f")
STAY = mean_column("time_mean", "time [s]", "on the surface, mean")


def default_stream_benchmark(task: Any) -> StreamBenchmark:
    """Offer a task's own stream for two minutes."""
    offers = (Offer("its own stream", replace(task, duration=120.0)),)
    return StreamBenchmark(task, offers, (TOUCHES, STAY), "the task's own stream")
