"""Which columns of rotors lie under a box along its way."""

import numpy as np
from numpy.typing import NDArray

from surface_gym import layouts
from surface_gym.physics.jit import compiled
from surface_gym.physics.references import find_contacts
from surface_gym.physics.types import ARM_X, ROTOR, Array, Body, Grid, Scratch, make_scratch
from surface_gym.surface import Surface

NONE = -1  # instead of a column, where no rotor lies under the base


@compiled
def _find_columns(
    grid: Grid, body: Body, pose: Array, scratch: Scratch, columns: NDArray[np.int64]
) -> None:
    """Fill columns (T, 2) for the poses (T, 3)."""
    for k in range(pose.shape[0]):
        columns[k, 0] = NONE
        columns[k, 1] = NONE
        contacts = find_contacts(grid, body, pose[k, 0], pose[k, 1], pose[k, 2], scratch)
        for i in range(contacts.total):
            if scratch.marks[ROTOR + i]:
                column = round((pose[k, 0] + scratch.table[ARM_X + i] - grid.x0) / grid.pitch_x)
                if columns[k, 0] == NONE or column < columns[k, 0]:
                    columns[k, 0] = column
                columns[k, 1] = max(columns[k, 1], column)


def rotor_columns(
    surface: Surface, size: str, pose: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last column with a rotor under the "S" or "B" box.

    Args:
        surface: the surface.
        size: of the box.
        pose: (T, 3) [m, m, rad] of its base.

    Returns:
        Two arrays (T,) of column indices, NONE where only supports carry the box.
    """
    body = layouts.box(size).body
    columns = np.empty((len(pose), 2), dtype=np.int64)
    _find_columns(surface.grid, body, pose, make_scratch(), columns)
    return columns[:, 0], columns[:, 1]
