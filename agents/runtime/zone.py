"""The zone's modules among all of a surface's."""

import numpy as np
from numpy.typing import NDArray

from surface_gym.layouts import ROLLING
from surface_gym.physics.types import Integers
from surface_gym.state import COLUMNS, FIRST_COLUMN, FIRST_ROW, ROWS

from .device import Angles


def of_zone(whole: NDArray[np.float64], zone: Integers, shape: tuple[int, int]) -> Angles:
    """Axes [rad] of the zone's modules, by those of the whole surface.

    Args:
        whole: (rows, columns) [rad] of the surface.
        zone: (4,) that a parcel has, as `Sites.zone`.
        shape: (rows, columns) of the widest zone. A narrower one is its middle rows; the places
            beside it are at 90 deg.
    """
    angles = np.full(shape, ROLLING)
    rows, first_row, first = int(zone[ROWS]), int(zone[FIRST_ROW]), int(zone[FIRST_COLUMN])
    margin = (shape[0] - rows) // 2
    part = whole[first_row : first_row + rows, first : first + int(zone[COLUMNS])]
    angles[margin : margin + rows] = part
    return angles
