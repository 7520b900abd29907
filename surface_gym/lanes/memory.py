"""The memory of a batch: what belongs to a surface, and what to a parcel on it.

A lane is one surface. Where it carries one parcel, as in every task but a stream's, row i of both
is lane i's.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.dynamics.types import STATE_SIZE, Array, Booleans, Integers, Places

# Columns of `Surfaces.conditions`.
ALONG_FACTOR, ACROSS_FACTOR, SUPPORT_FACTOR, GRAVITY_ALONG, GRAVITY_NORMAL = range(5)
# Columns of `Sites.zone`.
FIRST_ROW, ROWS, FIRST_COLUMN, COLUMNS = range(4)

# `Lanes.outcome`: how an episode stands. A task's failures follow, in its order; running out of
# time is none, and belongs to the vector env. A lane that was placed has yet to begin.
PLACED, RUNNING, OUT_OF_TIME, SUCCESS, FIRST_FAILURE = range(-1, 4)
COMMON_OUTCOMES = ("running", "out of time", "success")

# `Lanes.fault`: what a task's functions did wrong.
SOUND, UNKNOWN_OUTCOME, BAD_REWARD, BAD_OBSERVATION = range(4)

PATH_POINTS = 256  # of a path, evenly spaced in x
NOISE_ROWS = 64  # draws made ahead; each three standard normals and one uniform in [0, 1)


class Surfaces(NamedTuple):
    """What belongs to a surface, whoever is on it. What is the same for all has one row."""

    axis: Places  # (surfaces, rows, columns) the place of each rotor's axis among the directions
    direction: Array  # (surfaces or 1, directions, 2) cosine and sine of an axis
    angle: Array  # (surfaces, rows, columns) [rad] of each axis, where axes take time to turn
    target: Array  # (surfaces, rows, columns) [rad] it turns to
    stiffness: Array  # (surfaces or 1, rows, columns) [-]
    # (surfaces, 5) factors of friction [-], gravity along and normal [m/s^2]
    conditions: Array
    # (surfaces, command size) what the action says: choices, or angles [rad]
    command: NDArray[Any]


class Lanes(NamedTuple):
    """State and results of every parcel. What a task has no use for has no columns."""

    state: Array  # (lanes, STATE_SIZE) of the centre of mass
    truth: Array  # (lanes, 6) pose and velocity of the base's centroid
    sensed: Array  # (lanes, 6) what the sensor says of it
    clock: Array  # (lanes,) [s] since the start
    period: Array  # (lanes,) [s] since the last decision
    steps: Integers  # (lanes,) physics steps since the start
    on_rotors: Booleans  # (lanes,) a rotor bears the parcel
    on_surface: Booleans  # (lanes,) the parcel's centre of mass is over the surface
    site: Integers  # (lanes,) its parcel's place among the sites
    goal: Array  # (lanes, goals) the task's own, as its starts give them
    path: Array  # (lanes, PATH_POINTS or 0) [m] y of a path to follow, evenly spaced in x
    memory: Array  # (lanes, memories) what the task remembers
    figures: Array  # (lanes, figures) the task's own numbers in `info`
    noise: Array  # (lanes, NOISE_ROWS or 0, 4) drawn ahead for the sensor
    noise_row: Integers  # (lanes, 1) the next to use
    kept: Array  # (lanes, kept) what the sensor remembers
    observation: NDArray[np.float32]  # (lanes, observation size)
    terms: Array  # (lanes, reward terms)
    reward: Array  # (lanes,) their sum
    outcome: Integers  # (lanes,) its place among the common outcomes and the task's failures
    fault: Integers  # (lanes,)


class Sites(NamedTuple):
    """Parcels as they run on the plant. Lanes whose parcels are alike share one.

    What of the plant is the same for all parcels has one row.
    """

    rotor: Booleans  # (sites or 1, rows, columns)
    obeys: Booleans  # (sites or 1, rows, columns) a rotor in the zone, not stuck
    body: Array  # (sites, 7) as `Bodies.body`
    edges: Array  # (sites, edges, 3) as `Bodies.edges`
    corners: Array  # (sites, edges, 2) [m] as `Bodies.corners`
    zone: Integers  # (sites or 1, 4) first row, rows, first column, columns that obey


class Geometry(NamedTuple):
    """Where the elements lie; the same for every lane."""

    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch_x: float  # [m] from column to column
    pitch_y: float  # [m] from row to row
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
    command: int
    choices: int  # orientations on offer that a command counts; 0: it says angles
    observation: int
    terms: int
    goals: int
    memories: int
    figures: int
    kept: int
    path: bool
    noise: bool
    turning: bool  # axes take time to turn
    stiffness: bool  # it differs from lane to lane
    places: int = 1  # for parcels on each surface


def make_surfaces(sizes: Sizes) -> Surfaces:
    """Memory for the surfaces of a batch."""
    count, grid = sizes.lanes, (sizes.lanes, sizes.rows, sizes.columns)
    turning = grid if sizes.turning else (count, 1, 1)
    # Axes that are one of a few directions count them; those at any angle have one each.
    counted = sizes.choices > 0 and not sizes.turning
    each = np.arange(sizes.rows * sizes.columns, dtype=np.int32).reshape(grid[1:])
    directions = (1, sizes.choices + 1) if counted else (count, each.size)
    return Surfaces(
        axis=np.zeros(grid, dtype=np.int32) if counted else np.tile(each, (count, 1, 1)),
        direction=np.zeros((*directions, 2)),
        angle=np.zeros(turning),
        target=np.zeros(turning),
        stiffness=np.ones((count if sizes.stiffness else 1, *grid[1:])),
        conditions=np.zeros((count, 5)),
        command=np.zeros((count, sizes.command), dtype=np.int64 if sizes.choices else np.float64),
    )


def make_lanes(sizes: Sizes) -> Lanes:
    """Memory for the parcels of a batch, nothing placed on it yet."""
    lanes = sizes.lanes * sizes.places
    return Lanes(
        state=np.zeros((lanes, STATE_SIZE)),
        truth=np.zeros((lanes, 6)),
        sensed=np.zeros((lanes, 6)),
        clock=np.zeros(lanes),
        period=np.zeros(lanes),
        steps=np.zeros(lanes, dtype=np.int64),
        on_rotors=np.ones(lanes, dtype=np.bool_),
        on_surface=np.ones(lanes, dtype=np.bool_),
        site=np.zeros(lanes, dtype=np.int64),
        goal=np.zeros((lanes, sizes.goals)),
        path=np.zeros((lanes, PATH_POINTS if sizes.path else 0)),
        memory=np.zeros((lanes, sizes.memories)),
        figures=np.zeros((lanes, sizes.figures)),
        noise=np.zeros((lanes, NOISE_ROWS if sizes.noise else 0, 4)),
        noise_row=np.zeros((lanes, 1), dtype=np.int64),
        kept=np.zeros((lanes, sizes.kept)),
        observation=np.zeros((lanes, sizes.observation), dtype=np.float32),
        terms=np.zeros((lanes, sizes.terms)),
        reward=np.zeros(lanes),
        outcome=np.zeros(lanes, dtype=np.int64),
        fault=np.zeros(lanes, dtype=np.int64),
    )
