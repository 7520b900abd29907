"""Entry and exit of a stream's parcels (compiled).

A surface has a fixed number of slots: rows of the batch's arrays for one parcel each. With a gate,
the controller decides when a parcel enters, and more rows show the waiting parcels.
"""

import math
from functools import lru_cache
from typing import Any

from surface_gym import state as st
from surface_gym.compiler.jit import inlined
from surface_gym.core.kernel import Function
from surface_gym.flow import state as fs
from surface_gym.flow.state import StreamState, StreamView, view_parcel, view_task
from surface_gym.physics import types as ph
from surface_gym.state import EnvState


@inlined
def count_due(streams: StreamState, i: int) -> None:
    """Set `streams.due[i]` to the number of parcels that have arrived so far."""
    while (
        streams.due[i] < streams.arrivals[i] and streams.time[i, streams.due[i]] <= streams.clock[i]
    ):
        streams.due[i] += 1


@inlined
def _free_slot(view: StreamView) -> int:
    """Return the first free row for a parcel, or NOBODY if no row is free."""
    for slot in range(view.slots):
        if view.streams.number[view.i, slot] == fs.NOBODY:
            return slot
    return fs.NOBODY


@inlined
def count_waiting(streams: StreamState, i: int) -> int:
    """Return the number of parcels of stream i that have arrived but not entered."""
    return streams.due[i] - streams.tally[i, fs.ENTERED]


@inlined
def bars(other: EnvState, state: EnvState, gap: float) -> bool:
    """Return whether `other`, a parcel on the line, bars the entry of the parcel `state`.

    The entry is barred if the two parcels are less than `gap` [m] apart along x and also along y.
    """
    front = state.truth[ph.X] + st.reach_along(state, state.truth[ph.THETA], 1.0, 0.0) + gap
    if other.truth[ph.X] - st.reach_along(other, other.truth[ph.THETA], -1.0, 0.0) > front:
        return False
    left = state.truth[ph.Y] + st.reach_along(state, state.truth[ph.THETA], 0.0, 1.0)
    right = state.truth[ph.Y] - st.reach_along(state, state.truth[ph.THETA], 0.0, -1.0)
    other_left = other.truth[ph.Y] + st.reach_along(other, other.truth[ph.THETA], 0.0, 1.0)
    other_right = other.truth[ph.Y] - st.reach_along(other, other.truth[ph.THETA], 0.0, -1.0)
    return other_right < left + gap and right - gap < other_left


@inlined
def put(view: StreamView, slot: int, arrival: int) -> None:
    """Write the arrival with index `arrival`, at its entry pose, to the free row `slot`."""
    parcels, streams, i = view.parcels, view.streams, view.i
    row = view.first + slot
    for k in range(ph.STATE_SIZE):
        parcels.state[row, k] = streams.start[i, arrival, k]
    asked = streams.exit[i, arrival]
    parcels.body[row] = streams.body[i, arrival]
    parcels.goal[row, fs.EXIT] = asked
    parcels.goal[row, fs.SIDE] = view.stream_params.exits[asked, 0]
    parcels.goal[row, fs.FIRST] = view.stream_params.exits[asked, 1]
    parcels.goal[row, fs.LAST] = view.stream_params.exits[asked, 2]
    parcels.goal[row, fs.INLET] = streams.inlet[i, arrival]
    parcels.goal[row, fs.ORDER] = streams.order[i, arrival]
    parcels.clock[row] = 0.0
    parcels.period[row] = 0.0
    parcels.steps[row] = 0
    parcels.on_rotors[row] = True
    parcels.on_surface[row] = True
    parcels.outcome[row] = st.RUNNING


@inlined
def show_waiting(view: StreamView) -> None:
    """Write waiting parcels at entry poses to the queue's rows. Rows are in order of arrival."""
    streams, i = view.streams, view.i
    for place in range(view.stream_params.queue):
        slot = view.slots + place
        arrival = streams.coming[i] + place
        if arrival >= streams.due[i]:
            streams.number[i, slot] = fs.NOBODY
            continue
        put(view, slot, arrival)
        streams.number[i, slot] = arrival
        view.parcels.clock[view.first + slot] = streams.time[i, arrival] - streams.clock[i]
        state = view_parcel(view, slot)
        st.read_truth(state)
        for k in range(state.truth.shape[0]):
            state.sensed[k] = state.truth[k]


@inlined
def occupy(view: StreamView, slot: int, arrival: int) -> None:
    """Let the parcel in row `slot` enter the surface. The parcel's arrival has index `arrival`."""
    streams, i = view.streams, view.i
    streams.number[i, slot] = arrival
    streams.present[i, slot] = True
    streams.entered[i, arrival] = streams.clock[i]
    streams.tally[i, fs.ENTERED] += 1
    while streams.coming[i] < streams.due[i] and not math.isnan(
        streams.entered[i, streams.coming[i]]
    ):
        streams.coming[i] += 1
    for k in range(view.rows):
        streams.touched_at[i, slot, k] = fs.NEVER
        streams.touched_at[i, k, slot] = fs.NEVER
        streams.pressing[i, slot, k] = 0.0
        streams.pressing[i, k, slot] = 0.0


@lru_cache(maxsize=64)
def entering(has_room: Function, task_begin: Function, sensor_begin: Function) -> Any:
    """Build the function `let_in(view)`, which lets one parcel enter if there is room."""

    @inlined
    def is_clear(view: StreamView, slot: int) -> bool:
        """Return whether there is room on the line for the parcel in row `slot`."""
        state = view_parcel(view, slot)
        st.read_truth(state)
        for k in range(view.rows):
            if view.streams.present[view.i, k]:
                other = view_parcel(view, k)
                st.read_truth(other)
                if not has_room(view_task(view), state, other):
                    return False
        return True

    @inlined
    def let_in(view: StreamView) -> bool:
        """Let one parcel enter if there is room; return whether a parcel entered.

        Only the next waiting parcel of each inlet may enter. If several of these parcels have
        room, the parcel that arrived first enters.
        """
        streams, i = view.streams, view.i
        slot = _free_slot(view)
        if slot == fs.NOBODY or count_waiting(streams, i) == 0:
            return False
        barred = 0  # one bit per inlet
        open_inlets = view.stream_params.inlets
        arrival = streams.coming[i]
        while open_inlets > 0 and arrival < streams.due[i]:
            inlet = 1 << streams.inlet[i, arrival]
            if barred & inlet == 0 and math.isnan(streams.entered[i, arrival]):
                put(view, slot, arrival)
                if is_clear(view, slot):
                    occupy(view, slot, arrival)
                    state = view_parcel(view, slot)
                    state.memory[fs.TOUCHED] = 0.0
                    task_begin(state)
                    sensor_begin(view.params.sensor, state)
                    return True
                barred |= inlet
                open_inlets -= 1
            arrival += 1
        return False

    return let_in


@inlined
def depart(view: StreamView, slot: int, taken: int, correct: bool) -> None:
    """Take the parcel in row `slot` off the line.

    The parcel leaves by the exit with the index `taken`, or by no exit if `taken` is BETWEEN. If
    `correct` is true, the departure counts as correct, otherwise as wrong. The parcel's row is kept
    until the next decision.
    """
    parcels, streams, i = view.parcels, view.streams, view.i
    arrival = streams.number[i, slot]
    row = view.first + slot
    streams.past[i, streams.order[i, arrival]] = True
    next_place = streams.next_place[i]
    while next_place < streams.arrivals[i] and streams.past[i, next_place]:
        next_place += 1
    streams.next_place[i] = next_place
    streams.correct[i, arrival] = correct
    for k in range(parcels.truth.shape[1]):
        streams.final[i, arrival, k] = parcels.truth[row, k]
    streams.present[i, slot] = False
    streams.departed[i, arrival] = streams.clock[i]
    streams.taken[i, arrival] = taken
    streams.tally[i, fs.CORRECT if correct else fs.WRONG] += 1
    parcels.outcome[row] = fs.DEPARTED_CORRECT if correct else fs.DEPARTED_WRONG
