"""From an action to the axes of a zone's modules, as the kinds of action have it.

A command is one number a choice, each an index into the orientations on offer. Only rotors that
obey do so; every other axis stays as it is.
"""

import math
from typing import NamedTuple

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import Array
from surface_gym.lanes.memory import COLUMNS, FIRST_COLUMN, FIRST_ROW, ROWS, Geometry, Lanes
from surface_gym.layouts import ROLLING

MODULES, HALVES, QUADRANTS, WINDOW = range(4)
WINDOW_SIDE = 5  # modules
_HALF = 0.5 + 1e-9  # midway between two rows, whatever the round-off
CONVEYOR = (math.cos(ROLLING), math.sin(ROLLING))  # cosine and sine of an axis that is not told


class Acting(NamedTuple):
    """How commands turn axes."""

    kind: int  # MODULES, HALVES, QUADRANTS or WINDOW
    zone_rows: int  # rows that a command of MODULES has
    orientations: Array  # (choices, 3) [rad] axis angle, its cosine and sine
    turn: float  # [rad] an axis turns in a physics step; infinite: at once


@inlined
def window_corner(lanes: Lanes, lane: int, geometry: Geometry, mirror: float) -> tuple[int, int]:
    """Row and column of the window's first module; the parcel is sensed over its middle one.

    Midway between two rows it is the one to the left, seen in the mirror if there is one: a
    mirrored lane must have the mirrored window.
    """
    up = (lanes.sensed[lane, 1] - geometry.y0) / geometry.pitch
    row = math.floor(up + _HALF) if mirror > 0.0 else math.ceil(up - _HALF)
    column = math.floor((lanes.sensed[lane, 0] - geometry.x0) / geometry.pitch + 0.5)
    return int(row) - WINDOW_SIDE // 2, int(column) - WINDOW_SIDE // 2


@inlined
def _choice(
    acting: Acting,
    lanes: Lanes,
    lane: int,
    geometry: Geometry,
    row: int,
    column: int,
    corner: tuple[int, int],
) -> int:
    """Which of the command's choices a module follows, negative if none."""
    if acting.kind == MODULES:
        # A narrow zone is the middle rows of the widest, for which there are commands.
        margin = (acting.zone_rows - lanes.zone[lane, ROWS]) // 2
        place = margin + row - lanes.zone[lane, FIRST_ROW]
        return place * lanes.zone[lane, COLUMNS] + column - lanes.zone[lane, FIRST_COLUMN]
    if acting.kind == WINDOW:
        down = row - corner[0]
        along = column - corner[1]
        inside = 0 <= down < WINDOW_SIDE and 0 <= along < WINDOW_SIDE
        return down * WINDOW_SIDE + along if inside else -1
    behind = geometry.x0 + geometry.pitch * column < lanes.sensed[lane, 0]
    if acting.kind == HALVES:
        return 1 if behind else 0
    right = geometry.y0 + geometry.pitch * row < lanes.sensed[lane, 1]
    return (2 if behind else 0) + (1 if right else 0)


@inlined
def obey(acting: Acting, lanes: Lanes, lane: int, geometry: Geometry, mirror: float) -> None:
    """Turn the axes of the lane's zone as its command says, or set what they turn to."""
    corner = window_corner(lanes, lane, geometry, mirror)
    zone = lanes.zone[lane]
    for row in range(zone[FIRST_ROW], zone[FIRST_ROW] + zone[ROWS]):
        for column in range(zone[FIRST_COLUMN], zone[FIRST_COLUMN] + zone[COLUMNS]):
            place = _choice(acting, lanes, lane, geometry, row, column, corner)
            if place < 0 or not lanes.obeys[lane, row, column]:
                continue
            choice = lanes.command[lane, place]
            if acting.turn == math.inf:
                lanes.axis[lane, row, column, 0] = acting.orientations[choice, 1]
                lanes.axis[lane, row, column, 1] = acting.orientations[choice, 2]
            else:
                lanes.target[lane, row, column] = acting.orientations[choice, 0]


@inlined
def straighten(acting: Acting, lanes: Lanes, lane: int) -> None:
    """Set the axes of the lane's zone to the conveyor's, at once."""
    zone = lanes.zone[lane]
    for row in range(zone[FIRST_ROW], zone[FIRST_ROW] + zone[ROWS]):
        for column in range(zone[FIRST_COLUMN], zone[FIRST_COLUMN] + zone[COLUMNS]):
            lanes.axis[lane, row, column, 0] = CONVEYOR[0]
            lanes.axis[lane, row, column, 1] = CONVEYOR[1]
            if acting.turn != math.inf:
                lanes.angle[lane, row, column] = ROLLING
                lanes.target[lane, row, column] = ROLLING


@inlined
def turn_axes(acting: Acting, lanes: Lanes, lane: int) -> None:
    """Turn each axis towards its target, the shorter way, for one physics step."""
    zone = lanes.zone[lane]
    for row in range(zone[FIRST_ROW], zone[FIRST_ROW] + zone[ROWS]):
        for column in range(zone[FIRST_COLUMN], zone[FIRST_COLUMN] + zone[COLUMNS]):
            apart = lanes.target[lane, row, column] - lanes.angle[lane, row, column]
            if apart == 0.0:
                continue
            # An axis is the same turned by pi: go the way of at most a quarter turn.
            apart -= math.pi * math.floor(apart / math.pi + 0.5)
            if abs(apart) <= acting.turn:
                angle = lanes.target[lane, row, column]
            else:
                angle = lanes.angle[lane, row, column] + math.copysign(acting.turn, apart)
            lanes.angle[lane, row, column] = angle
            lanes.axis[lane, row, column, 0] = math.cos(angle)
            lanes.axis[lane, row, column, 1] = math.sin(angle)


@inlined
def show_window(lanes: Lanes, lane: int, geometry: Geometry, first: int, mirror: float) -> None:
    """Write the window's occupancy into the observation from `first` on: 1 for each module that
    is sensed to lie under the parcel and obeys, its rows upside down if `mirror` is negative.
    """
    corner_row, corner_column = window_corner(lanes, lane, geometry, mirror)
    rows, columns = lanes.rotor.shape[1], lanes.rotor.shape[2]
    sensed = lanes.sensed[lane]
    cosine = math.cos(sensed[2])
    sine = math.sin(sensed[2])
    edges = lanes.edges[lane]
    for down in range(WINDOW_SIDE):
        for along in range(WINDOW_SIDE):
            row = corner_row + down
            column = corner_column + along
            seen = 0.0
            if 0 <= row < rows and 0 <= column < columns and lanes.obeys[lane, row, column]:
                dx = geometry.x0 + geometry.pitch * column - sensed[0]
                dy = geometry.y0 + geometry.pitch * row - sensed[1]
                x = cosine * dx + sine * dy
                y = cosine * dy - sine * dx
                under = dx * dx + dy * dy <= lanes.body[lane, 0] ** 2
                for k in range(edges.shape[0]):
                    under = under and edges[k, 0] * x + edges[k, 1] * y <= edges[k, 2]
                seen = 1.0 if under else 0.0
            shown = down if mirror > 0.0 else WINDOW_SIDE - 1 - down
            lanes.observation[lane, first + shown * WINDOW_SIDE + along] = seen
