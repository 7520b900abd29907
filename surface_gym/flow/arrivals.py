"""Arrivals: the laws by which parcels come in one after the other, and what an episode drew.

By every law the first parcel comes at time 0, or as soon as a schedule lets any come: the line is
empty before it, and waiting for it would only shift the episode.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.parcel import Parcel

Numbers = NDArray[np.float64]
Places = NDArray[np.int64]

HOUR = 3600.0  # [s]
LATEST = 1e9  # [s] that a rate may change at, or a recorded parcel come: 30 years
FASTEST = 5.0  # [m/s] that a parcel may come in at


@dataclass(frozen=True, eq=False)
class Arrivals:
    """The parcels of one episode, in the order they come."""

    time: Numbers  # (parcels,) [s] none falls, all within the episode
    parcel: Places  # (parcels,) the place of each among the kinds
    kinds: tuple[Parcel, ...]
    speed: Numbers  # (parcels,) [m/s] along the line
    exit: Places  # (parcels,) the place of each one's among the exits

    def __len__(self) -> int:
        return len(self.time)


class Law(ABC):
    """When parcels come."""

    @abstractmethod
    def times(self, rng: np.random.Generator, duration: float) -> Numbers:
        """Draw an episode's times of arrival.

        Args:
            rng: the only source of chance.
            duration: [s] of the episode, greater than 0.

        Returns:
            (parcels,) [s] rising, from 0 and less than the duration.
        """


@dataclass(frozen=True)
class Steady(Law):
    """Equal gaps: parcel k comes at k * 3600 / rate. Nothing is drawn.

    Raises:
        ValueError: a rate that is not positive.
    """

    rate: float  # [parcels/h]

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", checks.positive("rate", self.rate, *checks.RATE))

    def times(self, rng: np.random.Generator, duration: float) -> Numbers:  # noqa: ARG002
        gap = HOUR / self.rate
        return _before(duration, gap * np.arange(int(duration / gap) + 2.0))


@dataclass(frozen=True)
class Spread(Law):
    """Gaps uniform between 1 - spread and 1 + spread times the mean, 3600 / rate.

    Raises:
        ValueError: a rate that is not positive, a spread outside [0, 1).
    """

    rate: float  # [parcels/h] mean
    spread: float  # [-]

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", checks.positive("rate", self.rate, *checks.RATE))
        object.__setattr__(self, "spread", _spread(self.spread))

    def times(self, rng: np.random.Generator, duration: float) -> Numbers:
        mean = HOUR / self.rate
        low, high = (1.0 - self.spread) * mean, (1.0 + self.spread) * mean
        return _sums(lambda count: rng.uniform(low, high, count), mean, duration)


@dataclass(frozen=True)
class Poisson(Law):
    """Gaps of `least_gap` and an exponential number beyond it, their mean 3600 / rate in all.

    Without a least gap, the arrivals after the first are a Poisson process.

    Raises:
        ValueError: a rate that is not positive, a least gap that is negative or longer than the
            mean gap.
    """

    rate: float  # [parcels/h] mean
    least_gap: float = 0.0  # [s]

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", checks.positive("rate", self.rate, *checks.RATE))
        object.__setattr__(self, "least_gap", checks.not_negative("least_gap", self.least_gap))
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
    """A rate that changes at given times; the last goes on, and at a rate of 0 nobody comes.

    Parcel k comes when the integral of the rate reaches the sum of k numbers, each uniform between
    1 - spread and 1 + spread: so at a constant rate the gaps are those of `Spread`.

    Raises:
        ValueError: rates that are no pairs, times that do not rise from 0, a negative rate, rates
            that are all 0, a spread outside [0, 1).
    """

    rates: tuple[tuple[float, float], ...]  # [s] from when on, and [parcels/h] how many come
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
        object.__setattr__(self, "rates", tuple(pairs))
        object.__setattr__(self, "spread", _spread(self.spread))

    @cached_property
    def _steps(self) -> tuple[Numbers, Numbers, Numbers]:
        """(rates,) time [s], rate [parcels/s], and how many parcels are due by that time."""
        time, rate = np.array(self.rates).T
        rate = rate / HOUR
        return time, rate, np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(time))])

    def times(self, rng: np.random.Generator, duration: float) -> Numbers:
        time, rate, due = self._steps
        last = np.searchsorted(time, duration, side="right") - 1
        all_due = due[last] + rate[last] * (duration - time[last])
        low, high = 1.0 - self.spread, 1.0 + self.spread
        count = _sums(lambda number: rng.uniform(low, high, number), 1.0, all_due)
        # The last of the steps that fewer are due by: where nobody comes, the one that ends it.
        step = np.searchsorted(due, count, side="right") - 1
        return _before(duration, time[step] + (count - due[step]) / rate[step])


def check_speed(name: str, value: Any) -> float:
    """A speed [m/s] that a parcel may come in at, or an error."""
    return checks.within(name, checks.positive(name, value), 0.0, FASTEST)


def _spread(value: Any) -> float:
    if checks.within("spread", value, 0.0, 1.0) == 1.0:
        raise ValueError(f"spread must be less than 1, got {value!r}")
    return float(value)


def _sums(draw: Callable[[int], Numbers], mean: float, end: float) -> Numbers:
    """(n,) 0 and the sums of the first 1, 2, ... gaps drawn, as far as they are below an end.

    The gaps are drawn in blocks: one is nearly always enough.
    """
    block = int(1.1 * end / mean) + 16
    sums = np.concatenate([[0.0], np.cumsum(draw(block))])
    while sums[-1] < end:
        sums = np.concatenate([sums, sums[-1] + np.cumsum(draw(block))])
    return _before(end, sums)


def _before(end: float, rising: Numbers) -> Numbers:
    return rising[: np.searchsorted(rising, end)]
