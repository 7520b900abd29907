"""The line of a stream, its exits, and the inlets where parcels enter."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.lines import BaseLine, Pattern

LINE_ROWS = 20  # rows of the whole surface
RUN_OUT = 6  # columns of supports after the last rotors, for parcels that exit straight ahead
PITCH = 0.1  # [m]

SIDES = (-1, 0, 1)  # y < 0 (right), straight ahead, y > 0 (left)
# Position of an inlet: at the start, where parcels move towards +x, or at a side.
START, LEFT, RIGHT = 0, 1, -1
MOST_INLETS = 32


def check_name(name: str, value: Any) -> str:
    """Check that a name is not empty, has no spaces at its ends, and can be written to files."""
    if not isinstance(value, str) or not value or value != value.strip():
        raise ValueError(f"{name} must be text without spaces at its ends, got {value!r}")
    if "\0" in value or any("\ud800" <= letter <= "\udfff" for letter in value):
        raise ValueError(f"{name} must hold neither NUL nor half a letter (UTF-16), got {value!r}")
    return value


Of = TypeVar("Of")


def check_several(name: str, given: Any, kind: type[Of]) -> tuple[Of, ...]:
    """Check that `given` has one or more objects, all of the class `kind`; return a tuple."""
    noun = kind.__name__
    if not isinstance(given, (tuple, list)) or not given:
        raise ValueError(f"{name} must be at least one {noun} in a tuple, got {given!r}")
    for each in given:
        checks.instance(name, each, kind, f"{noun} objects")
    return tuple(given)


@dataclass(frozen=True)
class Opening:
    """A span of the surface's edge, over which parcels enter or depart."""

    name: str  # "left 1"
    side: int  # +1: y > 0 (left), -1: y < 0 (right), 0: an end of the line
    first: float = -math.inf  # [m]
    last: float = math.inf  # [m]

    def __post_init__(self) -> None:
        checks.settle(self, name=check_name, side=(checks.one_of, SIDES))
        for name, endless in (("first", -math.inf), ("last", math.inf)):
            value = getattr(self, name)
            if not isinstance(value, float) or value != endless:
                checks.settle(self, **{name: checks.coordinate})
        if self.last <= self.first:
            raise ValueError(
                f"last must be greater than first, {self.first:g}, got {self.last!r} "
                f"for {self.name!r}"
            )


@dataclass(frozen=True)
class Exit(Opening):
    """An exit for parcels; its span includes `first` and excludes `last`.

    A parcel's centre must be in the span. At a side, the span is in x. At the line's end (side 0,
    straight ahead), the span is in y, relative to the line's middle.
    """


@dataclass(frozen=True)
class Inlet(Opening):
    """A span of an edge over which parcels enter the surface.

    At the start (side 0, x = 0), the span is in y, relative to the line's middle, and parcels move
    towards +x. At a side, the span is in x, and parcels move across the line. The default span is
    from the first to the last row or column of rotors.
    """

    side: int = START


Kind = TypeVar("Kind", bound=Opening)


class Openings(Generic[Kind]):
    """Base class of `Exits` and `Inlets`. The order of the openings gives their indices."""

    kind: ClassVar[type[Opening]]
    plural: ClassVar[str]  # name of the field with the openings

    def __post_init__(self) -> None:
        each = check_several(self.plural, getattr(self, self.plural), self.kind)
        object.__setattr__(self, self.plural, each)
        for place, name in enumerate(self.names):
            if name in self.names[:place]:
                raise ValueError(f"{self.plural} must have names of their own, got {name!r} twice")

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Kind]:
        return iter(getattr(self, self.plural))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the openings."""
        return tuple(each.name for each in self)

    def place(self, name: str) -> int:
        """Return the index of the opening called `name`."""
        return self.names.index(checks.one_of(self.plural[:-1], name, self.names))


@dataclass(frozen=True)
class Exits(Openings[Exit]):
    """The exits of a line, indexed in order.

    >>> Exits([Exit("left", 1, 0.5, 2.0), Exit("straight", 0)]).names
    ('left', 'straight')
    """

    exits: tuple[Exit, ...]

    kind = Exit
    plural = "exits"

    def __post_init__(self) -> None:
        super().__post_init__()
        for place, each in enumerate(self.exits):
            for other in self.exits[:place]:
                _check_apart(other, each)

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """Table (exits, 3) for compiled code: the side, `first` [m] and `last` [m] of each exit."""
        table = np.array([(each.side, each.first, each.last) for each in self.exits])
        table.setflags(write=False)
        return table


def _check_apart(one: Exit, other: Exit) -> None:
    if one.side == other.side and max(one.first, other.first) < min(one.last, other.last):
        raise ValueError(
            f"exits must not overlap on one side, got {one.name!r} "
            f"from {one.first:g} to {one.last:g} m and {other.name!r} "
            f"from {other.first:g} to {other.last:g} m"
        )


@dataclass(frozen=True)
class Inlets(Openings[Inlet]):
    """The inlets of a surface, indexed in order.

    >>> side_by_side(2).names
    ('line 1', 'line 2')
    """

    inlets: tuple[Inlet, ...]

    kind = Inlet
    plural = "inlets"

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.inlets) > MOST_INLETS:
            raise ValueError(f"inlets must be at most {MOST_INLETS}, got {len(self.inlets)}")


def chutes(length: float = 6.0) -> Exits:
    """Make the exits of a line `length` [m] long: two chutes on each side, one exit ahead."""
    scale = checks.positive("length", length, *checks.LENGTH) / 6.0
    spans = ((0.6 * scale, 2.8 * scale), (3.2 * scale, 5.8 * scale))
    aside = tuple(
        Exit(f"{name} {number}", side, *span)
        for name, side in (("left", 1), ("right", -1))
        for number, span in enumerate(spans, start=1)
    )
    return Exits((*aside, Exit("straight", 0)))


def sides(length: float = 6.0) -> Exits:
    """Make a chute along each side of the line (`length` [m]), and an exit straight ahead."""
    last = checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("left", 1, 0.0, last), Exit("right", -1, 0.0, last), Exit("straight", 0)))


def end(length: float = 6.0) -> Exits:
    """Make one exit straight ahead, as wide as the line; the `length` [m] has no effect."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("end", 0),))


MOUTH = 0.6  # [m] width


def mouth(length: float = 6.0) -> Exits:
    """Make one exit (mouth) 0.6 m wide, in the middle of the line's end; `length` has no effect."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("mouth", 0, -0.5 * MOUTH, 0.5 * MOUTH),))


def mouths(length: float = 6.0) -> Exits:
    """Make two exits (mouths), each 0.6 m wide, at the line's end; `length` has no effect."""
    checks.positive("length", length, *checks.LENGTH)
    return Exits((Exit("left", 0, 0.05, 0.05 + MOUTH), Exit("right", 0, -0.05 - MOUTH, -0.05)))


EXITS = {  # presets by name, functions of the line's length [m]
    "chutes": chutes, "sides": sides, "end": end, "mouth": mouth, "mouths": mouths,
}  # fmt: skip


def exits_option(value: Any, length: float) -> Exits:
    """Return Exits for `value`, which is the name of a preset, Exits, or a tuple of Exit.

    A preset is scaled to `length` [m], the length of the part of the line that has rotors.
    """
    if isinstance(value, Exits):
        return value
    if isinstance(value, (tuple, list)):
        return Exits(tuple(value))
    return EXITS[checks.one_of("exits", value, EXITS)](length)


EDGE = Inlets((Inlet("edge"),))  # the whole upper edge
SPACING = 0.46  # [m] distance between the middles of neighbouring lines


def side_by_side(count: int) -> Inlets:
    """Make inlets 0.46 m wide, side by side at the middle of the line's start, highest y first."""
    checks.integer("count", count, least=1, most=MOST_INLETS)
    middles = [SPACING * (0.5 * (count - 1) - k) for k in range(count)]
    return Inlets(
        tuple(
            Inlet(f"line {k}", START, middle - 0.5 * SPACING, middle + 0.5 * SPACING)
            for k, middle in enumerate(middles, start=1)
        )
    )


class Entrance(NamedTuple):
    """Position of an inlet on a surface."""

    x: float  # [m] middle of the span, on the edge
    y: float  # [m]
    heading: float  # [rad] direction of motion
    width: float  # [m] of the span


def find_entrance(inlet: Inlet, line: BaseLine, rotors: tuple[int, int, int, int]) -> Entrance:
    """Find the position of an inlet on a line.

    `rotors` are the first row, number of rows, first column and number of columns of the rotors.
    Raise a ValueError if the inlet is not beside the rotors.
    """
    first_row, rows, first_column, columns = rotors
    low = line.origin[1] + line.pitch_y * (first_row - 0.5)
    high, start = low + line.pitch_y * rows, line.column_edge(first_column)
    end = line.column_edge(first_column + columns)
    if inlet.side == START:
        least, most = low - line.line_y, high - line.line_y
    else:
        least, most = start, end
    first, last = max(inlet.first, least), min(inlet.last, most)
    if last <= first:
        raise ValueError(
            f"inlets must lie beside the rotors, from {least:g} to {most:g} m, got {inlet.name!r} "
            f"from {inlet.first:g} to {inlet.last:g} m"
        )
    endless = inlet.first == -math.inf and inlet.last == math.inf
    middle = 0.0 if endless and inlet.side == START else 0.5 * (first + last)
    if inlet.side == START:
        return Entrance(start, line.line_y + middle, 0.0, last - first)
    edge = high if inlet.side == LEFT else low
    return Entrance(middle, edge, -0.5 * math.pi * inlet.side, last - first)


def inlets_option(value: Any) -> Inlets:
    """Return Inlets for `value`, which is Inlets or a tuple of Inlet."""
    if isinstance(value, Inlets):
        return value
    if isinstance(value, (tuple, list)):
        return Inlets(tuple(value))
    raise ValueError(f"inlets must be Inlets, or a tuple of Inlet objects, got {value!r}")


def flow_line(length: float = 6.0, rotor_rows: int = 4, lead_in: int = 5) -> Pattern:
    """Make a line of rotors, with supports beside the rotors and after the rotors.

    Args:
        length: [m] length of the rotor rows along x.
        rotor_rows: number of rotor rows, in the middle of 20 rows.
        lead_in: number of columns at the line's start whose axes stay at 90 deg. Together these
            columns should be as long as the longest parcel: 5 columns for the B-box.
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
