"""Eq. (1) solved by a reference in the dual's place, for the contacts in a scratch."""

import numpy as np

from surface_gym.dynamics.entries import load_point
from surface_gym.dynamics.memory import row_of
from surface_gym.dynamics.types import (
    ARM_X,
    ARM_Y,
    NORMAL,
    STIFFNESS,
    Array,
    Body,
    Grid,
    Scratch,
)


def bear_load_by(
    solver: str, grid: Grid, body: Body, state: Array, scratch: Scratch, count: int
) -> bool:
    """Normal forces of the contacts in `scratch`; whether they are degenerate.

    Args:
        solver: a key of `references.SOLVERS`.
        grid: the surface.
        body: the parcel.
        state: (STATE_SIZE,) at the start of the step.
        scratch: that holds the contacts.
        count: of the contacts, at least one.
    """
    from surface_gym.dynamics import references

    arms = np.column_stack([row_of(scratch, ARM_X, count), row_of(scratch, ARM_Y, count)])
    load = np.array(load_point(grid, body, state))
    stiffness = row_of(scratch, STIFFNESS, count)
    normal, degenerate = references.SOLVERS[solver](arms, grid.gravity_normal, load, stiffness)
    row_of(scratch, NORMAL, count)[:] = normal
    return degenerate
