"""Parcels come onto the line, as soon as their time has come and there is room."""

from surface_gym.core.kernel import EnvParams
from surface_gym.flow.memory import (
    ENTERED,
    EXIT,
    FIRST,
    LAST,
    NEVER,
    NOBODY,
    SIDE,
    FlowRules,
    Flows,
)
from surface_gym.flow.rewards import begin_reward
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import STATE_SIZE, THETA, X, Y
from surface_gym.state import (
    RUNNING,
    BodyTable,
    EnvState,
    ParcelState,
    SurfaceState,
    env_state,
    reach_along,
    read_truth,
)


@inlined
def count_due(flows: Flows, i: int) -> None:
    """Count those whose time has come by now."""
    while flows.due[i] < flows.arrivals[i] and flows.time[i, flows.due[i]] <= flows.clock[i]:
        flows.due[i] += 1


@inlined
def places_of(rules: FlowRules, flows: Flows) -> int:
    """How many places there are on a surface."""
    return flows.number.shape[1] - (1 if rules.gated else 0)


@inlined
def _free_place(flows: Flows, i: int, places: int) -> int:
    """The first place that nobody has, or NOBODY."""
    for place in range(places):
        if flows.number[i, place] == NOBODY:
            return place
    return NOBODY


@inlined
def _bars(other: EnvState, state: EnvState, gap: float) -> bool:
    """Whether a parcel on the line is in the way of one about to enter, with a gap [m] ahead."""
    front = state.truth[X] + reach_along(state, state.truth[THETA], 1.0, 0.0) + gap
    if other.truth[X] - reach_along(other, other.truth[THETA], -1.0, 0.0) > front:
        return False
    left = state.truth[Y] + reach_along(state, state.truth[THETA], 0.0, 1.0)
    right = state.truth[Y] - reach_along(state, state.truth[THETA], 0.0, -1.0)
    other_left = other.truth[Y] + reach_along(other, other.truth[THETA], 0.0, 1.0)
    other_right = other.truth[Y] - reach_along(other, other.truth[THETA], 0.0, -1.0)
    return other_right < left + gap and right - gap < other_left


@inlined
def _put(
    rules: FlowRules, flows: Flows, lanes: ParcelState, i: int, place: int, arrival: int
) -> None:
    """Into the row of a place, where nobody is yet."""
    row = i * flows.number.shape[1] + place
    for k in range(STATE_SIZE):
        lanes.state[row, k] = flows.start[i, arrival, k]
    asked = flows.exit[i, arrival]
    lanes.body[row] = flows.site[i, arrival]
    lanes.goal[row, EXIT] = asked
    lanes.goal[row, SIDE] = rules.exits[asked, 0]
    lanes.goal[row, FIRST] = rules.exits[asked, 1]
    lanes.goal[row, LAST] = rules.exits[asked, 2]
    lanes.clock[row] = 0.0
    lanes.period[row] = 0.0
    lanes.steps[row] = 0
    lanes.on_rotors[row] = True
    lanes.on_surface[row] = True
    lanes.outcome[row] = RUNNING


@inlined
def show_next(
    rules: EnvParams,
    flow_rules: FlowRules,
    surfaces: SurfaceState,
    lanes: ParcelState,
    sites: BodyTable,
    flows: Flows,
    i: int,
) -> None:
    """Put the parcel that waits to enter, if any, into the last row, as it will enter: its pose and
    its speed are known.
    """
    last = flows.number.shape[1] - 1
    arrival = flows.coming[i]
    if arrival == flows.due[i]:
        flows.number[i, last] = NOBODY
        return
    _put(flow_rules, flows, lanes, i, last, arrival)
    row = i * flows.number.shape[1] + last
    flows.number[i, last] = arrival
    lanes.clock[row] = flows.time[i, arrival] - flows.clock[i]
    state = env_state(surfaces, lanes, sites, i, row, rules.elements)
    read_truth(state)
    for k in range(state.truth.shape[0]):
        state.sensed[k] = state.truth[k]


@inlined
def let_in(
    rules: EnvParams,
    flow_rules: FlowRules,
    surfaces: SurfaceState,
    lanes: ParcelState,
    sites: BodyTable,
    flows: Flows,
    i: int,
) -> int:
    """Let the next of those that are due enter if there is room: its place, or NOBODY.

    Its sensor has yet to begin.
    """
    arrival = flows.coming[i]
    if arrival == flows.due[i]:
        return NOBODY
    place = _free_place(flows, i, places_of(flow_rules, flows))
    if place == NOBODY:
        return NOBODY
    first = i * flows.number.shape[1]
    _put(flow_rules, flows, lanes, i, place, arrival)
    state = env_state(surfaces, lanes, sites, i, first + place, rules.elements)
    read_truth(state)
    for k in range(flows.number.shape[1]):
        if flows.present[i, k]:
            other = env_state(surfaces, lanes, sites, i, first + k, rules.elements)
            read_truth(other)
            if _bars(other, state, flow_rules.entry_gap):
                return NOBODY
    flows.number[i, place] = arrival
    flows.present[i, place] = True
    flows.entered[i, arrival] = flows.clock[i]
    flows.coming[i] = arrival + 1
    flows.tally[i, ENTERED] += 1
    begin_reward(state)
    for k in range(flows.number.shape[1]):
        flows.touched_at[i, place, k] = NEVER
        flows.touched_at[i, k, place] = NEVER
    return place
