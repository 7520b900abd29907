"""A table for a page: parcels on a surface of any layout, stepped like `simulate_together`.

The WebAssembly module holds a surface of one element. A page enlarges the arrays of the surface,
and writes its own surface and parcels to the memory.
"""

from typing import Any

import numpy as np

from surface_gym.compiler.jit import compiled
from surface_gym.parcel import Parcel, Rectangle, make_bodies
from surface_gym.physics.collision import (
    ContactMaterial,
    World,
    WorldScratch,
    invalidate_world,
    make_world_scratch,
)
from surface_gym.physics.contact_solver import step_world
from surface_gym.physics.step import OFF_SURFACE, axis_direction
from surface_gym.physics.types import Array, Grid
from surface_gym.surface import Surface

PARCELS = 24  # maximum number of parcels


@compiled
def step_table(
    grid: Grid,
    world: World,
    material: ContactMaterial,
    scratch: WorldScratch,
    angle: Array,
    turned: int,
    dt: float,
) -> int:
    """Do a step of `dt` [s]. Parcels of `world` that leave the surface are no longer present.

    Args:
        angle: (rows, columns) [rad] angles of the axes.
        turned: 1 if the page has changed any array since the last step, else 0.

    Returns:
        The number of pairs of parcels that pushed each other.
    """
    if turned != 0:
        invalidate_world(scratch)
        for row in range(angle.shape[0]):
            for column in range(angle.shape[1]):
                cosine, sine = axis_direction(angle[row, column])
                place = grid.axis[row, column]
                grid.direction[place, 0] = cosine
                grid.direction[place, 1] = sine
    pairs = step_world(grid, world, material, scratch, dt)
    for i in range(world.present.shape[0]):
        world.present[i] &= scratch.report[i] < OFF_SURFACE
    return pairs


def table_arguments() -> tuple[Any, ...]:
    """Make arguments of `step_table` for a surface with one module and without parcels."""
    surface = Surface(axis=np.zeros((1, 1)), rotor=np.ones((1, 1), dtype=bool))
    bodies = make_bodies([Parcel(Rectangle(0.25, 0.25))] * PARCELS)
    world = World(
        state=np.zeros((PARCELS, 8)),
        present=np.zeros(PARCELS, dtype=np.bool_),
        body=np.arange(PARCELS),
        bodies=bodies,
    )
    scratch, angle = make_world_scratch(PARCELS), np.zeros((1, 1))
    return surface.grid, world, ContactMaterial(0.0, 0.3), scratch, angle, 1, 0.005
