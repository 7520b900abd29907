"""Many runs over a line at once, shared among workers; results do not depend on their number."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym.design.line import DesignLine
from surface_gym.design.passage import (
    ENDS,
    EXIT,
    GROUND,
    LAYOUT,
    PARCEL,
    STEPS,
    Deck,
    Passages,
)
from surface_gym.design.sending import Advance, send_all
from surface_gym.parcel import Parcel
from surface_gym.physics.step import axis_directions, com_states, map_floats
from surface_gym.physics.types import GRAVITY, check_capacity
from surface_gym.sharing import Workers
from surface_gym.simulation import base_motion
from surface_gym.together import make_bodies

STEP = 0.005  # [s] of a run, where nothing else is said
LONGEST = 20.0  # [s] a run may take

Numbers = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs to carry out, a row each; made by `make_runs`."""

    speed: Numbers  # (runs,) [m/s] along x at the start
    tilt: Numbers  # (runs,) [rad]
    layout: Integers  # (runs,) which of the layouts
    ground: Integers  # (runs,) which of the stiffnesses
    parcel: Integers  # (runs,) which of the parcels
    friction: Numbers  # (runs, 3) [-] factors of mu_max, mu_min and mu_support
    aside: Numbers  # (runs,) [m] of the start in y
    turned: Numbers  # (runs,) [rad] of the start's theta
    columns: Integers  # (runs,) of the zone, whose end a run may pass; none: it has no end

    def __len__(self) -> int:
        return len(self.speed)


def make_runs(
    speed: ArrayLike,
    tilt: ArrayLike = 0.0,
    layout: ArrayLike = 0,
    ground: ArrayLike = 0,
    parcel: ArrayLike = 0,
    friction: ArrayLike = 1.0,
    aside: ArrayLike = 0.0,
    turned: ArrayLike = 0.0,
    columns: ArrayLike = -1,
) -> Runs:
    """Runs from one value for all, or arrays (runs,) of each; `friction` is (runs, 3) or one."""
    flat = np.broadcast_arrays(speed, tilt, layout, ground, parcel, aside, turned, columns)
    numbers = [np.array(values, dtype=np.float64).reshape(-1) for values in flat]
    whole = [values.astype(np.int64) for values in numbers]
    count = len(numbers[0])
    return Runs(
        speed=numbers[0],
        tilt=numbers[1],
        layout=whole[2],
        ground=whole[3],
        parcel=whole[4],
        friction=np.broadcast_to(np.asarray(friction, dtype=np.float64), (count, 3)),
        aside=numbers[5],
        turned=numbers[6],
        columns=whole[7],
    )


@dataclass(frozen=True, eq=False)
class Ends:
    """What came of runs, a row each."""

    how: Integers  # (runs,) place among `passage.ENDS`
    touched: Integers  # (runs,) columns from the first of the zone to the last that bore it
    time: Numbers  # (runs,) [s] until the end
    pose: Numbers  # (runs, 3) [m, m, rad] of the base's frame then
    velocity: Numbers  # (runs, 3) [m/s, m/s, rad/s]
    tipping: Numbers  # (runs,) [-] share of the steps in which a real parcel would tip
    steps: Integers  # (runs,) done

    def told(self, run: int) -> str:
        """How a run ended, in words."""
        return ENDS[self.how[run]]


def run_all(
    line: DesignLine,
    layouts: Numbers,
    parcels: Sequence[Parcel],
    runs: Runs,
    stiffness: Numbers | None = None,
    dt: float = STEP,
    workers: Workers = 1,
    advance: Advance = lambda *_: None,
) -> Ends:
    """Send parcels over a line, each with its rear at x = 0 at the start.

    Args:
        line: the line.
        layouts: (layouts, rows, columns) [rad] axes of the zone.
        parcels: that run.
        runs: which parcel runs over which layout, and how.
        stiffness: (grounds, rows, columns) [-] of the whole surface's elements; None: all alike.
        dt: [s] step.
        workers: threads that share the runs, or a cluster.
        advance: called with how many runs are done and how many there are.
    """
    deck = _deck(line, layouts, stiffness)
    for parcel in parcels:
        check_capacity(
            len(parcel.body.edges), parcel.body.radius, (line.pitch_x, line.pitch_y),
            line.shape[::-1],
        )  # fmt: skip
    bodies = make_bodies(parcels)
    passages = _passages(line, parcels, runs, dt)
    send_all(deck, bodies, passages, dt, workers, advance)
    return _ends(line, parcels, runs, passages, dt)


def _deck(line: DesignLine, layouts: Numbers, stiffness: Numbers | None) -> Deck:
    axes = line.axes(np.asarray(layouts, dtype=np.float64))
    angles, places = np.unique(axes, return_inverse=True)
    each_mu = (line.mu_max, line.mu_min, line.mu_support)
    return Deck(
        axis=places.reshape(axes.shape).astype(np.int32),
        direction=axis_directions(angles),
        rotor=line.rotor.copy(),
        stiffness=np.ones((1, *line.shape)) if stiffness is None else stiffness.astype(float),
        friction=np.broadcast_to(np.array(each_mu), (*line.shape, 3)).copy(),
        x0=0.5 * line.pitch_x,
        y0=0.5 * line.pitch_y,
        pitch_x=line.pitch_x,
        pitch_y=line.pitch_y,
    )


def _passages(line: DesignLine, parcels: Sequence[Parcel], runs: Runs, dt: float) -> Passages:
    count = len(runs)
    number = np.zeros((count, 5), dtype=np.int64)
    number[:, LAYOUT] = runs.layout
    number[:, GROUND] = runs.ground
    number[:, PARCEL] = runs.parcel
    number[:, EXIT] = np.where(runs.columns < 0, line.shape[1], line.lead_in + runs.columns)
    number[:, STEPS] = round(LONGEST / dt)
    gravity = [GRAVITY * map_floats(function, runs.tilt) for function in (math.sin, math.cos)]
    starts = np.array([line.start(parcel) for parcel in parcels])[runs.parcel]
    starts[:, 1] += runs.aside
    starts[:, 2] += runs.turned
    centres = np.array([parcel.centre_of_mass for parcel in parcels])[runs.parcel]
    velocity = np.zeros((count, 3))
    velocity[:, 0] = runs.speed
    return Passages(
        number=number,
        condition=np.column_stack([runs.friction, *gravity]),
        state=com_states(centres, starts, velocity),
        end=np.zeros((count, 4), dtype=np.int64),
    )


def _ends(
    line: DesignLine, parcels: Sequence[Parcel], runs: Runs, passages: Passages, dt: float
) -> Ends:
    pose, velocity = passages.state[:, :3].copy(), passages.state[:, 3:6].copy()
    for k, parcel in enumerate(parcels):
        if parcel.centre_of_mass != (0.0, 0.0):
            own = runs.parcel == k
            pose[own], velocity[own] = base_motion(parcel, passages.state[own])
    how, touched, steps, tipped = passages.end.T
    return Ends(
        how=how,
        touched=np.maximum(0, touched - line.lead_in + 1),
        time=dt * steps,
        pose=pose,
        velocity=velocity,
        tipping=tipped / np.maximum(1, steps),
        steps=steps,
    )
