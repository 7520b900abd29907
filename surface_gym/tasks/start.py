"""Starts of episodes, from random numbers and from the options of `reset`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.layouts import box
from surface_gym.lines import BaseLine
from surface_gym.parcel import Parcel

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Parcels:
    """Parcels of several starts. Starts with equal parcels share an entry of `kinds`."""

    kinds: tuple[Parcel, ...]
    which: NDArray[np.int64]  # (starts,) index of each start's parcel among the kinds

    def of(self, function: Callable[[Parcel], ArrayLike]) -> Numbers:
        """Return a function's values (starts, ...) for the starts' parcels."""
        asked, places = np.unique(self.which, return_inverse=True)
        return np.array([function(self.kinds[kind]) for kind in asked])[places]

    @property
    def rear(self) -> Numbers:
        """(starts,) [m] distance from a base's rearmost point to its frame's origin."""
        return self.of(lambda parcel: parcel.rear)


class Start(NamedTuple):
    """Starts of episodes.

    A number applies to every start; an array (starts,) has one value per start.
    """

    parcel: Parcel | Parcels
    pose: tuple[ArrayLike, ArrayLike, ArrayLike]  # [m, m, rad] of the base's frame
    velocity: tuple[ArrayLike, ArrayLike, ArrayLike]  # [m/s, m/s, rad/s]
    goal: tuple[ArrayLike, ...]  # goal of the task, with `goals` entries
    tilt: ArrayLike = 0.0  # [rad] tilt of the surface, downhill towards `tilt_direction`
    # (PATH_POINTS,) or (starts, PATH_POINTS) [m] y of the path to follow
    path: Numbers | None = None
    tilt_direction: ArrayLike = 0.0  # [rad] downhill direction, anti-clockwise from +x


class Draw:
    """Source of starts: uniform random numbers, and options that replace drawn values.

    Args:
        numbers: (starts, draws) random numbers, uniform in [0, 1).
        options: options of `reset` for each start. If empty, no drawn value is replaced.
        line: the line on which the parcels start.
        zone: the zone's first and last column. If None, the zone is the line's zone for a parcel.
    """

    def __init__(
        self,
        numbers: Numbers,
        options: Sequence[Mapping[str, Any]],
        line: BaseLine,
        zone: tuple[int, int] | None = None,
    ) -> None:
        self.numbers = numbers.T  # (draws, starts)
        self.line = line
        self.zone = zone
        self._starts = len(numbers)
        self._options = options

    def option(self, name: str, drawn: ArrayLike, check: Callable[[Any], float]) -> Numbers:
        """Return the value of the option `name` for each start, shape (starts,).

        `check` checks a given value. For a start without the option, use the value in `drawn`.
        """
        values: Numbers = np.asarray(drawn, dtype=np.float64)
        given = self.given(name)
        if given:
            values = np.full(self._starts, values)
            for start, value in given:
                values[start] = check(value)
        return values

    def within(self, name: str, drawn: ArrayLike, low: float, high: float) -> Numbers:
        """Return values (starts,) of option `name` in [low, high]. The default is `drawn`."""
        return self.option(name, drawn, lambda value: checks.within(name, value, low, high))

    def angle(self, name: str, drawn: ArrayLike, low: float, high: float) -> Numbers:
        """Return angles (starts,) [rad]. The option `name`, in [low, high], replaces `drawn`."""
        return self.option(name, drawn, lambda value: checks.angle(name, value, low, high))

    def one_of(self, name: str, drawn: ArrayLike, allowed: tuple[Any, ...]) -> Numbers:
        """Return values (starts,) of option `name`, each in `allowed`. The default is `drawn`."""
        return self.option(name, drawn, lambda value: float(checks.one_of(name, value, allowed)))

    def parcel(self, parcels: tuple[Parcel, ...], number: Numbers) -> Parcels:
        """Draw the starts' parcels with equal odds. The option "parcel" replaces a drawn parcel."""
        which = (number * len(parcels)).astype(np.int64)
        kinds = list(parcels)
        for start, value in self.given("parcel"):
            which[start] = len(kinds)
            kinds.append(parcel_option(value))
        return Parcels(tuple(kinds), which)

    def given(self, name: str) -> list[tuple[int, Any]]:
        """Return pairs (index of the start, value) for all starts with the option `name`."""
        return [(k, each[name]) for k, each in enumerate(self._options) if name in each]


def between(low: float | Numbers, high: float | Numbers, number: Numbers) -> Numbers:
    """Scale random numbers (starts,) from the interval [0, 1) to the interval [low, high)."""
    return low + (high - low) * number


def parcel_option(value: Any) -> Parcel:
    """Return the parcel of an option, which is "S", "B" or a Parcel."""
    if isinstance(value, Parcel):
        return value
    if isinstance(value, str) and value in ("S", "B"):
        return box(value)
    raise ValueError(f"parcel must be 'S', 'B' or a Parcel, got {value!r}")


def parcels_to_draw(parcels: Any) -> tuple[Parcel, ...]:
    """Return a task's parcels as a tuple. Missing or invalid parcels raise a ValueError."""
    if not parcels:
        raise ValueError(f"parcels must be at least one, got {parcels!r}")
    return tuple(parcel_option(parcel) for parcel in parcels)


def check_options(options: dict[str, Any] | None, allowed: tuple[str, ...]) -> dict[str, Any]:
    """Return the options of `reset`. Raise a ValueError if an option's name is not in `allowed`."""
    if options is None:
        return {}
    if not isinstance(options, dict):
        raise ValueError(f"options must be a dict or None, got {options!r}")
    for name in options:
        checks.one_of("options", name, allowed)
    return options
