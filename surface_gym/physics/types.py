"""Array types, named columns and scratch memory of the physics."""

import math
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

    axis: Places  # (rows, columns) the index of each rotor's axis in `direction`
    direction: Array  # (directions, 2) cosine and sine
    rotor: Booleans  # (rows, columns) a rotor, else a support
    stiffness: Array  # (rows, columns) [-] of an element against the others; the weights of Eq. (1)
    friction: Array  # (rows, columns, 3) [-] along a rotor's axis, across it, and of a support
    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch_x: float  # [m] from column to column
    pitch_y: float  # [m] from row to row
    along_factor: float  # [-] by which every rotor's friction along its axis is multiplied
    across_factor: float  # [-] across it
    support_factor: float  # [-] every support's
    gravity_x: float  # [m/s^2] g sin(tilt), its part along x
    gravity_y: float  # [m/s^2] along y
    gravity_normal: float  # [m/s^2] g cos(tilt)


class Body(NamedTuple):
    """Parcel on a surface. Mass cancels out of Eq. (1)-(4), so there is none here."""

    edges: Array  # (edges, 3) outward normal and distance from the centroid: inside is n . p <= d
    radius: float  # [m] of the circle around the centroid that holds the base
    com_x: float  # [m] centre of mass from the centroid, in the base frame
    com_y: float  # [m]
    com_height: float  # [m]
    gyration: float  # [m^2] inertia / mass


# Columns of `Bodies.body`.
RADIUS, COM_X, COM_Y, COM_HEIGHT, GYRATION, HALF_LENGTH, MASS = range(7)


class Bodies(NamedTuple):
    """Parcels as rows: the fields of a `Body`, and those for contacts between parcels."""

    # (bodies, 7) [m] radius, centre of mass x, y and height; [m^2] gyration; [m] from the centroid
    # to the rearmost point; [kg] mass
    body: Array
    edges: Array  # (bodies, edges, 3) of the base, padded with edges that never bound
    corners: Array  # (bodies, edges, 2) [m] of the base from its centroid, padded with repeats of
    # the first; all at the centroid where it is a disc


class Scratch(NamedTuple):
    """Memory of one step, made once by the caller: the contacts, in the order of the grid."""

    table: Array  # (TABLE_SIZE,) a row a quantity, a column a contact: see below
    marks: Integers  # (MARKS_SIZE,) counts and indices, in the same manner


class Contacts(NamedTuple):
    """Numbers of contacts in a scratch."""

    total: int
    supports: int  # of them


# The rows of a scratch, by where each begins. They lie a constant apart in one array, which tells
# the compiler that none overlaps another: it then works on several contacts at a time. A row is
# longer than it needs by a cache line, so that columns do not compete for the same lines.
CAPACITY = 4096  # contacts
STRIDE = CAPACITY + 8
(
    ARM_X,  # [m] from the centre of mass to the contact
    ARM_Y,  # [m]
    AXIS_X,  # cosine of the rotor axis; 1 on a support
    AXIS_Y,  # sine; 0 on a support
    STIFFNESS,  # [-]
    MU_ALONG,  # [-] friction along the axis
    MU_ACROSS,  # [-] across it
    PRESSURE,  # [m/s^2] of Eq. (1)'s plane at the contact, negative where it is lifted
    NORMAL,  # [m/s^2] normal force / mass
    MOST_ALONG,  # [m/s] friction along the axis once it slips, times dt
    MOST_ACROSS,  # [m/s] across it
    SLIP_ALONG,  # [-] velocity along the axis, over the rounding
    SLIP_ACROSS,  # [-] across it
    FORCE_X,  # [m/s] impulse of friction in a step
    FORCE_Y,  # [m/s]
    TORQUE,  # [m^2/s]
    CURVE_XX,  # the contact's share of the potential's second derivatives
    CURVE_XY,
    CURVE_XW,
    CURVE_YY,
    CURVE_YW,
    CURVE_WW,
    SLIDE_ALONG,  # [m/s] velocity along the axis where a line search begins
    RATE_ALONG,  # [m/s] its change to where it ends
    SLIDE_ACROSS,  # [m/s] the same across the axis
    RATE_ACROSS,  # [m/s]
    KINK_1,  # [-] where along the search the contact passes between sliding and held
    KINK_2,
    KINK_3,
    KINK_4,
    SLOPE,  # [m^2/s^2] the contact's share of the slope along the search
    BOUND_START,  # the base's edges as bounds on x along a row of the grid, an edge a column: [m]
    BOUND_SLOPE,  # [-]
    BOUND_SIDE,  # positive: x is bounded above; negative: below; 0: the edge lies along the row
    KINKS,  # [-] those of all contacts that lie within the search, one after the other
) = range(0, 35 * STRIDE, STRIDE)
TABLE_SIZE = KINKS + 4 * CAPACITY
(
    ROTOR,  # 1: the contact is a rotor; 0: a support
    SUPPORT,  # which contacts are supports, one after the other
    SPAN_ROW,  # the contacts lie in spans, a column each: their row,
    SPAN_FIRST,  # first column
    SPAN_LAST,  # and last
    COUNTS,  # of spans, negative once the contacts are invalid; and of supports
) = range(0, 6 * STRIDE, STRIDE)
SPANS, SUPPORTS = COUNTS, COUNTS + 1
MARKS_SIZE = COUNTS + 2

# Columns of a point between two parcels.
(
    NORMAL_X,  # unit normal from the first parcel to the second; the side is a quarter turn on
    NORMAL_Y,
    FIRST_X,  # [m] arm from the first's centre of mass
    FIRST_Y,
    SECOND_X,  # [m] from the second's
    SECOND_Y,
    CLOSING,  # [m/s] at which the point may close
    NORMAL_IMPULSE,  # [N s] impulse along the normal
    TANGENT_IMPULSE,  # [N s] along the side
    FRICTION_LIMIT,  # [N s] the most along the side
    NORMAL_STIFFNESS,  # [kg] k along the normal
    TANGENT_STIFFNESS,  # [kg] along the side
) = range(12)
POINT_SIZE = 12

# Indices into a parcel's state vector, float64. Velocity and acceleration are the centre of mass's.
X, Y, THETA, VX, VY, OMEGA, AX, AY = range(8)
STATE_SIZE = 8


def make_scratch() -> Scratch:
    """Make scratch with no contacts in it."""
    marks = np.zeros(MARKS_SIZE, dtype=np.int64)
    marks[SPANS] = -1
    return Scratch(table=np.zeros(TABLE_SIZE), marks=marks)


def table_row(scratch: Scratch, row: int, count: int) -> Array:
    """Return a row (count,) of the scratch's table, such as `NORMAL`, as a view."""
    return scratch.table[row : row + count]


def check_capacity(
    edges: int, radius: float, pitch: tuple[float, float], size: tuple[int, int]
) -> None:
    """Raise a ValueError where a base may have more contacts than a scratch has room for.

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
