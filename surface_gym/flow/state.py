"""The state arrays of streams, and the statistics of an episode.

Parcels use rows of `ParcelState`, as in any batch. With R rows per surface, the rows of surface i
start at i R. `StreamState.number` holds the arrival number of each row's parcel.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.jit import inlined
from surface_gym.core.kernel import EnvParams
from surface_gym.flow.arrivals import HOUR
from surface_gym.physics.collision import ContactMaterial
from surface_gym.physics.types import STATE_SIZE, Array, Booleans, Integers, Places
from surface_gym.state import BodyTable, EnvState, ParcelState, SurfaceState, env_state

NOBODY = -1  # `number` of a free row, and `owner` of a module without a parcel
# `taken` of a parcel on the line, or departed between exits; otherwise index of the exit
ON_ITS_WAY, BETWEEN = -2, -1

JAM = 3  # outcome of a surface, in addition to the common outcomes; a stream has no success
DEPARTED_CORRECT, DEPARTED_WRONG = 2, 3  # outcomes of a parcel, in `ParcelState.outcome`

ENTERED, CORRECT, WRONG, TOUCHES, TURNS = range(5)  # columns of `tally`
# Indices in a parcel's goal: exit, its side and span; inlet; place in the order
EXIT, SIDE, FIRST, LAST, INLET, ORDER = range(6)
GOALS = 6
TOUCHED, OWN_MEMORY = range(2)  # indices in its memory: touches begun since the last decision
NEVER = -1_000_000  # `touched_at` of two parcels without a touch


class StreamState(NamedTuple):
    """State and results of every stream. Other state is in `SurfaceState` and `ParcelState`."""

    time: Array  # (surfaces, arrivals) [s] time of arrival
    start: Array  # (surfaces, arrivals, STATE_SIZE) state of the centre of mass at entry
    body: Integers  # (surfaces, arrivals) row in the body table
    exit: Integers  # (surfaces, arrivals) goal exit
    inlet: Integers  # (surfaces, arrivals) inlet
    order: Integers  # (surfaces, arrivals) place in the required order of departure
    past: Booleans  # (surfaces, arrivals) whether the parcel with a place in the order has departed
    arrivals: Integers  # (surfaces,) number of arrivals
    coming: Integers  # (surfaces,) next arrival to enter
    # (surfaces,) next arrival that is not due; arrivals between `coming` and it are waiting
    due: Integers
    entered: Array  # (surfaces, arrivals) [s] time of entry; NaN before
    departed: Array  # (surfaces, arrivals) [s] time of departure from the rotors; NaN before
    taken: Integers  # (surfaces, arrivals) exit taken, BETWEEN exits, or ON_ITS_WAY
    correct: Booleans  # (surfaces, arrivals) whether it departed correctly
    results: Array  # (surfaces, arrivals, results) the task's results at departure; NaN before
    final: Array  # (surfaces, arrivals, 6) pose and velocity at departure, like `truth`
    touches: Integers  # (surfaces, arrivals) number of touches begun
    # (surfaces, rows) arrival in each row, or NOBODY; with a gate, the last rows are waiting
    # parcels
    number: Integers
    present: Booleans  # (surfaces, rows) whether there is a parcel that has not departed
    touched_at: Integers  # (surfaces, rows, rows) physics step of the last touch of two parcels
    clock: Array  # (surfaces,) [s]
    steps: Integers  # (surfaces,) physics steps since the start
    still: Array  # (surfaces,) [s] time without motion
    waited: Array  # (surfaces,) [s] total waiting time of parcels
    next_place: Integers  # (surfaces,) lowest place in the order whose parcel has not departed
    memory: Array  # (surfaces, surface_memories) the task's memory
    exit_memory: Array  # (surfaces, exits, exit_memories) the task's memory
    pressing: Array  # (surfaces, rows, rows) [N] mean force between two parcels at `touched_at`
    impulse: Array  # (surfaces,) [N s] largest impulse in a physics step
    squeeze: Array  # (surfaces,) [N] largest mean force
    owner: Places  # (surfaces, rows, columns) row of the parcel that a module obeys, or NOBODY
    soonest: Array  # (surfaces, rows, columns) [s] time until this parcel is on it
    commanded: Array  # (surfaces, rows, columns) [rad] last commanded axis angle of a module
    obeys: Booleans  # (surfaces or 1, rows, columns) whether a rotor is in the zone and not stuck
    tally: Integers  # (surfaces, 5) ENTERED ... TURNS so far
    terms: Array  # (surfaces, terms) terms of the reward
    reward: Array  # (surfaces,) sum of the terms
    outcome: Integers  # (surfaces,)
    fault: Integers  # (surfaces,)


class StreamParams(NamedTuple):
    """Parameters common to all streams of a batch."""

    exits: Array  # (exits, 3) side, first and last x [m]
    entry_gap: float  # [m] clearance ahead of an entering parcel
    rotors_end: float  # [m] x half a pitch past the last column with a rotor
    ahead: float  # [s] maximum time before a parcel's arrival at which a module obeys it
    duration: float  # [s] of an episode
    patience: float  # [s] time without motion until a jam
    inlets: int  # number of inlets
    queue: int  # rows of parcels waiting at the gate; 0 without a gate
    numbers: Array  # (numbers,) result of the task's `numbers`
    touching: ContactMaterial  # contact material of parcels' sides
    waiting_reward: float  # per second and waiting parcel
    jam_reward: float  # once, at a jam


class SurfaceView(NamedTuple):
    """The parts of a surface's state that a task's functions read and write.

    `memory` and `exits` are the task's memory. `clock` [s] is the time since the episode began.
    `next_place` is the lowest place in the required order whose parcel has not departed.
    """

    params: StreamParams
    memory: Array  # (surface_memories,) the task's memory of the surface
    exits: Array  # (exits, exit_memories) the task's memory of the exits
    clock: float  # [s] since the start of the surface
    next_place: int  # lowest place in the order whose parcel has not departed


class StreamView(NamedTuple):
    """View of a surface: arrays of a batch of streams, and the surface's place in these arrays."""

    params: EnvParams
    stream_params: StreamParams
    surfaces: SurfaceState
    parcels: ParcelState
    bodies: BodyTable
    streams: StreamState
    i: int  # index of the surface
    first: int  # row of its first parcel in `parcels`
    rows: int  # number of its rows
    slots: int  # number of rows for parcels on the surface; the other rows show waiting parcels


@inlined
def view_parcel(view: StreamView, row: int) -> EnvState:
    """Return the view of the parcel in row `row` of the surface's state arrays."""
    return env_state(
        view.surfaces, view.parcels, view.bodies, view.i, view.first + row, view.params.elements
    )


@inlined
def view_task(view: StreamView) -> SurfaceView:
    """Return the view of a surface for a task's functions."""
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
    """Allocate streams with room for one arrival per surface.

    A surface has `rows` rows for parcels, and a grid of modules of the shape `shape`. The task
    stores `memories` numbers per surface, `exit_memories` numbers per exit and `results` numbers
    per arrival. The reward has `terms` terms. The mask `obeys` (surfaces or 1, *shape) marks the
    modules that obey commands.
    """
    grid = (surfaces, *shape)
    per_surface: dict[str, Any] = dict.fromkeys(
        ("arrivals", "coming", "due", "steps", "next_place", "outcome", "fault"), np.int64
    ) | dict.fromkeys(("clock", "still", "waited", "impulse", "squeeze", "reward"), np.float64)
    return StreamState(
        **_arrivals(surfaces, 1, results),
        **{name: np.zeros(surfaces, dtype) for name, dtype in per_surface.items()},
        number=np.full((surfaces, rows), NOBODY),
        present=np.zeros((surfaces, rows), dtype=np.bool_),
        touched_at=np.full((surfaces, rows, rows), NEVER),
        memory=np.zeros((surfaces, memories)),
        exit_memory=np.zeros((surfaces, exits, exit_memories)),
        pressing=np.zeros((surfaces, rows, rows)),
        owner=np.full(grid, NOBODY, dtype=np.int32),
        soonest=np.zeros(grid),
        commanded=np.zeros(grid),
        obeys=obeys,
        tally=np.zeros((surfaces, 5), dtype=np.int64),
        terms=np.zeros((surfaces, terms)),
    )


def with_room(streams: StreamState, arrivals: int) -> StreamState:
    """Return streams with the same contents, and with room for at least `arrivals` arrivals."""
    surfaces, room = streams.time.shape
    if arrivals <= room:
        return streams
    made = _arrivals(surfaces, max(arrivals, 2 * room), streams.results.shape[2])
    for name, values in made.items():
        values[:, :room] = getattr(streams, name)
    return streams._replace(**made)


def _arrivals(surfaces: int, room: int, results: int) -> dict[str, np.ndarray]:
    """Allocate arrays (surfaces, room, ...) of arrivals. An arrival has `results` task results."""
    shape = (surfaces, room)
    integers = ("body", "exit", "inlet", "order", "touches")
    return {
        **{name: np.zeros(shape, dtype=np.int64) for name in integers},
        "time": np.zeros(shape),
        "start": np.zeros((*shape, STATE_SIZE)),
        "entered": np.full(shape, np.nan),
        "departed": np.full(shape, np.nan),
        "past": np.zeros(shape, dtype=np.bool_),
        "taken": np.full(shape, ON_ITS_WAY),
        "correct": np.zeros(shape, dtype=np.bool_),
        "results": np.full((*shape, results), np.nan),
        "final": np.zeros((*shape, 6)),
    }


ARRIVALS = tuple(_arrivals(1, 1, 0))  # names of the arrays with one column per arrival


@dataclass(frozen=True)
class FlowStatistics:
    """Statistics of an episode, or of its part after a warm-up. A statistic without data is NaN."""

    delivered: int  # number of departed parcels
    parcels_per_hour: float  # [1/h] correct departures
    missort_rate: float  # [-] share of departures that were wrong
    touches_per_1000: float  # touches begun per 1000 departed parcels
    jams_per_1000: float  # jams per 1000 departed parcels
    gap_mean: float  # [s] mean gap between successive departures by the same exit
    gap_5: float  # [s] 5th percentile of the gaps
    gap_spread: float  # [s] standard deviation of the gaps
    time_mean: float  # [s] mean time on the surface
    time_95: float  # [s] 95th percentile of the time on the surface
    waiting_mean: float  # [s] mean waiting time of entered parcels
    waiting_most: float  # [s] longest waiting time, including waiting parcels
    turns_per_hour: float  # [1/h] turns per obeying module, a measure of wear


def compute_statistics(
    streams: StreamState, surface: int, jammed: bool, obeying: int, warm_up: float = 0.0
) -> FlowStatistics:
    """Compute a surface's statistics up to now. The surface has `obeying` working modules.

    `jammed` is whether the episode ended in a jam. Jams and turns count over the whole episode. A
    departed parcel adds half a touch for each of its touches. Statistics of departures leave out
    parcels that departed in the first `warm_up` seconds. Statistics of waiting leave out parcels
    that arrived in the first `warm_up` seconds.
    """
    count = int(streams.arrivals[surface])
    time, entered, departed = (
        values[surface, :count] for values in (streams.time, streams.entered, streams.departed)
    )
    taken, clock = streams.taken[surface, :count], float(streams.clock[surface])
    counted = clock - warm_up
    gone = departed >= warm_up  # false for NaN: the parcel has not departed
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
    """Return the mean of values (n,); NaN without values."""
    return float(values.mean()) if values.size else np.nan


def percentile(values: np.ndarray, share: float) -> float:
    """Return the percentile of values (n,) at a share [%]; NaN without values."""
    return float(np.percentile(values, share)) if values.size else np.nan
