"""A lane as the physics sees it: views into the batch, no copies."""

import math

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import OMEGA, THETA, VX, VY, Body, Grid, Scratch, X, Y
from surface_gym.lanes.memory import (
    COM_HEIGHT,
    COM_X,
    COM_Y,
    GRAVITY_ALONG,
    GRAVITY_NORMAL,
    GYRATION,
    MU_MAX,
    MU_MIN,
    MU_SUPPORT,
    RADIUS,
    Geometry,
    Lanes,
)


@inlined
def grid_of(lanes: Lanes, lane: int, geometry: Geometry) -> Grid:
    """The surface of a lane."""
    return Grid(
        lanes.axis[lane],
        lanes.rotor[lane],
        lanes.stiffness[lane],
        geometry.x0,
        geometry.y0,
        geometry.pitch,
        lanes.surface[lane, MU_MAX],
        lanes.surface[lane, MU_MIN],
        lanes.surface[lane, MU_SUPPORT],
        lanes.surface[lane, GRAVITY_ALONG],
        lanes.surface[lane, GRAVITY_NORMAL],
    )


@inlined
def body_of(lanes: Lanes, lane: int) -> Body:
    """The parcel of a lane."""
    return Body(
        lanes.edges[lane],
        lanes.body[lane, RADIUS],
        lanes.body[lane, COM_X],
        lanes.body[lane, COM_Y],
        lanes.body[lane, COM_HEIGHT],
        lanes.body[lane, GYRATION],
    )


@inlined
def scratch_of(scratch: Scratch, thread: int) -> Scratch:
    """The scratch of a thread."""
    return Scratch(
        scratch.arm_x[thread],
        scratch.arm_y[thread],
        scratch.axis_x[thread],
        scratch.axis_y[thread],
        scratch.rotor[thread],
        scratch.stiffness[thread],
        scratch.normal[thread],
        scratch.edges[thread],
        scratch.slide[thread],
    )


@inlined
def read_truth(lanes: Lanes, lane: int) -> None:
    """Write pose and velocity of the base's centroid from the state of the centre of mass."""
    state = lanes.state[lane]
    truth = lanes.truth[lane]
    cosine = math.cos(state[THETA])
    sine = math.sin(state[THETA])
    arm_x = cosine * lanes.body[lane, COM_X] - sine * lanes.body[lane, COM_Y]
    arm_y = sine * lanes.body[lane, COM_X] + cosine * lanes.body[lane, COM_Y]
    truth[0] = state[X] - arm_x
    truth[1] = state[Y] - arm_y
    truth[2] = state[THETA]
    truth[3] = state[VX] + state[OMEGA] * arm_y
    truth[4] = state[VY] - state[OMEGA] * arm_x
    truth[5] = state[OMEGA]


@inlined
def reach_along(lanes: Lanes, lane: int, theta: float, nx: float, ny: float) -> float:
    """[m] how far the base reaches from its centroid in the direction (nx, ny).

    A base without corners, a disc, has them all at its centroid and reaches its radius.
    """
    cosine = math.cos(theta)
    sine = math.sin(theta)
    along_x = cosine * nx + sine * ny
    along_y = cosine * ny - sine * nx
    corners = lanes.corners[lane]
    farthest = -1.0
    for k in range(corners.shape[0]):
        farthest = max(farthest, corners[k, 0] * along_x + corners[k, 1] * along_y)
    return farthest if farthest > 0.0 else lanes.body[lane, RADIUS]
