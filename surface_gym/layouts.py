"""The paper's fixed layouts: a line of rotors among supports, with axes that do not turn.

The line is centred on y = 1 m; the elements' centres lie at 0.05, 0.15, ... m. Lead-in columns at
90 deg (rolling along x) come first. Then come the task's columns, and columns at 90 deg follow to
the end, as in Figure 6. The paper does not state the numbers of rows and lead-in columns; the
values here reproduce its tables.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from surface_gym import checks
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.surface import Surface

ROLLING = math.pi / 2  # [rad] axis of a module that lets a parcel roll along x
LINE_Y = 1.0  # [m] middle of the line
ROWS = 20  # rows of the whole surface

# Rows of rotors and lead-in columns for each of the paper's boxes (Section 5.1, Figure 7 and 9).
LINE_ROWS = {"S": 2, "B": 4}
LEAD_IN = {"S": 3, "B": 5}


def rows_under(width: float, pitch: float) -> int:
    """Return the number of rotor rows, always even, for a parcel's width [m] and a pitch [m].

    >>> rows_under(0.25, 0.1), rows_under(0.45, 0.1)
    (2, 4)
    """
    return 2 * max(1, int(width / (2.0 * pitch) + 1e-9))


def lead_in_under(length: float, pitch: float) -> int:
    """Return the number of lead-in columns, `pitch` [m] apart, for a parcel of `length` [m].

    >>> lead_in_under(0.25, 0.1), lead_in_under(0.45, 0.1)
    (3, 5)
    """
    return max(1, math.ceil(length / pitch - 1e-9))


@lru_cache(maxsize=2)
def box(size: str) -> Parcel:
    """Return a 10 kg box of the paper's Table 1: "S" is 0.25 m x 0.25 m, "B" is 0.45 m x 0.45 m."""
    side = {"S": 0.25, "B": 0.45}[checks.one_of("size", size, ("S", "B"))]
    return Parcel(Rectangle(side, side))


def start(size: str) -> tuple[float, float, float]:
    """Return the paper's start pose (x, y, theta) [m, m, rad] of a box with the rear at x = 0."""
    return (box(size).rear, LINE_Y, 0.0)


def line(task_axis: ArrayLike, size: str = "S", columns: int = 40, tilt: float = 0.0) -> Surface:
    """Return a line of rotors: lead-in columns, the task's columns, then columns at 90 deg.

    Args:
        task_axis: (line rows, task columns) [rad] axes of the task's columns. A single row holds
            for all rows of the line.
        size: "S" (two rows, 3 lead-in columns) or "B" (four rows, 5 lead-in columns).
        columns: number of columns of the whole surface.
        tilt: [rad] tilt of the surface, downhill towards +x.
    """
    checks.one_of("size", size, ("S", "B"))
    task = checks.angles("task_axis", checks.array("task_axis", task_axis, (None, None)))
    rows, lead_in = LINE_ROWS[size], LEAD_IN[size]
    if task.shape[0] not in (1, rows):
        raise ValueError(f"task_axis must have 1 or {rows} rows, got {task.shape[0]}")
    checks.integer("columns", columns, least=lead_in + task.shape[1])
    first = (ROWS - rows) // 2
    axis = np.full((ROWS, columns), ROLLING)
    axis[first : first + rows, lead_in : lead_in + task.shape[1]] = task
    rotor = np.zeros((ROWS, columns), dtype=bool)
    rotor[first : first + rows] = True
    return Surface(axis=axis, rotor=rotor, tilt=tilt)


def sorting(
    size: str = "S", side: int = -1, task_columns: int = 30, columns: int = 40, tilt: float = 0.0
) -> Surface:
    """Return the layout of Figure 6a, which sorts to y < 0 (`side` is -1) or y > 0 (`side` is 1).

    The axes of `task_columns` columns are at 45 deg for side -1, and at -45 deg for side 1. For
    `size`, `columns` and `tilt` see `line`.
    """
    checks.one_of("side", side, (-1, 1))
    checks.integer("task_columns", task_columns, least=1)
    return line([[-side * math.pi / 4] * task_columns], size, columns, tilt)


def slowing(
    size: str = "S", angle: float = 0.0, task_columns: int = 2, columns: int = 40, tilt: float = 0.0
) -> Surface:
    """Return the layout of Figures 6b and 6c. The task columns of this layout slow a box.

    In task columns, rows at `angle` [rad] and -`angle` alternate. For other arguments see `line`.
    """
    return line(_alternating(size, angle, task_columns), size, columns, tilt)


def stopping(
    size: str = "S", angle: float = 0.0, task_columns: int = 2, columns: int = 40, tilt: float = 0.0
) -> Surface:
    """Return the layout of Section 5.3. The layout is `slowing` with one more column at 0 deg."""
    rows = [[*row, 0.0] for row in _alternating(size, angle, task_columns)]
    return line(rows, size, columns, tilt)


def _alternating(size: str, angle: float, task_columns: int) -> list[list[float]]:
    """Return axes (rows, `task_columns`) [rad]. Even rows have -`angle`, odd rows have `angle`."""
    angle = checks.angle("angle", angle)
    checks.integer("task_columns", task_columns, least=1)
    checks.one_of("size", size, ("S", "B"))
    return [[angle if row % 2 else -angle] * task_columns for row in range(LINE_ROWS[size])]
