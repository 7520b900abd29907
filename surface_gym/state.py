"""The state arrays of all environments, and the view of one of them.

An environment is one surface. Where it carries one parcel, as in every task but a stream's, row i
of the surfaces and of the parcels is environment i's.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.compiler.jit import inlined
from surface_gym.physics import types as ph
from surface_gym.physics.types import Array, Body, Booleans, Grid, Integers, Places

# Columns of `SurfaceState.conditions`.
ALONG_FACTOR, ACROSS_FACTOR, SUPPORT_FACTOR, GRAVITY_X, GRAVITY_Y, GRAVITY_NORMAL = range(6)
CONDITION_COLUMNS = 6
GRAVITY_COLUMNS = slice(GRAVITY_X, GRAVITY_NORMAL + 1)
# Columns of `BodyTable.zone`.
FIRST_ROW, ROWS, FIRST_COLUMN, COLUMNS = range(4)

# `ParcelState.outcome`: how an episode stands. A task's failures follow, in its order. Running out
# of time truncates an episode and is none of them. An environment in STARTING has been placed.
STARTING, RUNNING, OUT_OF_TIME, SUCCESS, FIRST_FAILURE = range(-1, 4)
COMMON_OUTCOMES = ("running", "out of time", "success")

# `ParcelState.fault`: the error that a task's functions made.
NO_FAULT, UNKNOWN_OUTCOME, BAD_REWARD, BAD_OBSERVATION = range(4)

PATH_POINTS = 256  # of a path, evenly spaced in x
NOISE_ROWS = 64  # draws made ahead; each three standard normals and one uniform in [0, 1)


class SurfaceState(NamedTuple):
    """State of every surface, a row each. What is the same for all has one row."""

    axis: Places  # (surfaces, rows, columns) index of each rotor's axis among the directions
    direction: Array  # (surfaces or 1, directions, 2) cosine and sine of an axis
    angle: Array  # (surfaces, rows, columns) [rad] of each axis, where axes take time to turn
    target: Array  # (surfaces, rows, columns) [rad] it turns to
    stiffness: Array  # (surfaces or 1, rows, columns) [-]
    # (surfaces, 6) factors of friction [-], gravity along x, along y and normal [m/s^2]
    conditions: Array
    # (surfaces, command size) the action: choices, or angles [rad]
    command: NDArray[Any]


class ParcelState(NamedTuple):
    """State and results of every parcel, a row each. Arrays a task does not use have no columns.

    With P parcels to an environment, environment i has the rows from i P on; P is 1 in every task
    but a stream's.
    """

    state: Array  # (rows, STATE_SIZE) of the centre of mass
    truth: Array  # (rows, 6) pose and velocity of the base's centroid
    sensed: Array  # (rows, 6) the same as the sensor gives it
    clock: Array  # (rows,) [s] since the start
    period: Array  # (rows,) [s] since the last decision
    steps: Integers  # (rows,) physics steps since the start
    on_rotors: Booleans  # (rows,) a rotor supports the parcel
    on_surface: Booleans  # (rows,) the parcel's centre of mass is over the surface
    body: Integers  # (rows,) the parcel's row in the body table
    goal: Array  # (rows, goals) the task's own, as its starts give them
    path: Array  # (rows, PATH_POINTS or 0) [m] y of a path to follow, evenly spaced in x
    memory: Array  # (rows, memories) the task's memory
    metrics: Array  # (rows, metrics) the task's own numbers in `info`
    noise: Array  # (rows, NOISE_ROWS or 0, 4) drawn ahead for the sensor
    noise_row: Integers  # (rows, 1) the next to use
    sensor_state: Array  # (rows, sensor state) the sensor's memory
    observation: NDArray[np.float32]  # (rows, observation size)
    terms: Array  # (rows, reward terms)
    reward: Array  # (rows,) their sum
    outcome: Integers  # (rows,) index among the common outcomes and the task's failures
    fault: Integers  # (rows,)


class BodyTable(NamedTuple):
    """Parcels on their line, a row each. Environments whose parcels are alike share one.

    What of the line is the same for all parcels has one row.
    """

    rotor: Booleans  # (bodies or 1, rows, columns)
    obeys: Booleans  # (bodies or 1, rows, columns) a rotor in the zone that is not stuck
    body: Array  # (bodies, 7) as `Bodies.body`
    edges: Array  # (bodies, edges, 3) as `Bodies.edges`
    corners: Array  # (bodies, edges, 2) [m] as `Bodies.corners`
    zone: Integers  # (bodies or 1, 4) first row, rows, first column, columns of the zone


class Geometry(NamedTuple):
    """Positions of the elements, the same for every environment."""

    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch_x: float  # [m] from column to column
    pitch_y: float  # [m] from row to row
    line_y: float  # [m] middle of the line


class Timing(NamedTuple):
    """Physics steps of a control period."""

    dt: float  # [s] physics step
    steps: int  # in a control period


@inlined
def read_grid(
    surfaces: SurfaceState,
    bodies: BodyTable,
    surface: int,
    body: int,
    elements: Geometry,
    friction: Array,
) -> Grid:
    """Read a surface as the physics of one body takes it, with the friction (rows, columns, 3)."""
    conditions = surfaces.conditions[surface]
    return Grid(
        surfaces.axis[surface],
        surfaces.direction[surface if surfaces.direction.shape[0] > 1 else 0],
        bodies.rotor[body if bodies.rotor.shape[0] > 1 else 0],
        surfaces.stiffness[surface if surfaces.stiffness.shape[0] > 1 else 0],
        friction,
        elements.x0,
        elements.y0,
        elements.pitch_x,
        elements.pitch_y,
        conditions[ALONG_FACTOR],
        conditions[ACROSS_FACTOR],
        conditions[SUPPORT_FACTOR],
        conditions[GRAVITY_X],
        conditions[GRAVITY_Y],
        conditions[GRAVITY_NORMAL],
    )


@inlined
def read_body(bodies: BodyTable, body: int) -> Body:
    """Read a row of the body table as the physics of one parcel takes it."""
    return Body(
        bodies.edges[body],
        bodies.body[body, ph.RADIUS],
        bodies.body[body, ph.COM_X],
        bodies.body[body, ph.COM_Y],
        bodies.body[body, ph.COM_HEIGHT],
        bodies.body[body, ph.GYRATION],
    )


class EnvState(NamedTuple):
    """One parcel and the surface under it: numbers, and views into the state arrays.

    A task's and a sensor's functions take it. `truth` and `sensed` hold x, y, theta, vx, vy, omega
    at the indices X, Y, THETA, VX, VY, OMEGA.
    """

    com: Array  # (STATE_SIZE,) state of the centre of mass, its acceleration at AX and AY included
    truth: Array  # (6,) pose and velocity of the base's centroid; in `is_done` see `read_truth`
    sensed: Array  # (6,) the same as the sensor gives it
    clock: float  # [s] since the start
    period: float  # [s] since the last decision
    steps: int  # physics steps since the start
    on_rotors: bool  # a rotor supports the parcel
    on_surface: bool  # its centre of mass is over the surface
    surface: Array  # (6,) factors of friction [-], gravity along x, along y and normal [m/s^2]
    body: Array  # (7,) of the parcel: RADIUS ... MASS
    edges: Array  # (edges, 3) of its base: outward normals and distances [m] from the centroid
    corners: Array  # (edges, 2) [m] of its base from the centroid
    zone: Integers  # (4,) FIRST_ROW, ROWS, FIRST_COLUMN, COLUMNS that obey
    elements: Geometry  # where the elements lie
    axis: Places  # (rows, columns) index of each rotor's axis in `direction`
    direction: Array  # (directions, 2) cosine and sine of an axis
    rotor: Booleans  # (rows, columns) a rotor, else a support
    obeys: Booleans  # (rows, columns) a rotor in the zone, not stuck
    goal: Array  # (goals,) the task's own, as its starts give them
    path: Array  # (PATH_POINTS,) [m] y of a path to follow, evenly spaced in x
    memory: Array  # (memories,) the task's memory
    metrics: Array  # (metrics,) the task's own numbers in `info`: to write
    terms: Array  # (terms,) of the reward: to write
    observation: NDArray[np.float32]  # (features,) to write
    noise: Array  # (NOISE_ROWS, 4) drawn ahead for the sensor
    noise_row: Integers  # (1,) the next to use
    sensor_state: Array  # (sensor state,) the sensor's memory


@inlined
def env_state(
    surfaces: SurfaceState,
    parcels: ParcelState,
    bodies: BodyTable,
    surface: int,
    row: int,
    elements: Geometry,
) -> EnvState:
    """View the parcel in a row of `parcels` on the surface in a row of `surfaces`."""
    body = parcels.body[row]
    layout = body if bodies.rotor.shape[0] > 1 else 0
    return EnvState(
        parcels.state[row],
        parcels.truth[row],
        parcels.sensed[row],
        parcels.clock[row],
        parcels.period[row],
        parcels.steps[row],
        parcels.on_rotors[row],
        parcels.on_surface[row],
        surfaces.conditions[surface],
        bodies.body[body],
        bodies.edges[body],
        bodies.corners[body],
        bodies.zone[layout],
        elements,
        surfaces.axis[surface],
        surfaces.direction[surface if surfaces.direction.shape[0] > 1 else 0],
        bodies.rotor[layout],
        bodies.obeys[layout],
        parcels.goal[row],
        parcels.path[row],
        parcels.memory[row],
        parcels.metrics[row],
        parcels.terms[row],
        parcels.observation[row],
        parcels.noise[row],
        parcels.noise_row[row],
        parcels.sensor_state[row],
    )


@inlined
def read_truth(state: EnvState) -> None:
    """Bring `state.truth` up to date with `state.com`.

    It is up to date in `begin`, `outcome`, `reward` and `observe`. `is_done` is called after every
    physics step, where few tasks need it.
    """
    com = state.com
    truth = state.truth
    cosine = math.cos(com[ph.THETA])
    sine = math.sin(com[ph.THETA])
    arm_x = cosine * state.body[ph.COM_X] - sine * state.body[ph.COM_Y]
    arm_y = sine * state.body[ph.COM_X] + cosine * state.body[ph.COM_Y]
    truth[ph.X] = com[ph.X] - arm_x
    truth[ph.Y] = com[ph.Y] - arm_y
    truth[ph.THETA] = com[ph.THETA]
    truth[ph.VX] = com[ph.VX] + com[ph.OMEGA] * arm_y
    truth[ph.VY] = com[ph.VY] - com[ph.OMEGA] * arm_x
    truth[ph.OMEGA] = com[ph.OMEGA]


@inlined
def reach_along(state: EnvState, theta: float, nx: float, ny: float) -> float:
    """Return how far [m] the base, turned by theta, reaches from its centroid along (nx, ny).

    A base without corners, a disc, has them all at its centroid and reaches its radius.
    """
    cosine = math.cos(theta)
    sine = math.sin(theta)
    along_x = cosine * nx + sine * ny
    along_y = cosine * ny - sine * nx
    corners = state.corners
    farthest = -1.0
    for k in range(corners.shape[0]):
        farthest = max(farthest, corners[k, 0] * along_x + corners[k, 1] * along_y)
    return farthest if farthest > 0.0 else state.body[ph.RADIUS]


@inlined
def zone_start(state: EnvState) -> float:
    """Return x [m] half a pitch before the centres of the zone's first column."""
    return state.elements.x0 + state.elements.pitch_x * (state.zone[FIRST_COLUMN] - 0.5)


@inlined
def zone_end(state: EnvState) -> float:
    """Return x [m] half a pitch past the centres of the zone's last column."""
    after = state.zone[FIRST_COLUMN] + state.zone[COLUMNS]
    return state.elements.x0 + state.elements.pitch_x * (after - 0.5)


@inlined
def planar_speed(motion: Array) -> float:
    """Return the speed [m/s] of `state.truth` or `state.sensed`."""
    return math.sqrt(motion[ph.VX] * motion[ph.VX] + motion[ph.VY] * motion[ph.VY])


@inlined
def is_slower(state: EnvState, speed: float) -> bool:
    """Return whether every point of the parcel moves slower than a speed [m/s]."""
    truth = state.truth
    return planar_speed(truth) + abs(truth[ph.OMEGA]) * state.body[ph.HALF_LENGTH] < speed


ALL = slice(None)


def axis_angles(surfaces: SurfaceState, which: slice = ALL) -> Array:
    """Return the axis angles (surfaces, rows, columns) [rad] of some surfaces."""
    axis = surfaces.axis[which]
    direction = surfaces.direction if len(surfaces.direction) == 1 else surfaces.direction[which]
    angles = np.arctan2(direction[:, :, 1], direction[:, :, 0])
    if len(surfaces.direction) == 1:
        return np.asarray(angles[0, axis])
    places = axis.reshape(len(angles), -1)
    return np.take_along_axis(angles, places, axis=1).reshape(axis.shape)
