"""Arrivals of parcels: at a rate, by a schedule, or from a recorded trace.

The first parcel arrives at time 0, or as soon as the rate of a schedule is above 0.
"""

import csv
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks, files
from surface_gym.flow.exits import EDGE, Exits, Inlets, check_name, check_several
from surface_gym.parcel import Parcel, Rectangle

Numbers = NDArray[np.float64]
Places = NDArray[np.int64]

HOUR = 3600.0  # [s]
LATEST = 1e9  # [s] maximum time of an arrival or a change of rate: 30 years
FASTEST = 5.0  # [m/s] maximum speed at arrival


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Parcels of one episode, in order of their arrival."""

    time: Numbers  # (parcels,) [s] in ascending order, within the episode
    parcel: Places  # (parcels,) index among the kinds
    kinds: tuple[Parcel, ...]
    speed: Numbers  # (parcels,) [m/s] along the line
    exit: Places  # (parcels,) index among the exits
    inlet: Places  # (parcels,) index among the inlets
    # (parcels,) [-] lateral position in the inlet: -1 right, 0 middle, 1 left, seen along the
    # motion
    aside: Numbers
    turned: Numbers  # (parcels,) [rad] angle from the direction of motion
    number: Places  # (parcels,) 0, 1, 2 ...: required order of departure, if there is one

    def __len__(self) -> int:
        return len(self.time)


class Law(ABC):
    """Base class of laws of arrival times."""

    @abstractmethod
    def times(self, rng: np.random.Generator, duration: float) -> Numbers:
        """Draw ascending arrival times (parcels,) [s] of an episode, below `duration` [s]."""


@dataclass(frozen=True)
class RateLaw(Law):
    """Base class of arrival laws with one mean rate."""

    rate: float  # [parcels/h] mean

    def __post_init__(self) -> None:
        checks.settle(self, rate=(checks.positive, *checks.RATE))


@dataclass(frozen=True)
class Steady(RateLaw):
    """Equal gaps: parcel k arrives at the time k * 3600 / rate [s]."""

    def times(self, rng: np.random.Generator, duration: float) -> Numbers:
        del rng
        gap = HOUR / self.rate
        return _before(duration, gap * np.arange(int(duration / gap) + 2.0))


@dataclass(frozen=True)
class Spread(RateLaw):
    """Uniform gaps with the mean 3600 / rate [s], and deviations up to `spread` times the mean."""

    spread: float  # [-]

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.settle(self, spread=_spread)

    def times(self, rng: np.random.Generator, duration: float) -> Numbers:
        mean = HOUR / self.rate
        low, high = (1.0 - self.spread) * mean, (1.0 + self.spread) * mean
        return _sums(lambda count: rng.uniform(low, high, count), mean, duration)


@dataclass(frozen=True)
class Poisson(RateLaw):
    """Gaps with a fixed part `least_gap` and an exponential part. The mean gap is 3600 / rate [s].

    Without a least gap, the arrivals after the first are a Poisson process.
    """

    least_gap: float = 0.0  # [s]

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.settle(self, least_gap=checks.not_negative)
        if self.least_gap > HOUR / self.rate:
            raise ValueError(
                f"least_gap must be at most the mean gap, {HOUR / self.rate:g} s "
                f"at a rate of {self.rate:g} parcels/h, got {self.least_gap!r}"
            )

    def times(self, rng: np.random.Generator, duration: float) -> Numbers:
        mean, least = HOUR / self.rate, self.least_gap
        return _sums(
            lambda count: least + (mean - least) * rng.standard_exponential(count), mean, duration
        )


@dataclass(frozen=True)
class Schedule(Law):
    """A rate that changes at given times; the last rate holds to the end of the episode.

    Parcel k arrives when the integral of the rate reaches the sum of k numbers, each uniform
    between 1 - spread and 1 + spread. At a constant rate, the law equals `Spread`.
    """

    rates: tuple[tuple[float, float], ...]  # [s] start of a rate, and the rate [parcels/h]
    spread: float = 0.0  # [-]

    def __post_init__(self) -> None:
        time, rate = checks.array("rates", self.rates, (None, 2)).T
        checks.limited("times of rates", time, LATEST)
        checks.limited("rates", rate, checks.RATE[1])
        if len(time) == 0 or time[0] != 0.0 or (np.diff(time) <= 0.0).any():
            raise ValueError(f"rates must be at times that rise from 0, got {time.tolist()}")
        if rate.min() < 0.0 or rate.max() == 0.0:
            raise ValueError(
                f"rates must be at least 0, and one of them greater, got {rate.tolist()}"
            )
        pairs = zip(time.tolist(), rate.tolist(), strict=True)
        checks.set_fields(self, rates=tuple(pairs))
        checks.settle(self, spread=_spread)

    @cached_property
    def _steps(self) -> tuple[Numbers, Numbers, Numbers]:
        """Return each step's start [s], rate [parcels/s] and expected number of earlier parcels."""
        time, rate = np.array(self.rates).T
        rate = rate / HOUR
        return time, rate, np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(time))])

    def times(self, rng: np.random.Generator, duration: float) -> Numbers:
        time, rate, due = self._steps
        last = np.searchsorted(time, duration, side="right") - 1
        all_due = due[last] + rate[last] * (duration - time[last])
        low, high = 1.0 - self.spread, 1.0 + self.spread
        count = _sums(lambda number: rng.uniform(low, high, number), 1.0, all_due)
        # The last step with fewer expected earlier parcels; after steps of rate 0, the next one.
        step = np.searchsorted(due, count, side="right") - 1
        return _before(duration, time[step] + (count - due[step]) / rate[step])


# Checks of an arriving parcel: its speed [m/s], lateral position in the inlet [-] and angle [rad].
check_speed = partial(checks.positive, most=FASTEST)
check_aside = partial(checks.within, low=-1.0, high=1.0)
check_turned = partial(checks.angle, low=-math.pi, high=math.pi)


def _spread(name: str, value: Any) -> float:
    if checks.within(name, value, 0.0, 1.0) == 1.0:
        raise ValueError(f"{name} must be less than 1, got {value!r}")
    return float(value)


def _sums(draw: Callable[[int], Numbers], mean: float, end: float) -> Numbers:
    """Return cumulative sums (n,) of random gaps. The first sum is 0. All sums are below `end`.

    `draw(count)` draws gaps whose mean is `mean`. One call of `draw` is almost always enough.
    """
    block = int(1.1 * end / mean) + 16
    sums = np.concatenate([[0.0], np.cumsum(draw(block))])
    while sums[-1] < end:
        sums = np.concatenate([sums, sums[-1] + np.cumsum(draw(block))])
    return _before(end, sums)


def _before(end: float, rising: Numbers) -> Numbers:
    return rising[: np.searchsorted(rising, end)]


COLUMNS = ("time", "length", "width", "mass", "speed", "exit")  # [s, m, m, kg, m/s], a name
MORE_COLUMNS = ("inlet", "aside", "turned")  # optional columns: a name, [-], [rad]


@dataclass(frozen=True)
class Arrival:
    """One parcel of a trace."""

    time: float  # [s]
    parcel: Parcel
    speed: float  # [m/s] along the line
    exit: str  # name of its destination
    inlet: str | None = None  # name of the inlet; None: the first
    aside: float = 0.0  # [-] lateral position in the inlet: -1 right, 1 left, seen along the motion
    turned: float = 0.0  # [rad] angle from the direction of motion

    def __post_init__(self) -> None:
        checks.settle(
            self,
            time=(checks.not_negative, LATEST), parcel=(checks.instance, Parcel, "a Parcel"),
            speed=check_speed, exit=check_name, inlet=check_name,
            aside=check_aside, turned=check_turned,
        )  # fmt: skip


@dataclass(frozen=True)
class Trace:
    """A recorded stream: arrivals with their parcels, speeds and destinations."""

    arrivals: tuple[Arrival, ...]

    def __post_init__(self) -> None:
        checks.settle(self, arrivals=(check_several, Arrival))
        for before, after in itertools.pairwise(self.arrivals):
            _check_order(before, after)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Distinct names of the destinations."""
        return tuple(dict.fromkeys(each.exit for each in self.arrivals))

    @cached_property
    def kinds(self) -> tuple[Parcel, ...]:
        """Distinct parcels."""
        return tuple(dict.fromkeys(each.parcel for each in self.arrivals))

    def check(self, exits: Exits, inlets: Inlets = EDGE) -> None:
        """Raise a ValueError if a destination is not in `exits`, or an inlet not in `inlets`."""
        for name in self.names:
            exits.place(name)
        for each in self.arrivals:
            if each.inlet is not None:
                inlets.place(each.inlet)

    def within(self, duration: float, exits: Exits, inlets: Inlets = EDGE) -> Arrivals:
        """Return the arrivals before `duration` [s], renumbered in order.

        Names of exits and inlets become indices into `exits` and `inlets`.
        """
        first = [each for each in self.arrivals if each.time < duration]
        kind = {parcel: place for place, parcel in enumerate(self.kinds)}
        inlet = [0 if each.inlet is None else inlets.place(each.inlet) for each in first]
        return Arrivals(
            time=np.array([each.time for each in first]),
            parcel=np.array([kind[each.parcel] for each in first], dtype=np.int64),
            kinds=self.kinds,
            speed=np.array([each.speed for each in first]),
            exit=np.array([exits.place(each.exit) for each in first], dtype=np.int64),
            inlet=np.array(inlet, dtype=np.int64),
            aside=np.array([each.aside for each in first]),
            turned=np.array([each.turned for each in first]),
            number=np.arange(len(first)),
        )


def read_trace(path: str | PathLike[str], exits: Exits | None = None) -> Trace:
    """Read a trace from a .csv file (UTF-8).

    The first line names the columns in any order: time [s], length [m], width [m], mass [kg], speed
    [m/s], and the name of the exit. Optional columns are the name of the inlet, and `aside` [-] and
    `turned` [rad] as in `Arrivals`. Each further line is one parcel. The lines are sorted by time.
    Blank lines are skipped. If `exits` is given, it must contain every parcel's exit.

    Every line must end in a line break, so that an incomplete last line is detected.

    Raises:
        ValueError: the file is invalid; the message names the file and the line.
        FileNotFoundError: there is no such file.
    """
    arrivals: list[Arrival] = []
    lines = csv.reader(files.read_lines(Path(path)), strict=True)
    rows = filter(None, lines)
    try:
        header = [name.strip() for name in next(rows, [])]
        _check_header(header)
        for row in rows:
            arrival = _arrival(header, row)
            if arrivals:
                _check_order(arrivals[-1], arrival)
            if exits is not None:
                exits.place(arrival.exit)
            arrivals.append(arrival)
        if not arrivals:
            raise ValueError("a parcel must follow, got the end of the file")
    except (ValueError, csv.Error) as error:
        reason = files.describe_at_line(error, max(1, lines.line_num))
        raise ValueError(f"{path} holds no trace: {reason}") from None
    return Trace(tuple(arrivals))


def write_trace(
    path: str | PathLike[str], arrivals: Arrivals, exits: Exits, inlets: Inlets = EDGE
) -> None:
    """Write the arrivals of an episode in the format of `read_trace`.

    Exits and inlets must be the same as when the arrivals were drawn. The required order of
    departure is not written, since a trace always requires the order of arrival.

    Raises:
        ValueError: there are no arrivals, or a parcel has more properties than length, width and
            mass.
        OSError: the file cannot be written.
    """
    if len(arrivals) == 0:
        raise ValueError("arrivals must be at least one parcel, got none")
    sizes = [_size(parcel) for parcel in arrivals.kinds]
    placed = bool(arrivals.aside.any() or arrivals.turned.any() or arrivals.inlet.any())
    with open(path, "w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS + (MORE_COLUMNS if placed else ()))
        for k in range(len(arrivals)):
            time, speed = arrivals.time.item(k), arrivals.speed.item(k)
            row = [time, *sizes[arrivals.parcel[k]], speed, exits.names[arrivals.exit[k]]]
            if placed:
                inlet = inlets.names[arrivals.inlet[k]]
                row += [inlet, arrivals.aside.item(k), arrivals.turned.item(k)]
            rows.writerow(row)


def _size(parcel: Parcel) -> tuple[float, float, float]:
    """Return length, width [m] and mass [kg]; raise a ValueError if other fields are set."""
    base = parcel.base
    if not isinstance(base, Rectangle) or parcel != Parcel(base, parcel.mass):
        raise ValueError(
            f"arrivals must be rectangles with a mass, and all else by default, got {parcel!r}"
        )
    return base.length, base.width, parcel.mass


def _check_header(header: list[str]) -> None:
    for name in header:
        checks.one_of("column", name, COLUMNS + MORE_COLUMNS)
    missing = [name for name in COLUMNS if name not in header]
    if missing or len(header) > len(set(header)):
        raise ValueError(
            f"columns must be {', '.join(COLUMNS)}, each once, got {', '.join(header) or 'none'}"
        )


def _arrival(header: list[str], row: list[str]) -> Arrival:
    if len(row) != len(header):
        raise ValueError(f"a row must have {len(header)} entries, got {len(row)}")
    text = dict(zip(header, row, strict=True))
    time, length, width, mass, speed = (
        files.parse_number(name, text[name]) for name in COLUMNS[:-1]
    )
    parcel = Parcel(Rectangle(length, width), mass)
    aside, turned = (
        files.parse_number(name, text[name]) if name in text else 0.0 for name in MORE_COLUMNS[1:]
    )
    inlet = text["inlet"].strip() if "inlet" in text else None
    return Arrival(time, parcel, speed, text["exit"].strip(), inlet, aside, turned)


def _check_order(before: Arrival, after: Arrival) -> None:
    if after.time < before.time:
        raise ValueError(f"time must not fall, got {after.time!r} after {before.time!r}")
