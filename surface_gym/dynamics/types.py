"""What the compiled functions pass to each other: plain tuples of numbers and arrays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

GRAVITY = 9.81  # [m/s^2]

Array = NDArray[np.float64]


class Grid(NamedTuple):
    """A surface as the physics reads it."""

    direction: Array  # (rows, columns, 2) cosine and sine of each rotor axis
    rotor: NDArray[np.bool_]  # (rows, columns) a rotor, else a support
    stiffness: Array  # (rows, columns) [-] of an element against the others; what Eq. (1) weighs by
    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch: float  # [m]
    mu_max: float  # [-] along the axis
    mu_min: float  # [-] across the axis
    mu_support: float  # [-]
    gravity_along: float  # [m/s^2] g sin(tilt), towards +x
    gravity_normal: float  # [m/s^2] g cos(tilt)


class Body(NamedTuple):
    """A parcel as the physics reads it. Mass cancels out of Eq. (1)-(4), so none is here."""

    edges: Array  # (edges, 3) outward normal and distance from the centroid: inside is n . p <= d
    radius: float  # [m] of the circle around the centroid that holds the base
    com_x: float  # [m] centre of mass from the centroid, in the base frame
    com_y: float  # [m]
    com_height: float  # [m]
    gyration: float  # [m^2] inertia / mass


class Scratch(NamedTuple):
    """Memory of one step, made once by the caller: the contacts, in the order of the grid."""

    arm_x: Array  # (capacity,) [m] from the centre of mass to the contact
    arm_y: Array  # (capacity,) [m]
    axis_x: Array  # (capacity,) cosine of the rotor axis under the contact
    axis_y: Array  # (capacity,) sine
    rotor: NDArray[np.bool_]  # (capacity,) a rotor, else a support
    stiffness: Array  # (capacity,) [-]
    normal: Array  # (capacity,) [m/s^2] normal force / mass
    edges: Array  # (edges, 3) the base's edges as bounds on x along a row of the grid
    slide: Array  # (capacity, 4) a line search's contact velocities and their slopes


# Places in a parcel's state vector, float64. Velocity and acceleration are the centre of mass's.
X, Y, THETA, VX, VY, OMEGA, AX, AY = range(8)
STATE_SIZE = 8
