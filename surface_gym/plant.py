"""The plant of an environment: a line of rotors, its conveyor and the zone of it that obeys."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.bases import Base
from surface_gym.batch.commands import MOST_LINE_ROWS
from surface_gym.lanes.memory import Geometry
from surface_gym.layouts import LINE_Y

PITCH = 0.1  # [m]
ORIGIN = 0.05  # [m] centre of element [0, 0], in x and in y
ROWS = 20  # of the surface
COLUMNS = 30
ZONE_COLUMNS = 16  # that obey, after the lead-in


@dataclass(frozen=True, eq=False)
class Line:
    """The line a parcel of some size runs on, as in the paper's Figure 6."""

    rotor: NDArray[np.bool_]  # (ROWS, COLUMNS)
    zone: tuple[int, int, int, int]  # first row, rows, first column, columns that obey


def geometry() -> Geometry:
    """Where the elements lie."""
    return Geometry(ORIGIN, ORIGIN, PITCH, LINE_Y)


def line_for(base: Base, zone: tuple[int, int] | None) -> Line:
    """The line for a base: its rows and lead-in columns follow the paper's for the S- and B-box.

    Args:
        base: the parcel's base.
        zone: first and last column that obey; None for those after the lead-in, on which the
            parcel starts.

    Raises:
        ValueError: the base is too long or too wide for the line.
    """
    length, width = np.ptp(base.outline, axis=0)
    rows = 2 * max(1, int(width / (2.0 * PITCH) + 1e-9))
    lead_in = int(np.ceil(length / PITCH - 1e-9))
    if rows > MOST_LINE_ROWS or lead_in > COLUMNS - ZONE_COLUMNS:
        most = (PITCH * (COLUMNS - ZONE_COLUMNS), PITCH * (MOST_LINE_ROWS + 2))
        raise ValueError(
            f"parcel must be at most {most[0]:g} m long and less than {most[1]:g} m wide, "
            f"got {length:g} m x {width:g} m"
        )
    first_row = (ROWS - rows) // 2
    rotor = np.zeros((ROWS, COLUMNS), dtype=bool)
    rotor[first_row : first_row + rows] = True
    first, last = (lead_in, lead_in + ZONE_COLUMNS - 1) if zone is None else zone
    return Line(rotor, (first_row, rows, first, last - first + 1))
