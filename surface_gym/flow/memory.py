"""The memory of a batch of flows: what is to come, who is on each surface, what became of whom.

Parcels lie in the rows of `Lanes`, as those of any batch do: surface i has the rows from i times
the places on a surface on, of which `Flows.number` says who has which.
"""

from typing import NamedTuple

import numpy as np

from surface_gym.physics.collision import ContactMaterial
from surface_gym.physics.types import STATE_SIZE, Array, Booleans, Integers, Places

NOBODY = -1  # `Flows.number` of a place that is free, `Flows.owner` of a module that obeys nobody
# `Flows.taken` of a parcel that has not left; below it, places among the exits
ON_ITS_WAY, BETWEEN = -2, -1

# A surface's outcomes, beside those every lane has; a flow has no success.
JAM = 3
OUTCOMES = ("running", "out of time", "success", "jam")
# A parcel's outcomes: what `Lanes.outcome` says of it.
LEFT_RIGHT, LEFT_WRONG = 2, 3

# Columns of `Flows.tally`.
ENTERED, RIGHT, WRONG, TOUCHES, TURNS = range(5)
# Places in a parcel's goal.
EXIT, SIDE, FIRST, LAST = range(4)
# Places in its memory: [m] lateral reach at the last decision, touches begun since.
REACH, TOUCHED, MEMORIES = range(3)
GOALS = 4
NEVER = -1_000_000  # `Flows.touched_at` of two that have not touched


class Flows(NamedTuple):
    """What a flow has beside its surface and its parcels."""

    time: Array  # (surfaces, arrivals) [s] at which each comes
    start: Array  # (surfaces, arrivals, STATE_SIZE) of its centre of mass as it enters
    site: Integers  # (surfaces, arrivals) its place among the sites
    exit: Integers  # (surfaces, arrivals) that it is to leave by
    arrivals: Integers  # (surfaces,) how many there are
    coming: Integers  # (surfaces,) the next to enter
    due: Integers  # (surfaces,) the next whose time has not come: those between the two wait
    entered: Array  # (surfaces, arrivals) [s] when it did; nan before
    left: Array  # (surfaces, arrivals) [s] when no rotor bore it any more; nan before
    taken: Integers  # (surfaces, arrivals) the exit it left by, BETWEEN them, or ON_ITS_WAY
    touches: Integers  # (surfaces, arrivals) how often it began to touch another
    # (surfaces, rows) which arrival has each place, or NOBODY; with a gate, the last row is that of
    # the parcel that waits to enter
    number: Integers
    present: Booleans  # (surfaces, rows) whether anybody is there and has not left
    touched_at: Integers  # (surfaces, rows, rows) physics step in which two touched last
    clock: Array  # (surfaces,) [s]
    steps: Integers  # (surfaces,) physics steps since the start
    still: Array  # (surfaces,) [s] for which nothing has moved
    waited: Array  # (surfaces,) [s] that parcels have waited to enter, all together
    owner: Places  # (surfaces, rows, columns) the place whose parcel a module obeys, or NOBODY
    soonest: Array  # (surfaces, rows, columns) [s] when that parcel will bear on it
    told: Array  # (surfaces, rows, columns) [rad] axis angle that a module was told last
    obeys: Booleans  # (surfaces or 1, rows, columns) a rotor in the zone, not stuck
    tally: Integers  # (surfaces, 5) ENTERED ... TURNS so far
    terms: Array  # (surfaces, terms) of the reward
    reward: Array  # (surfaces,) their sum
    outcome: Integers  # (surfaces,)
    fault: Integers  # (surfaces,)


class FlowRules(NamedTuple):
    """What holds for every flow of a batch, beside the rules of its surfaces."""

    exits: Array  # (exits, 3) side, first and last x [m]
    entry_gap: float  # [m] clear ahead of one that enters
    rotors_end: float  # [m] x half a pitch past the last column with a rotor
    ahead: float  # [s] in which a parcel must be about to bear on a module for it to obey
    duration: float  # [s] of an episode
    patience: float  # [s] without any motion that make a jam
    gated: bool  # whether actions say who may enter
    sides: ContactMaterial  # how parcels' sides behave where they touch


def make_flows(
    surfaces: int, rows: int, shape: tuple[int, int], terms: int, obeys: Booleans
) -> Flows:
    """Memory for flows to come, room for one arrival each.

    Args:
        surfaces: their number.
        rows: for parcels on each.
        shape: (rows, columns) of each.
        terms: of the reward.
        obeys: (surfaces or 1, rows, columns) which modules do.
    """
    grid = (surfaces, *shape)
    return Flows(
        **_arrivals(surfaces, 1),
        arrivals=np.zeros(surfaces, dtype=np.int64),
        coming=np.zeros(surfaces, dtype=np.int64),
        due=np.zeros(surfaces, dtype=np.int64),
        number=np.full((surfaces, rows), NOBODY),
        present=np.zeros((surfaces, rows), dtype=np.bool_),
        touched_at=np.full((surfaces, rows, rows), NEVER),
        clock=np.zeros(surfaces),
        steps=np.zeros(surfaces, dtype=np.int64),
        still=np.zeros(surfaces),
        waited=np.zeros(surfaces),
        owner=np.full(grid, NOBODY, dtype=np.int32),
        soonest=np.zeros(grid),
        told=np.zeros(grid),
        obeys=obeys,
        tally=np.zeros((surfaces, 5), dtype=np.int64),
        terms=np.zeros((surfaces, terms)),
        reward=np.zeros(surfaces),
        outcome=np.zeros(surfaces, dtype=np.int64),
        fault=np.zeros(surfaces, dtype=np.int64),
    )


def with_room(flows: Flows, arrivals: int) -> Flows:
    """The same with room for at least as many arrivals, what was there kept."""
    surfaces, room = flows.time.shape
    if arrivals <= room:
        return flows
    made = _arrivals(surfaces, max(arrivals, 2 * room))
    for name, values in made.items():
        values[:, :room] = getattr(flows, name)
    return flows._replace(**made)


def _arrivals(surfaces: int, room: int) -> dict[str, np.ndarray]:
    """The arrays that have a column an arrival."""
    shape = (surfaces, room)
    return {
        "time": np.zeros(shape),
        "start": np.zeros((*shape, STATE_SIZE)),
        "site": np.zeros(shape, dtype=np.int64),
        "exit": np.zeros(shape, dtype=np.int64),
        "entered": np.full(shape, np.nan),
        "left": np.full(shape, np.nan),
        "taken": np.full(shape, ON_ITS_WAY),
        "touches": np.zeros(shape, dtype=np.int64),
    }
