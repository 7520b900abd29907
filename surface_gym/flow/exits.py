"""The line of a stream, and its exits to both sides and straight ahead."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.lines import Pattern

LINE_ROWS = 20  # rows of the whole surface
RUN_OUT = 6  # columns of supports after the last rotors, for parcels that exit straight ahead
PITCH = 0.1  # [m]

SIDES = (-1, 0, 1)  # y < 0 (right), straight ahead, y > 0 (left)
NOWHERE = -1  # index for departures between exits


@dataclass(frozen=True)
class Exit:
    """An exit for parcels; its span includes `first` and excludes `last`.

    The span limits a parcel's centre: in x at a side, and in y from the line's middle straight
    ahead.
    """

    name: str  # "left 1"
    side: int  # +1: y > 0 (left), -1: y < 0 (right), 0: straight ahead, at the line's end
    first: float = -math.inf  # [m]
    last: float = math.inf  # [m]

    def __post_init__(self) -> None:
        check_place(self)


@dataclass(frozen=True)
class Exits:
    """The exits of a line, indexed in order.

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
        """(exits, 3) side, first [m] and last [m] of each exit, for compiled code."""
        table = np.array([(each.side, each.first, each.last) for each in self.exits])
        table.setflags(write=False)
        return table

    def place(self, name: str) -> int:
        """Return the index of the exit with a name."""
        return self.names.index(checks.one_of("exit", name, self.names))

    def at(self, side: int, where: float) -> int:
        """Return the index of the exit that a parcel takes, or -1 between exits.

        Args:
            side: side of the departure: +1 left, -1 right, 0 at the line's end.
            where: [m] x of the centre; at the line's end, y of the centre from the line's middle.
        """
        for place, each in enumerate(self.exits):
            if each.side == side and each.first <= where < each.last:
                return place
        return NOWHERE


def chutes(length: float = 6.0) -> Exits:
    """Make two chutes on each side and an exit straight ahead, for a line of a length [m]."""
    scale = checks.positive("length", length, *checks.LENGTH) / 6.0
    spans = ((0.6 * scale, 2.8 * scale), (3.2 * scale, 5.8 * scale))
    aside = tuple(
        Exit(f"{name} {number}", side, *span)
        for name, side in (("left", 1), ("right", -1))
        for number, span in enumerate(spans, start=1)
    )
    return Exits((*aside, Exit("straight", 0)))


def sides(length: float = 6.0) -> Exits:
    """Make one chute on each side, as long as the line [m], and an exit straight ahead."""
    last = checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("left", 1, 0.0, last), Exit("right", -1, 0.0, last), Exit("straight", 0)))


def end(length: float = 6.0) -> Exits:
    """Make one exit straight ahead over the whole end of a line of any length [m]."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("end", 0),))


MOUTH = 0.6  # [m] width


def mouth(length: float = 6.0) -> Exits:
    """Make one exit straight ahead, a mouth of 0.6 m in the middle of a line of any length [m]."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("mouth", 0, -0.5 * MOUTH, 0.5 * MOUTH),))


def mouths(length: float = 6.0) -> Exits:
    """Make two mouths of 0.6 m side by side at the end of a line of any length [m]."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("left", 0, 0.05, 0.05 + MOUTH), Exit("right", 0, -0.05 - MOUTH, -0.05)))


EXITS = {  # presets by name, functions of the line's length [m]
    "chutes": chutes, "sides": sides, "end": end, "mouth": mouth, "mouths": mouths,
}  # fmt: skip


def exits_option(value: Any, length: float) -> Exits:
    """Return the exits of an argument: the name of a preset, or Exits."""
    if isinstance(value, Exits):
        return value
    if isinstance(value, (tuple, list)):
        return Exits(tuple(value))
    return EXITS[checks.one_of("exits", value, EXITS)](length)


def check_place(place: Any) -> None:
    """Check and set the name, the side and the span of a frozen exit or inlet."""
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
    """Check the name of an exit: not empty, without spaces at its ends, writable to files."""
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
        rotor_rows: number of rotor rows, in the middle of 20 rows.
        lead_in: columns that stay at 90 deg, like the conveyor before them. They should be as long
            as the longest parcel, 5 for the B-box.
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
