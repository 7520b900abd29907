"""Axis angles of surfaces, however their memory keeps them."""

import numpy as np

from surface_gym.dynamics.types import Array
from surface_gym.lanes.memory import Surfaces

ALL = slice(None)


def angles_of(surfaces: Surfaces, which: slice = ALL) -> Array:
    """(surfaces, rows, columns) [rad] axis angles of some surfaces."""
    axis = surfaces.axis[which]
    direction = surfaces.direction if len(surfaces.direction) == 1 else surfaces.direction[which]
    angles = np.arctan2(direction[:, :, 1], direction[:, :, 0])
    if len(surfaces.direction) == 1:
        return np.asarray(angles[0, axis])
    places = axis.reshape(len(angles), -1)
    return np.take_along_axis(angles, places, axis=1).reshape(axis.shape)
