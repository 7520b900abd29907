"""The memory of a batch: one row a lane, each lane one parcel on one surface."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.dynamics.types import STATE_SIZE, Array, Scratch

Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

# Columns of `Lanes.surface`.
MU_MAX, MU_MIN, MU_SUPPORT, GRAVITY_ALONG, GRAVITY_NORMAL = range(5)
# Columns of `Lanes.body`.
RADIUS, COM_X, COM_Y, COM_HEIGHT, GYRATION, HALF_LENGTH = range(6)
# Columns of `Lanes.zone`.
FIRST_ROW, ROWS, FIRST_COLUMN, COLUMNS = range(4)

# `Lanes.outcome`: how an episode stands. Failures come after SUCCESS; running out of time is none,
# and belongs to the vector env.
OUTCOMES = (
    "running",
    "out of time",
    "success",
    "wrong side",
    "stalled",
    "passed the zone",
    "off the surface",
    "off the line",
    "missed",
    "off the path",
    "passed the asked x",
)
(
    RUNNING,
    OUT_OF_TIME,
    SUCCESS,
    WRONG_SIDE,
    STALLED,
    PASSED,
    OFF_SURFACE,
    OFF_LINE,
    MISSED,
    OFF_PATH,
    OVERSHOT,
) = range(len(OUTCOMES))

GOALS = 8  # columns of `Lanes.goal` and `Lanes.memory`; a task says what each holds
MEMORIES = 8
FIGURES = 4  # first column of `Lanes.memory` that holds the task's figures, in their order
PATH_POINTS = 256  # of a path, evenly spaced in x
FILTER_SIZE = 64  # numbers a sensor may keep
FRAMES = 16  # that can be under way from a sensor at a time
NOISE_ROWS = 64  # draws made ahead; each three standard normals and one uniform in [0, 1)


class Lanes(NamedTuple):
    """State, settings and results of every lane. A task names its goal, memory and terms."""

    state: Array  # (lanes, STATE_SIZE) of the centre of mass
    truth: Array  # (lanes, 6) pose and velocity of the base's centroid
    sensed: Array  # (lanes, 6) what the sensors say of it
    clock: Array  # (lanes,) [s] since the start
    steps: Integers  # (lanes,) physics steps since the start
    axis: Array  # (lanes, rows, columns, 2) cosine and sine of each rotor axis
    angle: Array  # (lanes, rows, columns) [rad] of each axis, where axes take time to turn
    target: Array  # (lanes, rows, columns) [rad] it turns to
    rotor: Booleans  # (lanes, rows, columns)
    obeys: Booleans  # (lanes, rows, columns) a rotor in the zone, not stuck
    stiffness: Array  # (lanes, rows, columns) [-]
    surface: Array  # (lanes, 5) friction coefficients [-], gravity along and normal [m/s^2]
    body: Array  # (lanes, 6) [m] radius, centre of mass x, y, height; gyration [m^2]; half length
    edges: Array  # (lanes, edges, 3) of the base, padded with edges that never bound
    corners: Array  # (lanes, edges, 2) [m] of the base from its centroid, padded with repeats
    zone: Integers  # (lanes, 4) first row, rows, first column, columns that obey
    goal: Array  # (lanes, GOALS)
    path: Array  # (lanes, PATH_POINTS) [m] y of a path to follow, evenly spaced in x
    memory: Array  # (lanes, MEMORIES)
    noise: Array  # (lanes, NOISE_ROWS, 4) drawn ahead for the sensors
    noise_row: Integers  # (lanes,) the next to use
    filter: Array  # (lanes, FILTER_SIZE) the sensors' memory
    frames: Array  # (lanes, FRAMES, 4) under way from the sensors
    command: Integers  # (lanes, command size) what the action says, one number a choice
    observation: NDArray[np.float32]  # (lanes, observation size)
    terms: Array  # (lanes, reward terms)
    outcome: Integers  # (lanes,) its place in OUTCOMES


class Geometry(NamedTuple):
    """Where the elements lie; the same for every lane."""

    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch: float  # [m]
    line_y: float  # [m] middle of the line


class Timing(NamedTuple):
    """How a control period is cut into steps."""

    dt: float  # [s] physics step
    steps: int  # of a control period


class Sizes(NamedTuple):
    """Lengths of a batch's arrays."""

    lanes: int
    rows: int
    columns: int
    edges: int  # of the base with the most
    command: int
    observation: int
    terms: int
    turning: bool  # axes take time to turn


def make_lanes(sizes: Sizes) -> Lanes:
    """Memory for a batch, nothing placed on it yet."""
    lanes, grid = sizes.lanes, (sizes.lanes, sizes.rows, sizes.columns)
    turning = grid if sizes.turning else (lanes, 1, 1)
    return Lanes(
        state=np.zeros((lanes, STATE_SIZE)),
        truth=np.zeros((lanes, 6)),
        sensed=np.zeros((lanes, 6)),
        clock=np.zeros(lanes),
        steps=np.zeros(lanes, dtype=np.int64),
        axis=np.zeros((*grid, 2)),
        angle=np.zeros(turning),
        target=np.zeros(turning),
        rotor=np.zeros(grid, dtype=np.bool_),
        obeys=np.zeros(grid, dtype=np.bool_),
        stiffness=np.ones(grid),
        surface=np.zeros((lanes, 5)),
        body=np.zeros((lanes, 6)),
        edges=np.zeros((lanes, sizes.edges, 3)),
        corners=np.zeros((lanes, sizes.edges, 2)),
        zone=np.zeros((lanes, 4), dtype=np.int64),
        goal=np.zeros((lanes, GOALS)),
        path=np.zeros((lanes, PATH_POINTS)),
        memory=np.zeros((lanes, MEMORIES)),
        noise=np.zeros((lanes, NOISE_ROWS, 4)),
        noise_row=np.zeros(lanes, dtype=np.int64),
        filter=np.zeros((lanes, FILTER_SIZE)),
        frames=np.zeros((lanes, FRAMES, 4)),
        command=np.zeros((lanes, sizes.command), dtype=np.int64),
        observation=np.zeros((lanes, sizes.observation), dtype=np.float32),
        terms=np.zeros((lanes, sizes.terms)),
        outcome=np.zeros(lanes, dtype=np.int64),
    )


def make_batch_scratch(threads: int, contacts: int, edges: int) -> Scratch:
    """Scratch of every thread in one; the first axis of each array is the thread.

    Each thread's part is longer than it needs by a cache line, so that none shares one.
    """
    line = 64  # [bytes], at most 64 numbers of any kind
    return Scratch(
        arm_x=np.zeros((threads, contacts + line)),
        arm_y=np.zeros((threads, contacts + line)),
        axis_x=np.zeros((threads, contacts + line)),
        axis_y=np.zeros((threads, contacts + line)),
        rotor=np.zeros((threads, contacts + line), dtype=np.bool_),
        stiffness=np.zeros((threads, contacts + line)),
        normal=np.zeros((threads, contacts + line)),
        edges=np.zeros((threads, edges + line, 3)),
        slide=np.zeros((threads, contacts + line, 4)),
    )
