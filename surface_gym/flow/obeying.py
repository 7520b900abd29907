"""What a flow's actions say to each module: its own choice, or that of the parcel it obeys."""

import math

from surface_gym.core.actions import Acting
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import Places, X
from surface_gym.state import COLUMNS, FIRST_COLUMN, FIRST_ROW, EnvState, ParcelState, SurfaceState

HALVES = 2  # parts of a parcel's command: the modules ahead of its centre, and those behind

# Which part of the command a module follows; negative if none.


@inlined
def part_of_module(
    state: EnvState, lanes: ParcelState, owner: Places, rows: int, row: int, column: int
) -> int:
    """Each module its own."""
    return (row - state.zone[FIRST_ROW]) * state.zone[COLUMNS] + column - state.zone[FIRST_COLUMN]


@inlined
def part_of_owner(
    state: EnvState, lanes: ParcelState, owner: Places, rows: int, row: int, column: int
) -> int:
    """The half of the parcel that the module obeys; none: it stays as it is.

    `rows` is the first row of the surface's parcels in `lanes`.
    """
    place = owner[row, column]
    if place < 0:
        return -1
    x = state.elements.x0 + state.elements.pitch_x * column
    return HALVES * place + (1 if x < lanes.sensed[rows + place, X] else 0)


# The axis angle [rad] that a part of the command says.


@inlined
def told_choice(acting: Acting, surfaces: SurfaceState, surface: int, part: int) -> float:
    """That of the orientation on offer that it counts."""
    return acting.orientations[surfaces.command[surface, part]]


@inlined
def told_angle(acting: Acting, surfaces: SurfaceState, surface: int, part: int) -> float:
    """It is one."""
    return surfaces.command[surface, part]


@inlined
def is_turn(angle: float, before: float) -> bool:
    """Whether an axis has to turn from one angle to the other; one turned by pi is the same."""
    apart = angle - before
    return abs(apart - math.pi * math.floor(apart / math.pi + 0.5)) > 1e-9
