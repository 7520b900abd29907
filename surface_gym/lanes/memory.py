"""The memory of a batch: one row a lane, each lane one parcel on one surface."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.dynamics.types import STATE_SIZE, Array, Scratch

Integers = NDArray[np.int64]

# Columns of `Lanes.surface`.
MU_MAX, MU_MIN, MU_SUPPORT, GRAVITY_ALONG, GRAVITY_NORMAL = range(5)
# Columns of `Lanes.body`.
RADIUS, COM_X, COM_Y, COM_HEIGHT, GYRATION, HALF_LENGTH = range(6)
# Columns of `Lanes.zone`.
FIRST_ROW, ROWS, FIRST_COLUMN, COLUMNS = range(4)

# `Lanes.outcome`: how an episode stands. Failures come after SUCCESS; the time limit is none, and
# belongs to the vector env.
OUTCOMES = (
    "running",
    "out of time",
    "success",
    "wrong side",
    "stalled",
    "passed the zone",
    "off the surface",
)
RUNNING, OUT_OF_TIME, SUCCESS, WRONG_SIDE, STALLED, PASSED, OFF_SURFACE = range(len(OUTCOMES))

GOALS = 4  # columns of `Lanes.goal` and `Lanes.memory`; a task says what each holds
MEMORIES = 4


class Lanes(NamedTuple):
    """State, settings and results of every lane. A task names its goal, memory and terms."""

    state: Array  # (lanes, STATE_SIZE) of the centre of mass
    truth: Array  # (lanes, 6) pose and velocity of the base's centroid
    sensed: Array  # (lanes, 6) what the sensors say of it
    clock: Array  # (lanes,) [s] since the start
    axis: Array  # (lanes, rows, columns, 2) cosine and sine of each rotor axis
    rotor: NDArray[np.bool_]  # (lanes, rows, columns)
    stiffness: Array  # (lanes, rows, columns) [-]
    surface: Array  # (lanes, 5) friction coefficients [-], gravity along and normal [m/s^2]
    body: Array  # (lanes, 6) [m] radius, centre of mass x, y, height; gyration [m^2]; half length
    edges: Array  # (lanes, edges, 3) of the base, padded with edges that never bound
    corners: Array  # (lanes, edges, 2) [m] of the base from its centroid, padded with repeats
    zone: Integers  # (lanes, 4) first row, rows, first column, columns that obey
    goal: Array  # (lanes, GOALS)
    memory: Array  # (lanes, MEMORIES)
    command: Integers  # (lanes, action size) what the action says, one number a choice
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


def make_lanes(
    lanes: int, rows: int, columns: int, edges: int, actions: int, observations: int, terms: int
) -> Lanes:
    """Memory for a batch, nothing placed on it yet."""
    return Lanes(
        state=np.zeros((lanes, STATE_SIZE)),
        truth=np.zeros((lanes, 6)),
        sensed=np.zeros((lanes, 6)),
        clock=np.zeros(lanes),
        axis=np.zeros((lanes, rows, columns, 2)),
        rotor=np.zeros((lanes, rows, columns), dtype=np.bool_),
        stiffness=np.ones((lanes, rows, columns)),
        surface=np.zeros((lanes, 5)),
        body=np.zeros((lanes, 6)),
        edges=np.zeros((lanes, edges, 3)),
        corners=np.zeros((lanes, edges, 2)),
        zone=np.zeros((lanes, 4), dtype=np.int64),
        goal=np.zeros((lanes, GOALS)),
        memory=np.zeros((lanes, MEMORIES)),
        command=np.zeros((lanes, actions), dtype=np.int64),
        observation=np.zeros((lanes, observations), dtype=np.float32),
        terms=np.zeros((lanes, terms)),
        outcome=np.zeros(lanes, dtype=np.int64),
    )


def make_batch_scratch(threads: int, contacts: int, edges: int) -> Scratch:
    """Scratch of every thread in one; the first axis of each array is the thread."""
    return Scratch(
        arm_x=np.zeros((threads, contacts)),
        arm_y=np.zeros((threads, contacts)),
        axis_x=np.zeros((threads, contacts)),
        axis_y=np.zeros((threads, contacts)),
        rotor=np.zeros((threads, contacts), dtype=np.bool_),
        stiffness=np.zeros((threads, contacts)),
        normal=np.zeros((threads, contacts)),
        edges=np.zeros((threads, edges, 3)),
        slide=np.zeros((threads, contacts, 4)),
    )
