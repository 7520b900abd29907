"""Memory for the compiled functions, made outside them."""

import math

import numpy as np

from surface_gym.dynamics.types import (
    CAPACITY,
    MARKS_SIZE,
    SPANS,
    TABLE_SIZE,
    Array,
    Scratch,
)


def make_scratch() -> Scratch:
    """Scratch that says nothing of any contact."""
    marks = np.zeros(MARKS_SIZE, dtype=np.int64)
    marks[SPANS] = -1
    return Scratch(table=np.zeros(TABLE_SIZE), marks=marks)


def row_of(scratch: Scratch, row: int, count: int) -> Array:
    """(count,) of a row of the scratch's table, such as `NORMAL`: a view."""
    return scratch.table[row : row + count]


def check_capacity(
    edges: int, radius: float, pitch: tuple[float, float], size: tuple[int, int]
) -> None:
    """Raise a ValueError where a base has more edges, or may cover more elements, than a scratch
    has room for.

    Args:
        edges: of the base.
        radius: [m] of the circle around its centroid that holds it.
        pitch: [m] between elements, in x and in y.
        size: elements of the surface, in x and in y.
    """
    if edges > CAPACITY:
        raise ValueError(f"base must have at most {CAPACITY} edges, got {edges}")
    across = [min(math.floor(2.0 * radius / p) + 1, n) for p, n in zip(pitch, size, strict=True)]
    if math.prod(across) > CAPACITY:
        raise ValueError(
            f"base must cover at most {CAPACITY} elements, got up to {math.prod(across)}: it "
            f"reaches {radius:g} m from its centroid at a pitch of {pitch[0]:g} m x {pitch[1]:g} m"
        )
