"""The state arrays of streams, and the statistics of an episode.

Parcels lie in rows of `ParcelState`, as those of any batch do: with R rows a surface, surface i has
those from i R on, and `StreamState.number` says which arrival has which row.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from surface_gym.compiler.jit import inlined
from surface_gym.core.kernel import EnvParams
from surface_gym.flow.arrivals import HOUR
from surface_gym.physics.collision import ContactMaterial
from surface_gym.physics.types import STATE_SIZE, Array, Booleans, Integers, Places
from surface_gym.state import BodyTable, EnvState, ParcelState, SurfaceState, env_state

NOBODY = -1  # `number` of a row that is free, `owner` of a module that obeys no parcel
# `taken` of a parcel that is on the line, or departed between exits; from 0 on it is an exit
ON_ITS_WAY, BETWEEN = -2, -1

JAM = 3  # the outcome of a surface, beside those of every environment; a stream has no success
DEPARTED_CORRECT, DEPARTED_WRONG = 2, 3  # outcomes of a parcel, in `ParcelState.outcome`

ENTERED, CORRECT, WRONG, TOUCHES, TURNS = range(5)  # columns of `tally`
# Places in a parcel's goal: exit, its side and span; where it comes from, its place in the order
EXIT, SIDE, FIRST, LAST, INLET, ORDER = range(6)
GOALS = 6
TOUCHED, OWN_MEMORY = range(2)  # places in its memory: touches begun since the last decision
NEVER = -1_000_000  # `touched_at` of two that have not touched


class StreamState(NamedTuple):
    """State and results of every stream, beside its surface and the parcels on it."""

    time: Array  # (surfaces, arrivals) [s] at which each parcel comes
    start: Array  # (surfaces, arrivals, STATE_SIZE) of its centre of mass as it enters
    body: Integers  # (surfaces, arrivals) its row in the body table
    exit: Integers  # (surfaces, arrivals) that it is to leave by
    inlet: Integers  # (surfaces, arrivals) that it comes by
    order: Integers  # (surfaces, arrivals) its place in the order in which parcels are to leave
    past: Booleans  # (surfaces, arrivals) whether the parcel of a place in the order has departed
    arrivals: Integers  # (surfaces,) how many there are
    coming: Integers  # (surfaces,) before which all have entered
    due: Integers  # (surfaces,) the next whose time has not come: those between the two wait
    entered: Array  # (surfaces, arrivals) [s] when it did; nan before
    departed: Array  # (surfaces, arrivals) [s] when no rotor bore it any more; nan before
    taken: Integers  # (surfaces, arrivals) the exit it took, BETWEEN them, or ON_ITS_WAY
    correct: Booleans  # (surfaces, arrivals) whether it departed as it was to
    results: Array  # (surfaces, arrivals, results) of the task as it departed; nan before
    final: Array  # (surfaces, arrivals, 6) pose and velocity as it departed, like `truth`
    touches: Integers  # (surfaces, arrivals) how often it began to touch another
    # (surfaces, rows) which arrival has each row, or NOBODY; with a gate, the last rows are of
    # parcels that wait to enter
    number: Integers
    present: Booleans  # (surfaces, rows) whether a parcel is there and has not departed
    touched_at: Integers  # (surfaces, rows, rows) physics step in which two touched last
    clock: Array  # (surfaces,) [s]
    steps: Integers  # (surfaces,) physics steps since the start
    still: Array  # (surfaces,) [s] for which nothing has moved
    waited: Array  # (surfaces,) [s] that parcels have waited to enter, all together
    next_place: Integers  # (surfaces,) least place in the order whose parcel has not departed
    memory: Array  # (surfaces, surface_memories) what the task keeps of the surface
    exit_memory: Array  # (surfaces, exits, exit_memories) what the task keeps of each exit
    pressing: Array  # (surfaces, rows, rows) [N] mean force between two as of `touched_at`
    impulse: Array  # (surfaces,) [N s] largest in a physics step
    squeeze: Array  # (surfaces,) [N] largest mean force
    owner: Places  # (surfaces, rows, columns) the row of the parcel a module obeys, or NOBODY
    soonest: Array  # (surfaces, rows, columns) [s] when that parcel will bear on it
    commanded: Array  # (surfaces, rows, columns) [rad] axis angle that a module was last set to
    obeys: Booleans  # (surfaces or 1, rows, columns) a rotor in the zone, not stuck
    tally: Integers  # (surfaces, 5) ENTERED ... TURNS so far
    terms: Array  # (surfaces, terms) of the reward
    reward: Array  # (surfaces,) their sum
    outcome: Integers  # (surfaces,)
    fault: Integers  # (surfaces,)


class StreamParams(NamedTuple):
    """Numbers that all streams of a batch have in common."""

    exits: Array  # (exits, 3) side, first and last x [m]
    entry_gap: float  # [m] clear ahead of one that enters
    rotors_end: float  # [m] x half a pitch past the last column with a rotor
    ahead: float  # [s] in which a parcel must be about to bear on a module for it to obey
    duration: float  # [s] of an episode
    patience: float  # [s] without any motion that make a jam
    inlets: int  # how many there are
    queue: int  # rows of parcels that wait at the gate; 0 without one
    numbers: Array  # (numbers,) of the task alone, as its `numbers` makes them
    touching: ContactMaterial  # how parcels' sides behave
    waiting_reward: float  # per second of each parcel that waits to enter
    jam_reward: float  # once, as nothing moves any more


class SurfaceView(NamedTuple):
    """A surface as the functions of a task get it."""

    params: StreamParams
    memory: Array  # (surface_memories,) what the task keeps of the surface
    exits: Array  # (exits, exit_memories) what the task keeps of each exit
    clock: float  # [s]
    next_place: int  # the least place in the order whose parcel has not departed


class StreamView(NamedTuple):
    """One surface of a batch of streams: the batch's arrays, and its places in them."""

    params: EnvParams
    stream_params: StreamParams
    surfaces: SurfaceState
    parcels: ParcelState
    bodies: BodyTable
    streams: StreamState
    i: int  # the surface
    first: int  # the row of its first parcel in `parcels`
    rows: int  # of its parcels
    slots: int  # the first of these rows, for parcels on the surface; the others show who waits


@inlined
def view_parcel(view: StreamView, row: int) -> EnvState:
    """View the parcel in a row of a surface."""
    return env_state(
        view.surfaces, view.parcels, view.bodies, view.i, view.first + row, view.params.elements
    )


@inlined
def view_task(view: StreamView) -> SurfaceView:
    """View a surface as the functions of a task get it."""
    streams, i = view.streams, view.i
    return SurfaceView(
        view.stream_params, streams.memory[i], streams.exit_memory[i], streams.clock[i],
        streams.next_place[i],
    )  # fmt: skip


def make_streams(
    surfaces: int,
    rows: int,
    shape: tuple[int, int],
    terms: int,
    obeys: Booleans,
    exits: int = 1,
    memories: int = 0,
    exit_memories: int = 0,
    results: int = 0,
) -> StreamState:
    """Make the memory of streams, with room for one arrival each."""
    grid = (surfaces, *shape)
    return StreamState(
        **_arrivals(surfaces, 1, results),
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
        next_place=np.zeros(surfaces, dtype=np.int64),
        memory=np.zeros((surfaces, memories)),
        exit_memory=np.zeros((surfaces, exits, exit_memories)),
        pressing=np.zeros((surfaces, rows, rows)),
        impulse=np.zeros(surfaces),
        squeeze=np.zeros(surfaces),
        owner=np.full(grid, NOBODY, dtype=np.int32),
        soonest=np.zeros(grid),
        commanded=np.zeros(grid),
        obeys=obeys,
        tally=np.zeros((surfaces, 5), dtype=np.int64),
        terms=np.zeros((surfaces, terms)),
        reward=np.zeros(surfaces),
        outcome=np.zeros(surfaces, dtype=np.int64),
        fault=np.zeros(surfaces, dtype=np.int64),
    )


def with_room(streams: StreamState, arrivals: int) -> StreamState:
    """Widen streams to hold so many arrivals; what is there is kept."""
    surfaces, room = streams.time.shape
    if arrivals <= room:
        return streams
    made = _arrivals(surfaces, max(arrivals, 2 * room), streams.results.shape[2])
    for name, values in made.items():
        values[:, :room] = getattr(streams, name)
    return streams._replace(**made)


def _arrivals(surfaces: int, room: int, results: int) -> dict[str, np.ndarray]:
    """Make the arrays that have a column an arrival."""
    shape = (surfaces, room)
    return {
        "time": np.zeros(shape),
        "start": np.zeros((*shape, STATE_SIZE)),
        "body": np.zeros(shape, dtype=np.int64),
        "exit": np.zeros(shape, dtype=np.int64),
        "entered": np.full(shape, np.nan),
        "departed": np.full(shape, np.nan),
        "inlet": np.zeros(shape, dtype=np.int64),
        "order": np.zeros(shape, dtype=np.int64),
        "past": np.zeros(shape, dtype=np.bool_),
        "taken": np.full(shape, ON_ITS_WAY),
        "correct": np.zeros(shape, dtype=np.bool_),
        "results": np.full((*shape, results), np.nan),
        "final": np.zeros((*shape, 6)),
        "touches": np.zeros(shape, dtype=np.int64),
    }


@dataclass(frozen=True)
class FlowStatistics:
    """Statistics of one episode, or of its part after a warm-up; nan where nothing happened."""

    delivered: int  # parcels that left the line
    parcels_per_hour: float  # [1/h] that left by their own exit
    missort_rate: float  # [-] of those that left, otherwise than they were to
    touches_per_1000: float  # times that two began to touch, per 1000 parcels delivered
    jams_per_1000: float  # jams per 1000 parcels delivered
    gap_mean: float  # [s] between parcels that leave by the same exit, one after the other
    gap_5: float  # [s] their 5th percentile
    gap_spread: float  # [s] their standard deviation
    time_mean: float  # [s] on the surface
    time_95: float  # [s] its 95th percentile
    waiting_mean: float  # [s] at the entry, of those that have entered
    waiting_most: float  # [s] the longest, of those that wait still too
    turns_per_hour: float  # [1/h] of a module's axis, mean over those that obey: its wear


def compute_statistics(
    streams: StreamState, surface: int, jammed: bool, obeying: int, warm_up: float = 0.0
) -> FlowStatistics:
    """Compute the statistics of a surface's episode so far, of which `obeying` modules obey.

    A touch counts half for each of the two, as it leaves; jams and turns are of the whole episode.
    Parcels that came or departed within a warm-up [s] do not count.
    """
    count = int(streams.arrivals[surface])
    time, entered, departed = (
        values[surface, :count] for values in (streams.time, streams.entered, streams.departed)
    )
    taken, clock = streams.taken[surface, :count], float(streams.clock[surface])
    counted = clock - warm_up
    gone = departed >= warm_up  # false for nan: the parcel is there still
    correct = gone & streams.correct[surface, :count]
    delivered = int(gone.sum())
    gaps = [np.diff(np.sort(departed[gone & (taken == exit_)])) for exit_ in np.unique(taken[gone])]
    gap = np.concatenate(gaps) if gaps else np.zeros(0)
    stay = (departed - entered)[gone]
    came = (time >= warm_up) & (time <= clock)
    waiting = np.where(np.isnan(entered), clock, entered)[came] - time[came]
    touches = int(streams.touches[surface, :count][gone].sum()) / 2.0
    per_parcel = 1000.0 / delivered if delivered else np.nan
    inside = came & ~np.isnan(entered)
    return FlowStatistics(
        delivered=delivered,
        parcels_per_hour=HOUR * float(correct.sum()) / counted if counted > 0.0 else np.nan,
        missort_rate=1.0 - float(correct.sum()) / delivered if delivered else np.nan,
        touches_per_1000=touches * per_parcel,
        jams_per_1000=float(jammed) * per_parcel,
        gap_mean=mean(gap),
        gap_5=percentile(gap, 5.0),
        gap_spread=float(gap.std()) if gap.size else np.nan,
        time_mean=mean(stay),
        time_95=percentile(stay, 95.0),
        waiting_mean=mean((entered - time)[inside]),
        waiting_most=float(waiting.max()) if waiting.size else np.nan,
        turns_per_hour=(
            HOUR * float(streams.tally[surface, TURNS]) / (obeying * clock)
            if clock > 0.0 and obeying
            else np.nan
        ),
    )


def mean(values: np.ndarray) -> float:
    """Return the mean of values (n,); nan where there are none."""
    return float(values.mean()) if values.size else np.nan


def percentile(values: np.ndarray, share: float) -> float:
    """Return the percentile [%] of values (n,); nan where there are none."""
    return float(np.percentile(values, share)) if values.size else np.nan
