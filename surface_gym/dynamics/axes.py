"""Cosine and sine of a rotor's axis, exact where the study's layouts need them exact."""

import math

import numpy as np

from surface_gym.dynamics.compiled import compiled, inlined
from surface_gym.dynamics.types import Array

EIGHTH = 0.25 * math.pi  # [rad] 45 deg
HALF_ROOT = math.sqrt(0.5)
ROUND_OFF = 1e-15  # [-] of an angle: what float64 leaves of a multiple of 45 deg


@inlined
def axis_direction(angle: float) -> tuple[float, float]:
    """Cosine and sine of an axis angle [rad]; at multiples of 45 deg they are exact.

    math.cos(pi / 2) is 6e-17: enough to tell a rotor that lies across the motion that it drags.
    """
    eighths = math.floor(angle / EIGHTH + 0.5)
    if abs(angle - eighths * EIGHTH) > ROUND_OFF * abs(angle):
        return math.cos(angle), math.sin(angle)
    place = eighths % 8.0
    cosine = sine = HALF_ROOT
    if place % 2.0 == 0.0:
        cosine = (place == 0.0) * 1.0 - (place == 4.0) * 1.0
        sine = (place == 2.0) * 1.0 - (place == 6.0) * 1.0
        return cosine, sine
    if 2.0 < place < 6.0:
        cosine = -cosine
    if place > 4.0:
        sine = -sine
    return cosine, sine


@compiled
def _write_directions(angles: Array, directions: Array) -> None:
    for i in range(angles.shape[0]):
        directions[i, 0], directions[i, 1] = axis_direction(angles[i])


def directions_of(angles: Array) -> Array:
    """(angles, 2) cosine and sine of axis angles (angles,) [rad]."""
    directions = np.empty((len(angles), 2))
    _write_directions(np.array(angles, dtype=np.float64), directions)
    return directions
