"""The state arrays of all environments, and the view of one environment.

An environment has one surface. Except in streams, it also has one parcel, and row i of the arrays
of surfaces and of parcels belongs to environment i.
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
# Columns of `SurfaceState.drive`.
ALONG, ACROSS, DRIVEN = range(3)
# Last axis of `SurfaceState.load`.
NOW, PEAK_LOAD = range(2)
# Columns of `ParcelState.energy`, and their names in `info`.
WORK, HEAT, DRAWN, PEAK = range(4)
ENERGIES = ("drive_work", "friction_heat", "drawn_energy", "peak_acceleration")
# Columns of `BodyTable.zone`.
FIRST_ROW, ROWS, FIRST_COLUMN, COLUMNS = range(4)

# `ParcelState.outcome`: the state of an episode. The task's failures follow in order. The time
# limit truncates an episode and is not an outcome. An environment in STARTING has been placed.
STARTING, RUNNING, OUT_OF_TIME, SUCCESS, FIRST_FAILURE = range(-1, 4)
COMMON_OUTCOMES = ("running", "out of time", "success")

# `ParcelState.fault`: the error of a task's functions.
NO_FAULT, UNKNOWN_OUTCOME, BAD_REWARD, BAD_OBSERVATION = range(4)

PATH_POINTS = 256  # points of a path, evenly spaced in x
# rows of noise drawn ahead: three standard normals and one uniform number in [0, 1)
NOISE_ROWS = 64


class SurfaceState(NamedTuple):
    """State of all surfaces. An array has a row per surface, or one row that all surfaces share."""

    axis: Places  # (surfaces, rows, columns) index of each rotor's axis among the directions
    direction: Array  # (surfaces or 1, directions, 2) cosine and sine of an axis
    # (surfaces or 1, directions + 1, 3) velocity [m/s] of a module's surface along its axis and
    # across it, and 1 for driven modules; the last row: 1 if any module may be driven
    drive: Array
    angle: Array  # (surfaces, rows, columns) [rad] angle of each axis, if axes take time to turn
    # (surfaces, rows, columns) [rad] target angle of each axis; with drives, the chosen mode
    target: Array
    stiffness: Array  # (surfaces or 1, rows, columns) [-]
    # (surfaces, 6) factors of friction [-], gravity along x, along y and normal [m/s^2]
    conditions: Array
    # (surfaces, command size) the action: choices, or angles [rad]
    command: NDArray[Any]
    # (surfaces or 1, rows, columns, 2) [N] force on each element before the last physics step, and
    # the largest on each rotor since the start, if loads are asked for
    load: Array


class ParcelState(NamedTuple):
    """State and results of all parcels. Each array has one row per parcel.

    Each environment has P rows, and the rows of environment i start at row i * P. Without a stream,
    P is 1. Arrays that a task does not use have no columns.
    """

    state: Array  # (rows, STATE_SIZE) of the centre of mass
    truth: Array  # (rows, 6) pose and velocity of the base's centroid
    sensed: Array  # (rows, 6) pose and velocity reported by the sensor
    clock: Array  # (rows,) [s] since the start
    period: Array  # (rows,) [s] since the last decision
    steps: Integers  # (rows,) physics steps since the start
    on_rotors: Booleans  # (rows,) whether a rotor supports the parcel
    on_surface: Booleans  # (rows,) whether the centre of mass is over the surface
    body: Integers  # (rows,) row of the parcel in the body table
    goal: Array  # (rows, goals) goal of the task, from its starts
    path: Array  # (rows, PATH_POINTS or 0) [m] y of the path to follow, evenly spaced in x
    memory: Array  # (rows, memories) memory of the task
    metrics: Array  # (rows, metrics) metrics of the task in `info`
    noise: Array  # (rows, NOISE_ROWS or 0, 4) noise drawn ahead for the sensor
    noise_row: Integers  # (rows, 1) next row of noise to use
    sensor_state: Array  # (rows, sensor state) the sensor's memory
    observation: NDArray[np.float32]  # (rows, observation size)
    terms: Array  # (rows, reward terms)
    reward: Array  # (rows,) sum of the terms
    outcome: Integers  # (rows,) index into the common outcomes and the task's failures
    fault: Integers  # (rows,)
    # (rows, 4 or 0), if asked for: [J] work of drives, heat of friction, and energy drawn by drives
    # that give nothing back; [m/s^2] largest acceleration
    energy: Array


class BodyTable(NamedTuple):
    """Parameters of parcels. A row describes a parcel, the rotors and the zone on its surface.

    Equal parcels share a row. An array has only one row if the row is the same for all parcels.
    """

    rotor: Booleans  # (bodies or 1, rows, columns)
    obeys: Booleans  # (bodies or 1, rows, columns) whether a rotor is in the zone and not stuck
    body: Array  # (bodies, 7) as `Bodies.body`
    edges: Array  # (bodies, edges, 3) as `Bodies.edges`
    corners: Array  # (bodies, edges, 2) [m] as `Bodies.corners`
    zone: Integers  # (bodies or 1, 4) first row, rows, first column, columns of the zone


class Geometry(NamedTuple):
    """Positions of the elements, common to all environments."""

    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch_x: float  # [m] from column to column
    pitch_y: float  # [m] from row to row
    line_y: float  # [m] middle of the line


class Timing(NamedTuple):
    """Length and number of the physics steps in a control period."""

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
    """Return row `surface` of the surfaces as a `Grid` for the physics.

    Row `body` of `bodies` says where rotors are. `friction` (rows, columns, 3) is as in `Grid`.
    """
    conditions = surfaces.conditions[surface]
    return Grid(
        surfaces.axis[surface],
        surfaces.direction[surface if surfaces.direction.shape[0] > 1 else 0],
        surfaces.drive[surface if surfaces.drive.shape[0] > 1 else 0],
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
    """Return a row of the body table as a `Body`."""
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

    Tasks' and sensors' functions have an EnvState as an argument. `truth` and `sensed` hold x, y,
    theta, vx, vy, omega at the indices X, Y, THETA, VX, VY, OMEGA.
    """

    com: Array  # (STATE_SIZE,) state of the centre of mass, with acceleration at AX and AY
    truth: Array  # (6,) pose and velocity of the base's centroid; in `is_done` see `read_truth`
    sensed: Array  # (6,) pose and velocity reported by the sensor
    clock: float  # [s] since the start; of a stream, since the parcel entered
    period: float  # [s] since the last decision
    steps: int  # physics steps since the start
    on_rotors: bool  # whether a rotor supports the parcel
    on_surface: bool  # whether its centre of mass is over the surface
    surface: Array  # (6,) factors of friction [-], gravity along x, along y and normal [m/s^2]
    body: Array  # (7,) parcel: RADIUS ... MASS
    edges: Array  # (edges, 3) of its base: outward normals and distances [m] from the centroid
    corners: Array  # (edges, 2) [m] of its base from the centroid
    zone: Integers  # (4,) FIRST_ROW, ROWS, FIRST_COLUMN, COLUMNS that obey
    elements: Geometry  # positions of the elements
    axis: Places  # (rows, columns) index of each rotor's axis in `direction`
    direction: Array  # (directions, 2) cosine and sine of an axis
    drive: Array  # (directions, 3) drive of a module, as in `SurfaceState`
    rotor: Booleans  # (rows, columns) a rotor, else a support
    obeys: Booleans  # (rows, columns) whether a rotor is in the zone and not stuck
    goal: Array  # (goals,) goal of the task, from its starts
    path: Array  # (PATH_POINTS,) [m] y of the path to follow, evenly spaced in x
    memory: Array  # (memories,) the task's memory
    metrics: Array  # (metrics,) metrics of the task in `info`, to write
    terms: Array  # (terms,) terms of the reward, to write
    observation: NDArray[np.float32]  # (features,) to write
    noise: Array  # (NOISE_ROWS, 4) noise drawn ahead for the sensor
    noise_row: Integers  # (1,) next row of noise to use
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
    """Return the view of a parcel (row of `parcels`) on a surface (row of `surfaces`)."""
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
        surfaces.drive[surface if surfaces.drive.shape[0] > 1 else 0],
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
    """Update `state.truth` from `state.com`, the state of the centre of mass.

    In `begin`, `outcome`, `reward` and `observe`, `state.truth` is up to date without this call. In
    `is_done`, the truth is out of date, since few tasks need the truth after every physics step.
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
    """Return the distance [m] from the centroid to the farthest point of a base in a direction.

    The direction is the unit vector (nx, ny). The base is at the angle `theta` [rad].
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
    """Return the speed [m/s] of `motion`, which is `state.truth` or `state.sensed`."""
    return math.sqrt(motion[ph.VX] * motion[ph.VX] + motion[ph.VY] * motion[ph.VY])


@inlined
def is_driven(state: EnvState) -> bool:
    """Return whether modules are driven. Driven modules may move a parcel that is at rest."""
    return bool(state.drive[state.drive.shape[0] - 1, DRIVEN] > 0.0)


@inlined
def is_slower(state: EnvState, speed: float) -> bool:
    """Return whether every point of the parcel moves slower than a speed [m/s]."""
    truth = state.truth
    return planar_speed(truth) + abs(truth[ph.OMEGA]) * state.body[ph.HALF_LENGTH] < speed


ALL = slice(None)


def axis_angles(surfaces: SurfaceState, which: slice = ALL) -> Array:
    """Return the axis angles (surfaces, rows, columns) [rad] of a slice of the surfaces."""
    axis = surfaces.axis[which]
    direction = surfaces.direction if len(surfaces.direction) == 1 else surfaces.direction[which]
    angles = np.arctan2(direction[:, :, 1], direction[:, :, 0])
    if len(surfaces.direction) == 1:
        return np.asarray(angles[0, axis])
    places = axis.reshape(len(angles), -1)
    return np.take_along_axis(angles, places, axis=1).reshape(axis.shape)
