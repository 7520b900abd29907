"""A lane as a task's and a sensor's compiled functions see it, and what they may ask of it."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import (
    COM_X,
    COM_Y,
    HALF_LENGTH,
    OMEGA,
    RADIUS,
    THETA,
    VX,
    VY,
    Array,
    Booleans,
    Integers,
    Places,
    X,
    Y,
)
from surface_gym.lanes.memory import COLUMNS, FIRST_COLUMN, Geometry, Lanes, Sites, Surfaces


class Lane(NamedTuple):
    """One parcel on one surface: numbers, and views of its rows in the batch's memory.

    `truth` and `sensed` hold x, y, theta, vx, vy, omega at the places X, Y, THETA, VX, VY, OMEGA.
    """

    state: Array  # (STATE_SIZE,) of the centre of mass: also its acceleration, at AX and AY
    truth: Array  # (6,) pose and velocity of the base's centroid; in `over` see `read_truth`
    sensed: Array  # (6,) what the sensor says of it
    clock: float  # [s] since the start
    period: float  # [s] since the last decision
    steps: int  # physics steps since the start
    on_rotors: bool  # a rotor bears the parcel
    on_surface: bool  # its centre of mass is over the surface
    surface: Array  # (5,) factors of friction [-], gravity along and normal [m/s^2]
    body: Array  # (7,) of the parcel: RADIUS ... MASS
    edges: Array  # (edges, 3) of its base: outward normals and distances [m] from the centroid
    corners: Array  # (edges, 2) [m] of its base from the centroid
    zone: Integers  # (4,) FIRST_ROW, ROWS, FIRST_COLUMN, COLUMNS that obey
    elements: Geometry  # where they lie
    axis: Places  # (rows, columns) the place of each rotor's axis in `direction`
    direction: Array  # (directions, 2) cosine and sine of an axis
    rotor: Booleans  # (rows, columns) a rotor, else a support
    obeys: Booleans  # (rows, columns) a rotor in the zone, not stuck
    goal: Array  # (goals,) the task's own, as its starts give them
    path: Array  # (PATH_POINTS,) [m] y of a path to follow, evenly spaced in x
    memory: Array  # (memories,) what the task remembers
    figures: Array  # (figures,) the task's own numbers in `info`: to write
    terms: Array  # (terms,) of the reward: to write
    observation: NDArray[np.float32]  # (features,) to write
    noise: Array  # (NOISE_ROWS, 4) drawn ahead for the sensor
    noise_row: Integers  # (1,) the next to use
    kept: Array  # (kept,) what the sensor remembers


@inlined
def lane_of(
    surfaces: Surfaces, lanes: Lanes, sites: Sites, surface: int, lane: int, elements: Geometry
) -> Lane:
    """The view of the parcel in a row of `lanes` on the surface in a row of `surfaces`."""
    site = lanes.site[lane]
    layout = site if sites.rotor.shape[0] > 1 else 0
    return Lane(
        lanes.state[lane],
        lanes.truth[lane],
        lanes.sensed[lane],
        lanes.clock[lane],
        lanes.period[lane],
        lanes.steps[lane],
        lanes.on_rotors[lane],
        lanes.on_surface[lane],
        surfaces.conditions[surface],
        sites.body[site],
        sites.edges[site],
        sites.corners[site],
        sites.zone[layout],
        elements,
        surfaces.axis[surface],
        surfaces.direction[surface if surfaces.direction.shape[0] > 1 else 0],
        sites.rotor[layout],
        sites.obeys[layout],
        lanes.goal[lane],
        lanes.path[lane],
        lanes.memory[lane],
        lanes.figures[lane],
        lanes.terms[lane],
        lanes.observation[lane],
        lanes.noise[lane],
        lanes.noise_row[lane],
        lanes.kept[lane],
    )


@inlined
def read_truth(lane: Lane) -> None:
    """Bring `lane.truth` up to date with `lane.state`.

    It is up to date in `begin`, `judge`, `reward` and `observe`. `over` is asked after every
    physics step, where few need it.
    """
    state = lane.state
    truth = lane.truth
    cosine = math.cos(state[THETA])
    sine = math.sin(state[THETA])
    arm_x = cosine * lane.body[COM_X] - sine * lane.body[COM_Y]
    arm_y = sine * lane.body[COM_X] + cosine * lane.body[COM_Y]
    truth[X] = state[X] - arm_x
    truth[Y] = state[Y] - arm_y
    truth[THETA] = state[THETA]
    truth[VX] = state[VX] + state[OMEGA] * arm_y
    truth[VY] = state[VY] - state[OMEGA] * arm_x
    truth[OMEGA] = state[OMEGA]


@inlined
def reach_along(lane: Lane, theta: float, nx: float, ny: float) -> float:
    """[m] how far the base, turned by theta, reaches from its centroid in the direction (nx, ny).

    A base without corners, a disc, has them all at its centroid and reaches its radius.
    """
    cosine = math.cos(theta)
    sine = math.sin(theta)
    along_x = cosine * nx + sine * ny
    along_y = cosine * ny - sine * nx
    corners = lane.corners
    farthest = -1.0
    for k in range(corners.shape[0]):
        farthest = max(farthest, corners[k, 0] * along_x + corners[k, 1] * along_y)
    return farthest if farthest > 0.0 else lane.body[RADIUS]


@inlined
def zone_start(lane: Lane) -> float:
    """[m] x half a pitch before the centres of the zone's first column."""
    return lane.elements.x0 + lane.elements.pitch_x * (lane.zone[FIRST_COLUMN] - 0.5)


@inlined
def zone_end(lane: Lane) -> float:
    """[m] x half a pitch past the centres of the zone's last column."""
    after = lane.zone[FIRST_COLUMN] + lane.zone[COLUMNS]
    return lane.elements.x0 + lane.elements.pitch_x * (after - 0.5)


@inlined
def speed_of(motion: Array) -> float:
    """[m/s] of `lane.truth` or `lane.sensed`."""
    return math.sqrt(motion[VX] * motion[VX] + motion[VY] * motion[VY])


@inlined
def is_slower(lane: Lane, speed: float) -> bool:
    """Whether no point of the parcel moves faster than a speed [m/s]."""
    truth = lane.truth
    return speed_of(truth) + abs(truth[OMEGA]) * lane.body[HALF_LENGTH] < speed
