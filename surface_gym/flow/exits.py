"""The line that a stream runs on, and its exits, to either side or straight on."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.lines import Pattern

LINE_ROWS = 20  # of the whole surface
RUN_OUT = 6  # columns of supports after the last rotors, for parcels that go straight on
PITCH = 0.1  # [m]

SIDES = (-1, 0, 1)  # y < 0 (right), straight on, y > 0 (left)
NOWHERE = -1  # index of a parcel that leaves between two exits


@dataclass(frozen=True)
class Exit:
    """A place where parcels may leave; its span holds `first` and not `last`.

    The span is of a parcel's centre: to a side of x, and straight on of y from the line's middle.
    """

    name: str  # "left 1"
    side: int  # +1: y > 0 (left), -1: y < 0 (right), 0: straight on, at the line's end
    first: float = -math.inf  # [m]
    last: float = math.inf  # [m]

    def __post_init__(self) -> None:
        check_place(self)


@dataclass(frozen=True)
class Exits:
    """The exits of a line, counted by their index.

    >>> exits = Exits([Exit("left", 1, 0.5, 2.0), Exit("straight", 0)])
    >>> exits.at(1, 1.2), exits.at(1, 2.5), exits.at(0, 0.1)
    (0, -1, 1)
    """

    exits: tuple[Exit, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.exits, (tuple, list)) or not self.exits:
            raise ValueError(f"exits must be at least one Exit in a tuple, got {self.exits!r}")
        for each in self.exits:
            if not isinstance(each, Exit):
                raise ValueError(f"exits must be Exit objects, got {each!r}")
        object.__setattr__(self, "exits", tuple(self.exits))
        for place, each in enumerate(self.exits):
            for other in self.exits[:place]:
                _check_apart(other, each)

    def __len__(self) -> int:
        return len(self.exits)

    def __iter__(self) -> Iterator[Exit]:
        return iter(self.exits)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the exits."""
        return tuple(each.name for each in self.exits)

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """(exits, 3) side, first [m] and last [m] of each, as compiled code reads them."""
        table = np.array([(each.side, each.first, each.last) for each in self.exits])
        table.setflags(write=False)
        return table

    def place(self, name: str) -> int:
        """Return the index of the exit of a name."""
        return self.names.index(checks.one_of("exit", name, self.names))

    def at(self, side: int, where: float) -> int:
        """Return the index of the exit that a parcel takes, or -1 between exits.

        Args:
            side: on which the parcel leaves: +1 left, -1 right, 0 at the line's end.
            where: [m] x of its centre, or at the line's end its y from the line's middle.
        """
        for place, each in enumerate(self.exits):
            if each.side == side and each.first <= where < each.last:
                return place
        return NOWHERE


def chutes(length: float = 6.0) -> Exits:
    """Make two chutes on either side and an exit straight on, for a line of a length [m]."""
    scale = checks.positive("length", length, *checks.LENGTH) / 6.0
    spans = ((0.6 * scale, 2.8 * scale), (3.2 * scale, 5.8 * scale))
    aside = tuple(
        Exit(f"{name} {number}", side, *span)
        for name, side in (("left", 1), ("right", -1))
        for number, span in enumerate(spans, start=1)
    )
    return Exits((*aside, Exit("straight", 0)))


def sides(length: float = 6.0) -> Exits:
    """Make a chute on either side, as long as the line [m], and an exit straight on."""
    last = checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("left", 1, 0.0, last), Exit("right", -1, 0.0, last), Exit("straight", 0)))


def end(length: float = 6.0) -> Exits:
    """Make one exit straight on, anywhere across the end of a line of any length [m]."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("end", 0),))


MOUTH = 0.6  # [m] wide


def mouth(length: float = 6.0) -> Exits:
    """Make one exit straight on, a mouth of 0.6 m in the middle of a line of any length [m]."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("mouth", 0, -0.5 * MOUTH, 0.5 * MOUTH),))


def mouths(length: float = 6.0) -> Exits:
    """Make two mouths of 0.6 m side by side at the end of a line of any length [m]."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("left", 0, 0.05, 0.05 + MOUTH), Exit("right", 0, -0.05 - MOUTH, -0.05)))


EXITS = {  # presets by name, each of the line's length [m]
    "chutes": chutes, "sides": sides, "end": end, "mouth": mouth, "mouths": mouths,
}  # fmt: skip


def exits_option(value: Any, length: float) -> Exits:
    """Return the exits of an argument: a preset by name, for a line of a length [m], or Exits."""
    if isinstance(value, Exits):
        return value
    if isinstance(value, (tuple, list)):
        return Exits(tuple(value))
    return EXITS[checks.one_of("exits", value, EXITS)](length)


def check_place(place: Any) -> None:
    """Check and set the name, the side and the span of an exit or an inlet, which are frozen."""
    set_field = object.__setattr__
    check_name("name", place.name)
    set_field(place, "side", checks.one_of("side", place.side, SIDES))
    for name, endless in (("first", -math.inf), ("last", math.inf)):
        value = getattr(place, name)
        is_endless = isinstance(value, float) and value == endless
        set_field(place, name, endless if is_endless else checks.coordinate(name, value))
    if place.last <= place.first:
        raise ValueError(
            f"last must be greater than first, {place.first:g}, got {place.last!r} "
            f"for {place.name!r}"
        )


def check_name(name: str, value: Any) -> str:
    """Return the name of an exit: text without spaces at its ends, not empty, as files hold it."""
    if not isinstance(value, str) or not value or value != value.strip():
        raise ValueError(f"{name} must be text without spaces at its ends, got {value!r}")
    if "\0" in value or any("\ud800" <= letter <= "\udfff" for letter in value):
        raise ValueError(f"{name} must hold neither NUL nor half a letter (UTF-16), got {value!r}")
    return value


def _check_apart(one: Exit, other: Exit) -> None:
    if one.name == other.name:
        raise ValueError(f"exits must have names of their own, got {one.name!r} twice")
    if one.side != other.side:
        return
    if max(one.first, other.first) < min(one.last, other.last):
        raise ValueError(
            f"exits must not overlap on one side, got {one.name!r} "
            f"from {one.first:g} to {one.last:g} m and {other.name!r} "
            f"from {other.first:g} to {other.last:g} m"
        )


def flow_line(length: float = 6.0, rotor_rows: int = 4, lead_in: int = 5) -> Pattern:
    """Make a line of rotors with supports beside it and after it.

    Args:
        length: [m] of the rotors along x.
        rotor_rows: rows of them, in the middle of 20.
        lead_in: columns that stay at 90 deg, as the conveyor's before them: as many as the longest
            parcel is long, 5 for the B-box.
    """
    checks.integer("lead_in", lead_in, least=0, most=checks.ELEMENTS)
    columns = round(checks.positive("length", length, *checks.LENGTH) / PITCH)
    if columns <= lead_in:
        raise ValueError(
            f"length must be more than the lead-in's, {lead_in * PITCH:g} m, got {length!r}"
        )
    checks.integer("rotor_rows", rotor_rows, least=2)
    if rotor_rows % 2 or rotor_rows > 12:
        raise ValueError(f"rotor_rows must be even and at most 12, got {rotor_rows!r}")
    first = (LINE_ROWS - rotor_rows) // 2
    rotor = np.zeros((LINE_ROWS, columns + RUN_OUT), dtype=bool)
    rotor[first : first + rotor_rows, :columns] = True
    return Pattern(rotor=rotor, lead_in=lead_in)
