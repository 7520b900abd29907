"""Memory for the compiled functions, made outside them."""

import math

import numpy as np

from surface_gym.dynamics.types import Body, Grid, Scratch


def make_scratch(grid: Grid, body: Body) -> Scratch:
    """Scratch that holds every contact the body can have on the grid, whatever its pose."""
    across = math.floor(2.0 * body.radius / grid.pitch) + 2
    rows, columns = grid.rotor.shape
    capacity = min(rows, across) * min(columns, across)
    return Scratch(
        arm_x=np.zeros(capacity),
        arm_y=np.zeros(capacity),
        axis_x=np.zeros(capacity),
        axis_y=np.zeros(capacity),
        rotor=np.zeros(capacity, dtype=np.bool_),
        stiffness=np.zeros(capacity),
        normal=np.zeros(capacity),
        edges=np.zeros(body.edges.shape),
        slide=np.zeros((capacity, 4)),
    )
