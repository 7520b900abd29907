"""Array types, named columns and scratch memory of the physics."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

GRAVITY = 9.81  # [m/s^2]

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]
Places = NDArray[np.int32]


class Grid(NamedTuple):
    """Surface under one parcel."""

    axis: Places  # (rows, columns) index of a rotor's axis in `direction`
    direction: Array  # (directions, 2) cosine and sine
    # (directions, 3) [m/s] velocity of a module's surface along its axis and across it; [-] 1: a
    # driven module, which grips alike in all directions; 0: an idle rotor
    drive: Array
    rotor: Booleans  # (rows, columns) a rotor, else a support
    stiffness: Array  # (rows, columns) [-] relative stiffness of an element; weights Eq. (1)
    friction: Array  # (rows, columns, 3) [-] friction along a rotor's axis, across it, on a support
    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch_x: float  # [m] from column to column
    pitch_y: float  # [m] from row to row
    along_factor: float  # [-] factor of every rotor's friction along its axis
    across_factor: float  # [-] factor of every rotor's friction across its axis
    support_factor: float  # [-] factor of every support's friction
    gravity_x: float  # [m/s^2] g sin(tilt), component along x
    gravity_y: float  # [m/s^2] along y
    gravity_normal: float  # [m/s^2] g cos(tilt)


class Body(NamedTuple):
    """Parcel on a surface, described without mass, since mass cancels out of Eq. (1)-(4)."""

    edges: Array  # (edges, 3) outward normal and distance from the centroid; n . p <= d inside
    radius: float  # [m] radius of the base's circumscribed circle around the centroid
    com_x: float  # [m] centre of mass from the centroid, in the base frame
    com_y: float  # [m]
    com_height: float  # [m]
    gyration: float  # [m^2] inertia / mass


# Columns of `Bodies.body`.
RADIUS, COM_X, COM_Y, COM_HEIGHT, GYRATION, HALF_LENGTH, MASS = range(7)


class Bodies(NamedTuple):
    """Parcels as rows: the fields of `Body`, and fields for contacts between parcels."""

    # (bodies, 7) [m] radius, centre of mass x, y and height; [m^2] gyration; [m] from the centroid
    # to the rearmost point; [kg] mass
    body: Array
    edges: Array  # (bodies, edges, 3) edges of the base, padded with `parcel.NO_EDGE`
    # (bodies, edges, 2) [m] corners from the base's centroid, padded with repeats of the first; all
    # corners of a disc are at the centroid
    corners: Array


class Scratch(NamedTuple):
    """Memory of one step, allocated once by the caller. The contacts are in grid order."""

    table: Array  # (TABLE_SIZE,) one row per quantity, one column per contact, see below
    marks: Integers  # (MARKS_SIZE,) counts and indices in the same layout


class Contacts(NamedTuple):
    """How many contacts of each kind a scratch holds."""

    total: int
    isotropic: int  # how many of them grip alike in all directions
    supports: int  # how many of them are supports


# Offsets of the rows of a scratch. A constant stride in one array proves to the compiler that rows
# do not overlap, so it vectorises the loops over contacts. Each row has one spare cache line, so
# that columns do not compete for the same lines.
CAPACITY = 4096  # contacts
STRIDE = CAPACITY + 8
(
    ARM_X,  # [m] from the centre of mass to the contact
    ARM_Y,  # [m]
    AXIS_X,  # cosine of the rotor axis; 1 if friction is isotropic
    AXIS_Y,  # sine; 0 if friction is isotropic
    STIFFNESS,  # [-]
    DRIVE_ALONG,  # [m/s] velocity of the module's surface along the axis
    DRIVE_ACROSS,  # [m/s] across it
    MU_ALONG,  # [-] friction along the axis
    MU_ACROSS,  # [-] across it
    PRESSURE,  # [m/s^2] plane of Eq. (1) at the contact, negative if lifted
    NORMAL,  # [m/s^2] normal force / mass
    MOST_ALONG,  # [m/s] friction along the axis once it slips, times dt
    MOST_ACROSS,  # [m/s] across it
    # [-] velocity along the axis over the module's surface, over the rounding; [m/s] if friction is
    # isotropic
    SLIP_ALONG,
    SLIP_ACROSS,  # across it
    SLIP_SPEED,  # [m/s] if friction is isotropic
    SHARE,  # [-] impulse of friction over the slip, if friction is isotropic
    FORCE_X,  # [m/s] impulse of friction in a step
    FORCE_Y,  # [m/s]
    TORQUE,  # [m^2/s]
    CURVE_XX,  # the contact's share of the potential's second derivatives
    CURVE_XY,
    CURVE_XW,
    CURVE_YY,
    CURVE_YW,
    CURVE_WW,
    SLIDE_ALONG,  # [m/s] slip along the axis where a line search begins
    RATE_ALONG,  # [m/s] change of this velocity over the search
    SLIDE_ACROSS,  # [m/s] the same across the axis
    RATE_ACROSS,  # [m/s]
    KINK_1,  # [-] step at which the contact passes between sliding and held
    KINK_2,
    KINK_3,
    KINK_4,
    SLOPE,  # [m^2/s^2] the contact's share of the slope along the search
    BOUND_START,  # [m] the base's edges as bounds on x along a grid row, one column per edge
    BOUND_SLOPE,  # [-]
    BOUND_SIDE,  # positive: x is bounded above; negative: below; 0: the edge lies along the row
    KINKS,  # [-] kinks of all contacts within the search, one after the other
) = range(0, 39 * STRIDE, STRIDE)
TABLE_SIZE = KINKS + 4 * CAPACITY
(
    KIND,  # kind of the element: SUPPORT, ROTOR or DRIVEN
    ISOTROPIC,  # indices of the contacts that grip alike in all directions
    SPAN_ROW,  # contacts lie in spans, one span per column: row,
    SPAN_FIRST,  # first column
    SPAN_LAST,  # and last
    COUNTS,  # numbers of spans (negative if the contacts are invalid), isotropic ones, supports
) = range(0, 6 * STRIDE, STRIDE)
SPANS, ISOTROPICS, SUPPORTS = range(COUNTS, COUNTS + 3)
MARKS_SIZE = COUNTS + 3
SUPPORT, ROTOR, DRIVEN = range(3)  # kinds of elements; an idle rotor, a driven module

# Columns of a point between two parcels.
(
    NORMAL_X,  # unit normal from the first parcel to the second; the side is turned by 90 deg
    NORMAL_Y,
    FIRST_X,  # [m] arm from the first's centre of mass
    FIRST_Y,
    SECOND_X,  # [m] arm from the second's centre of mass
    SECOND_Y,
    CLOSING,  # [m/s] allowed closing speed
    NORMAL_IMPULSE,  # [N s] impulse along the normal
    TANGENT_IMPULSE,  # [N s] along the side
    FRICTION_LIMIT,  # [N s] maximum impulse along the side
    NORMAL_STIFFNESS,  # [kg] k along the normal
    TANGENT_STIFFNESS,  # [kg] along the side
    NORMAL_TOTAL,  # [N s] impulse along the normal of the whole step, a hit included
    TANGENT_TOTAL,  # [N s] along the side
) = range(14)
POINT_SIZE = 14

# Indices into a parcel's state vector, float64. Velocity and acceleration refer to the centre of
# mass.
X, Y, THETA, VX, VY, OMEGA, AX, AY = range(8)
STATE_SIZE = 8


def make_scratch() -> Scratch:
    """Make a scratch without contacts."""
    marks = np.zeros(MARKS_SIZE, dtype=np.int64)
    marks[SPANS] = -1
    return Scratch(table=np.zeros(TABLE_SIZE), marks=marks)


def table_row(scratch: Scratch, row: int, count: int) -> Array:
    """Return a view (count,) of a row of `scratch.table`. The argument `row` is e.g. `NORMAL`."""
    return scratch.table[row : row + count]


@lru_cache(maxsize=256)
def check_capacity(
    edges: int, radius: float, pitch: tuple[float, float], size: tuple[int, int]
) -> None:
    """Raise a ValueError if a base may have more contacts than a scratch can hold.

    Args:
        radius: [m] distance from the base's centroid to the base's farthest point.
        pitch: [m] distance between elements, in x and in y.
        size: number of elements of the surface, in x and in y.
    """
    if edges > CAPACITY:
        raise ValueError(f"base must have at most {CAPACITY} edges, got {edges}")
    across = [min(math.floor(2.0 * radius / p) + 1, n) for p, n in zip(pitch, size, strict=True)]
    if math.prod(across) > CAPACITY:
        raise ValueError(
            f"base must cover at most {CAPACITY} elements, got up to {math.prod(across)}: it "
            f"reaches {radius:g} m from its centroid at a pitch of {pitch[0]:g} m x {pitch[1]:g} m"
        )
