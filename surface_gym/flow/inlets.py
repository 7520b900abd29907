"""The inlets of a surface: spans of its edges where parcels enter."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from surface_gym import checks
from surface_gym.flow.exits import check_place
from surface_gym.lines import BaseLine

# Position of an inlet: at the start, where parcels move towards +x, or at a side.
START, LEFT, RIGHT = 0, 1, -1
MOST_INLETS = 32


@dataclass(frozen=True)
class Inlet:
    """A span of an edge over which parcels enter the surface.

    At the start (x = 0), the span is in y from the line's middle, and parcels move towards +x. At a
    side, the span is in x, and parcels move across the line.
    """

    name: str  # "line 1"
    side: int = START  # 0: at the start; +1: at the edge y > 0 (left); -1: at y < 0 (right)
    first: float = -math.inf  # [m] infinite: from the first row or column of rotors
    last: float = math.inf  # [m] infinite: to the last row or column of rotors

    def __post_init__(self) -> None:
        check_place(self)


class Entrance(NamedTuple):
    """An inlet on a surface."""

    x: float  # [m] middle of the span, on the edge
    y: float  # [m]
    heading: float  # [rad] direction of motion
    width: float  # [m] of the span


@dataclass(frozen=True)
class Inlets:
    """The inlets of a surface, indexed in order.

    >>> side_by_side(2).names
    ('line 1', 'line 2')
    """

    inlets: tuple[Inlet, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.inlets, (tuple, list)) or not self.inlets:
            raise ValueError(f"inlets must be at least one Inlet in a tuple, got {self.inlets!r}")
        for each in self.inlets:
            checks.instance("inlets", each, Inlet, "Inlet objects")
        if len(self.inlets) > MOST_INLETS:
            raise ValueError(f"inlets must be at most {MOST_INLETS}, got {len(self.inlets)}")
        object.__setattr__(self, "inlets", tuple(self.inlets))
        for place, each in enumerate(self.inlets):
            if each.name in self.names[:place]:
                raise ValueError(f"inlets must have names of their own, got {each.name!r} twice")

    def __len__(self) -> int:
        return len(self.inlets)

    def __iter__(self) -> Iterator[Inlet]:
        return iter(self.inlets)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the inlets."""
        return tuple(each.name for each in self.inlets)

    def place(self, name: str) -> int:
        """Return the index of the inlet with a name."""
        return self.names.index(checks.one_of("inlet", name, self.names))


EDGE = Inlets((Inlet("edge"),))  # the whole upper edge
SPACING = 0.46  # [m] distance between the middles of neighbouring lines


def side_by_side(count: int) -> Inlets:
    """Make inlets side by side at the start, from y > 0 down, at most 0.45 m wide."""
    checks.integer("count", count, least=1, most=MOST_INLETS)
    middles = [SPACING * (0.5 * (count - 1) - k) for k in range(count)]
    return Inlets(
        tuple(
            Inlet(f"line {k}", START, middle - 0.5 * SPACING, middle + 0.5 * SPACING)
            for k, middle in enumerate(middles, start=1)
        )
    )


def find_entrance(inlet: Inlet, line: BaseLine, rotors: tuple[int, int, int, int]) -> Entrance:
    """Find the position of an inlet on a line.

    Args:
        inlet: inlet to find.
        line: line of the surface.
        rotors: first row, rows, first column and columns of the rotors.

    Raises:
        ValueError: the inlet is not beside the rotors.
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
    """Return the inlets of an argument: Inlets, or a tuple of Inlet."""
    if isinstance(value, Inlets):
        return value
    if isinstance(value, (tuple, list)):
        return Inlets(tuple(value))
    raise ValueError(f"inlets must be Inlets, or a tuple of Inlet objects, got {value!r}")
