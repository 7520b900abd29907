"""Streams of parcels: arrivals, kinds, speeds and destinations."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from os import PathLike
from typing import Any, TypeVar

import numpy as np

from surface_gym import checks
from surface_gym.flow import arrivals as laws
from surface_gym.flow.arrivals import Arrivals, Law, Numbers, Places, RateLaw, Steady, Trace
from surface_gym.flow.exits import EDGE, Exits, Inlets, check_name
from surface_gym.parcel import Parcel
from surface_gym.tasks.start import parcel_option

Of = TypeVar("Of")

LAWS = "Steady, Spread, Poisson, Schedule or a Trace"
EVERY_THREE_SECONDS = Steady(rate=1200.0)


@dataclass(frozen=True)
class Stream:
    """A stream of parcels; a parcel's kind, destination and speed are drawn independently.

    A `Trace` (recorded stream) has its own parcels, destinations and speeds.

    >>> import numpy as np
    >>> from surface_gym.flow.arrivals import Spread
    >>> from surface_gym.flow.exits import sides
    >>> stream = Stream(
    ...     Spread(rate=900.0, spread=0.5),
    ...     parcels=(("S", 3.0), ("B", 1.0)),  # three small parcels per large parcel
    ...     destinations={"left": 2.0, "right": 1.0},  # no parcel goes straight on
    ...     speeds=(1.0, 1.5),
    ... )
    >>> arrivals = stream.draw(np.random.default_rng(0), duration=20.0, exits=sides())
    >>> arrivals.time.round(1).tolist()
    [0.0, 4.5, 7.6, 9.8, 11.9, 17.1]
    >>> [arrivals.kinds[place].base.length for place in arrivals.parcel]
    [0.25, 0.25, 0.45, 0.25, 0.25, 0.25]
    """

    arrivals: Law | Trace = EVERY_THREE_SECONDS
    # "S", "B" or a Parcel, or pairs of a parcel and its odds (default 1)
    parcels: Any = ("S",)
    # odds of exits by name, as a mapping or as pairs; None: equal odds
    destinations: Any = None
    speeds: Any = 1.5  # [m/s] one speed, or the bounds of a uniform draw
    # odds of inlets by name, as a mapping or as pairs; None: equal odds
    origins: Any = None
    # [-] lateral position in the inlet: -1 right, 0 middle, 1 left, seen along the motion; or the
    # bounds of a uniform draw
    aside: Any = 0.0
    turned: Any = 0.0  # [rad] angle from the direction of motion, or the bounds of a uniform draw
    # number of successive parcels in a random order of departure; 1: in order of arrival
    window: int = 1

    def __post_init__(self) -> None:
        checks.instance("arrivals", self.arrivals, (Law, Trace), LAWS)
        checks.set_fields(self, parcels=_parcels(self.parcels))
        checks.settle(
            self,
            destinations=_odds,
            origins=_odds,
            window=(checks.integer, 1),
            speeds=(_bounds, laws.check_speed),
            aside=(_bounds, laws.check_aside),
            turned=(_bounds, laws.check_turned),
        )
        if isinstance(self.arrivals, Trace):
            _check_nothing_beside(self)

    @classmethod
    def from_csv(cls, path: str | PathLike[str], exits: Exits | None = None) -> "Stream":
        """Read a recorded stream from a file. For the format and for `exits` see `read_trace`."""
        return cls(laws.read_trace(path, exits))

    @cached_property
    def kinds(self) -> tuple[Parcel, ...]:
        """The distinct parcels that may arrive."""
        if isinstance(self.arrivals, Trace):
            return self.arrivals.kinds
        return tuple(parcel for parcel, _ in self.parcels)

    def with_rate(self, rate: float) -> "Stream":
        """Return the stream at another mean rate [parcels/h].

        Raise a ValueError if `arrivals` is a Schedule or a Trace.
        """
        if not isinstance(self.arrivals, RateLaw):
            raise ValueError(
                f"arrivals must be Steady, Spread or Poisson to have another rate, "
                f"got {type(self.arrivals).__name__}"
            )
        return replace(self, arrivals=replace(self.arrivals, rate=rate))

    def check(self, exits: Exits, inlets: Inlets = EDGE) -> None:
        """Raise a ValueError if a destination is not in `exits` or an origin is not in `inlets`."""
        if isinstance(self.arrivals, Trace):
            self.arrivals.check(exits, inlets)
        for name, _ in self.destinations or ():
            checks.one_of("destinations", name, exits.names)
        for name, _ in self.origins or ():
            checks.one_of("origins", name, inlets.names)

    def draw(
        self, rng: np.random.Generator, duration: float, exits: Exits, inlets: Inlets = EDGE
    ) -> Arrivals:
        """Draw the arrivals of an episode of a duration [s].

        The order of draws is fixed, so a change of one parameter keeps all other draws:

        - all arrival times;
        - three numbers per parcel, for kind, exit and speed, even if only one value is possible;
        - two numbers per parcel, for lateral position and angle, if position or angle is random;
        - one number per parcel, for the parcel's inlet, if there are several inlets;
        - the order of departure within each window, i.e. each group of `window` parcels.
        """
        duration = checks.positive("duration", duration, most=checks.EPISODE)
        self.check(exits, inlets)
        if isinstance(self.arrivals, Trace):
            return self.arrivals.within(duration, exits, inlets)
        time = self.arrivals.times(rng, duration)
        kind, leaving, speed = rng.random((len(time), 3)).T
        drawn = isinstance(self.aside, tuple) or isinstance(self.turned, tuple)
        aside, turned = rng.random((len(time), 2)).T if drawn else np.zeros((2, len(time)))
        coming = rng.random(len(time)) if len(inlets) > 1 else np.zeros(len(time))
        return Arrivals(
            time=time,
            parcel=_draw_index([odds for _, odds in self.parcels], kind),
            kinds=self.kinds,
            speed=_between(self.speeds, speed),
            exit=_draw_by_name(self.destinations, exits, leaving),
            inlet=_draw_by_name(self.origins, inlets, coming),
            aside=_between(self.aside, aside),
            turned=_between(self.turned, turned),
            number=self._numbers(rng, len(time)),
        )

    def _numbers(self, rng: np.random.Generator, count: int) -> Places:
        """Return each parcel's place (count,) in the required order of departure.

        This order is the order of arrival, shuffled in each group of `window` parcels.
        """
        number = np.arange(count)
        if self.window > 1:
            for first in range(0, count, self.window):
                rng.shuffle(number[first : first + self.window])
        return number


def _draw_by_name(odds: Any, among: Exits | Inlets, number: Numbers) -> Places:
    """Draw indices of exits or inlets by their odds, from uniform numbers (n,) in [0, 1).

    `odds` are pairs of name and odds. If `odds` is None, all openings are equally likely.
    """
    if odds is None:
        return _draw_index([1.0] * len(among), number)
    place = np.array([among.place(name) for name, _ in odds])
    return place[_draw_index([each for _, each in odds], number)]


def _between(bounds: float | tuple[float, float], number: Numbers) -> Numbers:
    """Map uniform numbers (n,) in [0, 1) to a range, or to one number if `bounds` is one number."""
    low, high = bounds if isinstance(bounds, tuple) else (bounds, bounds)
    return low + (high - low) * number


def _draw_index(odds: list[float], number: Numbers) -> Places:
    """Draw indices by odds, from uniform numbers (n,) in [0, 1)."""
    shares = np.cumsum(odds)
    return np.searchsorted(shares[:-1], number * shares[-1], side="right")


def _check_nothing_beside(stream: Stream) -> None:
    """Raise a ValueError if a stream with a trace has arguments that the trace defines."""
    usual = Stream()
    for name in ("parcels", "destinations", "speeds", "origins", "aside", "turned", "window"):
        if getattr(stream, name) != getattr(usual, name):
            raise ValueError(
                f"{name} must be left out with a Trace, which has its own, "
                f"got {getattr(stream, name)!r}"
            )


def _parcels(given: Any) -> tuple[tuple[Parcel, float], ...]:
    if not isinstance(given, (tuple, list)) or not given:
        raise ValueError(
            f"parcels must be at least one of 'S', 'B' or a Parcel in a tuple, got {given!r}"
        )
    pairs = (each if isinstance(each, (tuple, list)) else (each, 1.0) for each in given)
    return tuple(_with_odds("parcels", pair, parcel_option) for pair in pairs)


def _odds(name: str, given: Any) -> tuple[tuple[str, float], ...]:
    if isinstance(given, Mapping):
        given = tuple(given.items())
    if not isinstance(given, (tuple, list)) or not given:
        raise ValueError(f"{name} must be None or the odds of at least one by name, got {given!r}")
    pairs = tuple(_with_odds(name, pair, partial(check_name, name)) for pair in given)
    names = [each for each, _ in pairs]
    for each in names:
        if names.count(each) > 1:
            raise ValueError(f"{name} must name each once, got {each!r} twice")
    return pairs


def _with_odds(name: str, pair: Any, check: Callable[[Any], Of]) -> tuple[Of, float]:
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        raise ValueError(f"{name} must be in pairs with their odds, got {pair!r}")
    return check(pair[0]), checks.positive(f"odds of {name}", pair[1], *checks.ODDS)


def _bounds(
    name: str, given: Any, check: Callable[[str, Any], float]
) -> float | tuple[float, float]:
    if not isinstance(given, (tuple, list)):
        return check(name, given)
    if len(given) != 2:
        raise ValueError(f"{name} must be one number or two, least and greatest, got {given!r}")
    low, high = (check(name, each) for each in given)
    if low > high:
        raise ValueError(f"{name} must be the least and then the greatest, got {given!r}")
    return low, high
