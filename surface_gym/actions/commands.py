"""From an action to the axes of a zone's modules.

A command is one number a part: an index into the orientations on offer, or an angle. Which part a
module follows, what a number says and how an axis turns are functions that a batch's kernel is
built from. Only rotors that obey turn; every other axis stays as it is.
"""

import math
from typing import NamedTuple

from surface_gym.dynamics.axes import axis_direction
from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.indexing import bounded
from surface_gym.dynamics.types import Array, Integers, X, Y
from surface_gym.lanes.lane import Lane
from surface_gym.lanes.memory import COLUMNS, FIRST_COLUMN, FIRST_ROW, ROWS, Surfaces
from surface_gym.layouts import ROLLING

WINDOW_SIDE = 5  # modules
_HALF = 0.5 + 1e-9  # midway between two rows, whatever the round-off
CONVEYOR = (0.0, 1.0)  # cosine and sine of `ROLLING`, an axis that is not told


class Acting(NamedTuple):
    """How commands turn axes."""

    zone_rows: int  # rows of the widest zone, for which there are commands
    orientations: Array  # (choices,) [rad] axis angles on offer
    turn: float  # [rad] an axis turns in a physics step; infinite: at once


class Corner(NamedTuple):
    """Row and column of the window's first module."""

    row: int
    column: int


@inlined
def window_corner(lane: Lane, mirror: float) -> Corner:
    """The window's first module; the parcel is sensed over its middle one.

    Midway between two rows it is the one to the left, seen in the mirror if there is one: a
    mirrored lane must have the mirrored window.
    """
    rows, columns = lane.rotor.shape
    up = (lane.sensed[Y] - lane.elements.y0) / lane.elements.pitch_y
    along = (lane.sensed[X] - lane.elements.x0) / lane.elements.pitch_x
    # A window beyond the surface has none of its modules, however far off it is.
    up = bounded(up, -WINDOW_SIDE, rows + WINDOW_SIDE)
    along = bounded(along, -WINDOW_SIDE, columns + WINDOW_SIDE)
    row = math.floor(up + _HALF) if mirror > 0.0 else math.ceil(up - _HALF)
    column = math.floor(along + 0.5)
    return Corner(int(row) - WINDOW_SIDE // 2, int(column) - WINDOW_SIDE // 2)


# Which part of the command a module follows; negative if none.


@inlined
def part_of_modules(acting: Acting, lane: Lane, corner: Corner, row: int, column: int) -> int:
    """Each module its own. A narrow zone is the middle rows of the widest."""
    margin = (acting.zone_rows - lane.zone[ROWS]) // 2
    place = margin + row - lane.zone[FIRST_ROW]
    return place * lane.zone[COLUMNS] + column - lane.zone[FIRST_COLUMN]


@inlined
def part_of_halves(acting: Acting, lane: Lane, corner: Corner, row: int, column: int) -> int:
    """Those ahead of the parcel's centre, and those behind it."""
    return 1 if lane.elements.x0 + lane.elements.pitch_x * column < lane.sensed[X] else 0


@inlined
def part_of_quadrants(acting: Acting, lane: Lane, corner: Corner, row: int, column: int) -> int:
    """Ahead left, ahead right, behind left, behind right of the parcel's centre."""
    behind = lane.elements.x0 + lane.elements.pitch_x * column < lane.sensed[X]
    right = lane.elements.y0 + lane.elements.pitch_y * row < lane.sensed[Y]
    return (2 if behind else 0) + (1 if right else 0)


@inlined
def part_of_window(acting: Acting, lane: Lane, corner: Corner, row: int, column: int) -> int:
    """Each module of the window its own."""
    down = row - corner.row
    along = column - corner.column
    inside = 0 <= down < WINDOW_SIDE and 0 <= along < WINDOW_SIDE
    return down * WINDOW_SIDE + along if inside else -1


# How an axis does what a part of the command says.


@inlined
def set_choice(
    acting: Acting, surfaces: Surfaces, lane: int, row: int, column: int, part: int
) -> None:
    """To the orientation on offer that the part counts, at once."""
    surfaces.axis[lane, row, column] = surfaces.command[lane, part]


@inlined
def set_angle(
    acting: Acting, surfaces: Surfaces, lane: int, row: int, column: int, part: int
) -> None:
    """To the angle that the part says, at once."""
    angle = surfaces.command[lane, part]
    axis = surfaces.axis[lane, row, column]
    cosine, sine = axis_direction(angle)
    surfaces.direction[lane, axis, 0] = cosine
    surfaces.direction[lane, axis, 1] = sine


@inlined
def aim_at_choice(
    acting: Acting, surfaces: Surfaces, lane: int, row: int, column: int, part: int
) -> None:
    """To the orientation on offer that the part counts, by turning step by step."""
    surfaces.target[lane, row, column] = acting.orientations[surfaces.command[lane, part]]


@inlined
def aim_at_angle(
    acting: Acting, surfaces: Surfaces, lane: int, row: int, column: int, part: int
) -> None:
    """To the angle that the part says, by turning step by step."""
    surfaces.target[lane, row, column] = surfaces.command[lane, part]


@inlined
def leave_axes(acting: Acting, surfaces: Surfaces, lane: int, zone: Integers) -> bool:
    """They have turned already."""
    return False


@inlined
def turn_axes(acting: Acting, surfaces: Surfaces, lane: int, zone: Integers) -> bool:
    """Turn each axis of the zone towards its target, the shorter way, for one physics step; whether
    one had to.
    """
    turned = False
    for row in range(zone[FIRST_ROW], zone[FIRST_ROW] + zone[ROWS]):
        for column in range(zone[FIRST_COLUMN], zone[FIRST_COLUMN] + zone[COLUMNS]):
            apart = surfaces.target[lane, row, column] - surfaces.angle[lane, row, column]
            if apart == 0.0:
                continue
            turned = True
            # An axis is the same turned by pi: go the way of at most a quarter turn.
            apart -= math.pi * math.floor(apart / math.pi + 0.5)
            if abs(apart) <= acting.turn:
                angle = surfaces.target[lane, row, column]
            else:
                angle = surfaces.angle[lane, row, column] + math.copysign(acting.turn, apart)
            axis = surfaces.axis[lane, row, column]
            surfaces.angle[lane, row, column] = angle
            cosine, sine = axis_direction(angle)
            surfaces.direction[lane, axis, 0] = cosine
            surfaces.direction[lane, axis, 1] = sine
    return turned


# How all axes become the conveyor's, at once.


@inlined
def straighten_choices(acting: Acting, surfaces: Surfaces, lane: int) -> None:
    """To the direction that follows those on offer."""
    conveyor = surfaces.direction.shape[1] - 1
    for row in range(surfaces.axis.shape[1]):
        for column in range(surfaces.axis.shape[2]):
            surfaces.axis[lane, row, column] = conveyor


@inlined
def straighten_angles(acting: Acting, surfaces: Surfaces, lane: int) -> None:
    """Each its own direction."""
    for axis in range(surfaces.direction.shape[1]):
        surfaces.direction[lane, axis, 0] = CONVEYOR[0]
        surfaces.direction[lane, axis, 1] = CONVEYOR[1]


@inlined
def straighten_targets(acting: Acting, surfaces: Surfaces, lane: int) -> None:
    """Each its own direction, with nowhere to turn to."""
    straighten_angles(acting, surfaces, lane)
    for row in range(surfaces.angle.shape[1]):
        for column in range(surfaces.angle.shape[2]):
            surfaces.angle[lane, row, column] = ROLLING
            surfaces.target[lane, row, column] = ROLLING
