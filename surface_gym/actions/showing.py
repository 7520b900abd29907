"""What an observation shows of the modules, after the task's features, where it is asked to."""

import math

from surface_gym.actions.commands import WINDOW_SIDE, Acting, window_corner
from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import RADIUS, THETA, X, Y
from surface_gym.lanes.lane import Lane
from surface_gym.lanes.memory import COLUMNS, FIRST_COLUMN, FIRST_ROW, ROWS

AXIS_SIZE = 2  # numbers that show an axis: cosine and sine of twice its angle, as it has no ends


@inlined
def show_nothing(acting: Acting, lane: Lane, first: int, mirror: float) -> None:
    """The task's features are all there is."""


@inlined
def show_occupancy(acting: Acting, lane: Lane, first: int, mirror: float) -> None:
    """Write the window's occupancy into the observation from `first` on: 1 for each module that
    is sensed to lie under the parcel and obeys, its rows upside down if `mirror` is negative.
    """
    corner = window_corner(lane, mirror)
    rows, columns = lane.rotor.shape
    sensed = lane.sensed
    cosine = math.cos(sensed[THETA])
    sine = math.sin(sensed[THETA])
    edges = lane.edges
    for down in range(WINDOW_SIDE):
        for along in range(WINDOW_SIDE):
            row = corner.row + down
            column = corner.column + along
            seen = 0.0
            if 0 <= row < rows and 0 <= column < columns and lane.obeys[row, column]:
                dx = lane.elements.x0 + lane.elements.pitch_x * column - sensed[X]
                dy = lane.elements.y0 + lane.elements.pitch_y * row - sensed[Y]
                x = cosine * dx + sine * dy
                y = cosine * dy - sine * dx
                under = dx * dx + dy * dy <= lane.body[RADIUS] ** 2
                for k in range(edges.shape[0]):
                    under = under and edges[k, 0] * x + edges[k, 1] * y <= edges[k, 2]
                seen = 1.0 if under else 0.0
            shown = down if mirror > 0.0 else WINDOW_SIDE - 1 - down
            lane.observation[first + shown * WINDOW_SIDE + along] = seen


@inlined
def _show_axis(lane: Lane, row: int, column: int, place: int, mirror: float) -> None:
    """Write a module's axis into the observation from `place` on; 0 where there is no rotor."""
    rows, columns = lane.rotor.shape
    twice_cosine = twice_sine = 0.0
    if 0 <= row < rows and 0 <= column < columns and lane.rotor[row, column]:
        cosine = lane.direction[lane.axis[row, column], 0]
        sine = lane.direction[lane.axis[row, column], 1]
        twice_cosine = cosine * cosine - sine * sine
        twice_sine = mirror * 2.0 * sine * cosine
    lane.observation[place] = twice_cosine
    lane.observation[place + 1] = twice_sine


@inlined
def show_window_axes(acting: Acting, lane: Lane, first: int, mirror: float) -> None:
    """Write the axes of the window's modules into the observation from `first` on."""
    corner = window_corner(lane, mirror)
    for down in range(WINDOW_SIDE):
        for along in range(WINDOW_SIDE):
            shown = down if mirror > 0.0 else WINDOW_SIDE - 1 - down
            place = first + AXIS_SIZE * (shown * WINDOW_SIDE + along)
            _show_axis(lane, corner.row + down, corner.column + along, place, mirror)


@inlined
def show_zone_axes(acting: Acting, lane: Lane, first: int, mirror: float) -> None:
    """Write the axes of the zone's modules into the observation from `first` on."""
    columns = lane.zone[COLUMNS]
    margin = (acting.zone_rows - lane.zone[ROWS]) // 2
    for place in range(acting.zone_rows):
        down = place - margin if mirror > 0.0 else lane.zone[ROWS] - 1 - (place - margin)
        inside = 0 <= down < lane.zone[ROWS]
        row = lane.zone[FIRST_ROW] + down if inside else -1
        for along in range(columns):
            column = lane.zone[FIRST_COLUMN] + along
            _show_axis(lane, row, column, first + AXIS_SIZE * (place * columns + along), mirror)
