"""Which elements of a surface a parcel lies on, and which it can come to."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym.parcel import Parcel
from surface_gym.physics.contacts import EDGE_TOLERANCE
from surface_gym.physics.types import GRAVITY
from surface_gym.surface import Surface


def under(surface: Surface, parcel: Parcel, pose: ArrayLike) -> NDArray[np.bool_]:
    """The elements under a base, (rows, columns): Section 3.2's F_lambda <= 0.

    Args:
        surface: the surface.
        parcel: the parcel.
        pose: (x, y, theta) [m, m, rad] of the base's frame.
    """
    x, y, theta = np.asarray(pose, dtype=np.float64)
    dx, dy = np.meshgrid(surface.x - x, surface.y - y)
    cosine, sine = math.cos(theta), math.sin(theta)
    outside = parcel.base.functions(cosine * dx + sine * dy, cosine * dy - sine * dx)
    return np.asarray(outside.max(axis=0) <= EDGE_TOLERANCE)


def reachable(
    surface: Surface, parcel: Parcel, pose: ArrayLike, velocity: ArrayLike, duration: float
) -> NDArray[np.bool_]:
    """The elements, (rows, columns), that a parcel can come to by its energy, friction left out.

    Args:
        surface: the surface.
        parcel: the parcel.
        pose: (x, y, theta) [m, m, rad] of the base's frame at the start.
        velocity: (vx, vy, omega) [m/s, m/s, rad/s] of that frame at the start.
        duration: [s].
    """
    x, y, _ = np.asarray(pose, dtype=np.float64)
    vx, vy, omega = np.asarray(velocity, dtype=np.float64)
    com_x, com_y = parcel.centre_of_mass
    arm = math.hypot(com_x, com_y)
    gyration = parcel.moment_of_inertia / parcel.mass
    speed = math.hypot(math.hypot(vx, vy) + arm * abs(omega), omega * math.sqrt(gyration))
    downhill = GRAVITY * abs(math.sin(surface.tilt))
    path = speed * duration + 0.5 * downhill * duration**2
    outline = parcel.base.outline
    base = float(np.hypot(outline[:, 0], outline[:, 1]).max())
    pitch = max(surface.pitch_x, surface.pitch_y)
    # Twice the arm: the base's frame is one arm from the centre of mass at either end of the path.
    distance = np.hypot(*np.meshgrid(surface.x - x, surface.y - y))
    return np.asarray(distance <= path + base + 2.0 * arm + pitch)
