"""Benchmarks of tasks: the scenarios that `evaluate.py` compares, and the columns of its tables.

A scenario of a task with one parcel is a list of starts. A scenario of a stream task is a stream.
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

DRAWN = 500  # number of random starts
ENTRANCE = math.inf  # offered rate above every entry limit
# Default kinds of compared methods on a stream; another kind is "planner".
KINDS = ("baseline", "rule", "agent")
PARCELS = ("S", "B")
SIDES = (1, -1)


class Runs(Protocol):
    """Results of one method, with the same episodes for each of the method's seeds."""

    @property
    def success(self) -> NDArray[np.bool_]:
        """(seeds, starts) whether an episode succeeded."""

    @property
    def time(self) -> Numbers:
        """Durations [s] of episodes, shape (seeds, starts)."""

    def metric(self, name: str) -> Numbers:
        """Return absolute values (seeds, starts) of the task's metric `name`."""

    def mean(self, name: str) -> float:
        """Return a statistic's mean over streams, weighted by deliveries, or NaN without values."""

    def most(self, name: str) -> float:
        """Return the largest value of the statistic `name` among all streams."""


@dataclass(frozen=True)
class ResultColumn:
    """A column of a task's table of results, after the success rates."""

    name: str
    label: str
    meaning: str
    # from results of a method and of the fixed layout; NaN: none
    value: Callable[[Runs, Runs], float]
    form: str = ".2f"
    scale: float = 1.0  # to the label's unit
    unit: str = ""  # unit after the number
    every_start: bool = False  # whether it needs results of all starts


@dataclass(frozen=True, eq=False)
class SpeedGrid:
    """One start for each box, entry speed and side. The order is by box, then by speed and side."""

    speeds: Numbers  # (speeds,) [m/s]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of parcels, speeds and sides."""
        return (len(PARCELS), len(self.speeds), len(SIDES))

    @property
    def starts(self) -> tuple[dict[str, Any], ...]:
        """Options of `reset` for each start."""
        return tuple(
            {"speed": speed, "side": side, "parcel": parcel}
            for parcel in PARCELS
            for speed in self.speeds.tolist()
            for side in SIDES
        )

    def success(self, runs: Runs, parcel: str) -> NDArray[np.bool_]:
        """Return a mask (seeds, speeds). True means that the parcel succeeds for every goal side.

        The name of the parcel is "S" or "B".
        """
        return np.asarray(self._of(runs.success, parcel).all(axis=-1))

    def success_rate(self, runs: Runs, parcel: str) -> float:
        """Return the success rate [-] over all starts with a parcel, "S" or "B"."""
        return float(self._of(runs.success, parcel).mean())

    def slower_time(self, runs: Runs, parcel: str) -> Numbers:
        """Return the longer time (seeds, speeds) [s] of the two goal sides, or inf for failures."""
        time: Numbers = self._of(np.where(runs.success, runs.time, np.inf), parcel)
        return np.asarray(time.max(axis=-1))

    def minimum_speed(self, runs: Runs, parcel: str) -> float:
        """Return the lowest speed [m/s] such that this and all higher speeds succeed, or NaN."""
        fails = np.nonzero(~self.success(runs, parcel).all(axis=0))[0]
        first = 0 if len(fails) == 0 else int(fails[-1]) + 1
        return float(self.speeds[first]) if first < len(self.speeds) else float("nan")

    def worst_time(self, runs: Runs, fixed: Runs, parcel: str) -> float:
        """Return the largest ratio, over all speeds, of a method's time to the fixed layout's time.

        `runs` are the method's results, and `fixed` are the layout's results. Only speeds at which
        the layout succeeds count.
        """
        reference = self.slower_time(fixed, parcel)[0]
        managed = np.isfinite(reference)
        return float((self.slower_time(runs, parcel)[:, managed] / reference[managed]).max())

    def _of(self, values: NDArray[Any], parcel: str) -> NDArray[Any]:
        return np.asarray(values.reshape(-1, *self.shape)[:, PARCELS.index(parcel)])


@dataclass(frozen=True, eq=False)
class Benchmark:
    """The starts that `evaluate.py` compares, and the columns of the task's table."""

    task: "Task"
    columns: tuple[ResultColumn, ...]
    starts: tuple[dict[str, Any], ...] = ({},) * DRAWN  # reset options; all other values are drawn
    description: str = "drawn by the task's own law"  # what starts have in common
    example: dict[str, Any] = field(default_factory=dict)  # reset options of the filmed start
    example_description: str = "a start drawn by the task"
    error: str | None = None  # metric that tells how good a success is; None: the time
    grid: SpeedGrid | None = None  # starts whose times are compared by entry speed


def median_column(
    metric: str, label: str, meaning: str, form: str = ".2f", scale: float = 1.0
) -> ResultColumn:
    """Make a `ResultColumn` with the median of a metric's absolute value over starts."""
    return ResultColumn(
        metric, label, meaning, lambda runs, _: float(np.median(runs.metric(metric))), form, scale
    )


def high_column(metric: str, label: str, form: str = ".2f", scale: float = 1.0) -> ResultColumn:
    """Make a `ResultColumn` with the 90th percentile of a metric's absolute value over starts."""
    return ResultColumn(
        f"{metric}_90", label, "nine in ten are better",
        lambda runs, _: float(np.quantile(runs.metric(metric), 0.9)), form, scale,
    )  # fmt: skip


def default_benchmark(task: "Task") -> Benchmark:
    """Return a benchmark with random starts, and with columns for all metrics and the time."""
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
    return Benchmark(task, (*columns, time), error=next(iter(task.metrics), None))


@dataclass(frozen=True, eq=False)
class Offer:
    """A stream of parcels offered to every method.

    Args:
        task: task with stream, exits and duration.
        rates: [parcels/h] rates of arrival. None means the stream's own rate. `ENTRANCE` means the
            entry limit. The rates are tried in order, until nearly all departures are correct. The
            result is from the last tried rate. If `rates` is empty, the result is the highest
            sustained rate.
        group: name of a group of offers. The default comparison has only the first group.
        arguments: additional arguments of the environment, e.g. sensors that no preset has.
        kinds: kinds of methods that are compared.
        most_touches: [-] maximum number of touches per delivery. A scheduler chooses its clearance
            so that simulations in advance have at most this number.
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
        """Name of the offer in the file of results."""
        return f"{self.name}, {self.group}" if self.group else self.name


@dataclass(frozen=True, eq=False)
class StreamBenchmark:
    """The streams that `evaluate.py` compares, and the columns of the task's table."""

    task: Any  # a `StreamTask`
    offers: tuple[Offer, ...]
    columns: tuple[ResultColumn, ...]  # columns after the rate and the share of correct departures
    description: str  # description of the offers
    presets: tuple[str, ...] = ("exact", "camera")  # presets of the streams
    replications: int = 10
    warm_up: float = 0.0  # [s] minimum time before counting begins
    filmed: str = ""  # name of the filmed offer; "": the first
    held_out: tuple[Offer, ...] = ()  # offers without trained agents, with their own sensors


def mean_column(
    name: str, label: str, meaning: str, form: str = ".1f", scale: float = 1.0, unit: str = ""
) -> ResultColumn:
    """Make a `ResultColumn` with a statistic's mean over streams, weighted by deliveries."""
    return ResultColumn(name, label, meaning, lambda runs, _: runs.mean(name), form, scale, unit)


def share_column(name: str, label: str, meaning: str) -> ResultColumn:
    """Make a `ResultColumn` with the mean [%] of a stream statistic that ranges from 0 to 1."""
    return mean_column(name, label, meaning, ".2f", 100.0, " %")


TOUCHES = mean_column("touches_per_1000", "touches", "per 1000 parcels delivered", ".0f")
STAY = mean_column("time_mean", "time [s]", "on the surface, mean")


def default_stream_benchmark(task: Any) -> StreamBenchmark:
    """Return a benchmark with the task's own stream, in episodes of two minutes."""
    offers = (Offer("its own stream", replace(task, duration=120.0)),)
    return StreamBenchmark(task, offers, (TOUCHES, STAY), "the task's own stream")
