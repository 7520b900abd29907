"""From an action to the axes of a zone's modules, as the kinds of action have it.

A command is one number a choice, each an index into the orientations offered. Only rotors of the
lane's zone obey; every other axis stays as it is.
"""

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import Array
from surface_gym.lanes.memory import COLUMNS, FIRST_COLUMN, FIRST_ROW, ROWS, Geometry, Lanes

MODULES, HALVES, QUADRANTS = range(3)
MOST_LINE_ROWS = 4  # rows of the largest parcel's line


@inlined
def _choice(kind: int, lanes: Lanes, lane: int, geometry: Geometry, row: int, column: int) -> int:
    """Which of the command's choices a module follows; row and column count from the zone's."""
    if kind == MODULES:
        # A narrow line is the middle rows of the widest, for which there are commands.
        margin = (MOST_LINE_ROWS - lanes.zone[lane, ROWS]) // 2
        return (margin + row) * lanes.zone[lane, COLUMNS] + column
    x = geometry.x0 + geometry.pitch * (lanes.zone[lane, FIRST_COLUMN] + column)
    behind = x < lanes.sensed[lane, 0]
    if kind == HALVES:
        return 1 if behind else 0
    y = geometry.y0 + geometry.pitch * (lanes.zone[lane, FIRST_ROW] + row)
    right = y < lanes.sensed[lane, 1]
    return (2 if behind else 0) + (1 if right else 0)


@inlined
def obey(kind: int, lanes: Lanes, lane: int, geometry: Geometry, orientations: Array) -> None:
    """Turn the axes of the lane's zone as its command says.

    `orientations` (choices, 2) holds cosine and sine of each axis on offer. `lanes.axis` is
    (lanes, rows, columns, 2).
    """
    first_row = lanes.zone[lane, FIRST_ROW]
    first_column = lanes.zone[lane, FIRST_COLUMN]
    for row in range(lanes.zone[lane, ROWS]):
        for column in range(lanes.zone[lane, COLUMNS]):
            if lanes.rotor[lane, first_row + row, first_column + column]:
                choice = lanes.command[lane, _choice(kind, lanes, lane, geometry, row, column)]
                axis = lanes.axis[lane, first_row + row, first_column + column]
                axis[0] = orientations[choice, 0]
                axis[1] = orientations[choice, 1]
