"""Parcels leave the line: where no rotor bears one any more, it is delivered."""

from surface_gym.flow.memory import (
    BETWEEN,
    LEFT_RIGHT,
    LEFT_WRONG,
    RIGHT,
    WRONG,
    FlowRules,
    Flows,
)
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import THETA, X, Y
from surface_gym.state import EnvState, ParcelState, reach_along

ROUND_OFF = 1e-6  # [m]


@inlined
def exit_taken(rules: FlowRules, state: EnvState) -> int:
    """The exit by which a parcel has left, whose true pose is up to date; or BETWEEN them.

    Straight on it has left where its rear is past the last column of rotors, or its centre past
    the rotors' end; else to the side that its centre is on.
    """
    truth = state.truth
    last_column = rules.rotors_end - 0.5 * state.elements.pitch_x - ROUND_OFF
    rear = truth[X] - reach_along(state, truth[THETA], -1.0, 0.0)
    straight = rear > last_column or truth[X] > rules.rotors_end
    towards = 1.0 if truth[Y] > state.elements.line_y else -1.0
    side = 0.0 if straight else towards
    for k in range(rules.exits.shape[0]):
        if rules.exits[k, 0] == side and (
            straight or rules.exits[k, 1] <= truth[X] < rules.exits[k, 2]
        ):
            return k
    return BETWEEN


@inlined
def leave(flows: Flows, lanes: ParcelState, i: int, place: int, taken: int) -> None:
    """The parcel of a place has left by an exit; its place is kept until the next decision."""
    arrival = flows.number[i, place]
    right = taken == flows.exit[i, arrival]
    flows.present[i, place] = False
    flows.left[i, arrival] = flows.clock[i]
    flows.taken[i, arrival] = taken
    flows.tally[i, RIGHT if right else WRONG] += 1
    lanes.outcome[i * flows.number.shape[1] + place] = LEFT_RIGHT if right else LEFT_WRONG
