"""The table of a flow: a row a place, with each parcel's neighbours along the line."""

from surface_gym.core.kernel import EnvParams
from surface_gym.flow.entering import places_of
from surface_gym.flow.features import (
    AHEAD,
    BEHIND,
    show_neighbour,
    show_no_neighbour,
    show_nobody,
    show_parcel,
)
from surface_gym.flow.memory import NOBODY, FlowRules, Flows
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import THETA, X
from surface_gym.state import BodyTable, ParcelState, SurfaceState, env_state, reach_along


@inlined
def _nearest(flows: Flows, lanes: ParcelState, i: int, place: int, ahead: bool) -> int:
    """The place of the nearest parcel ahead along x, or behind, as sensed; or NOBODY.

    Of two at the same x the one that came first is ahead.
    """
    first = i * flows.number.shape[1]
    x = lanes.sensed[first + place, X]
    nearest = NOBODY
    least = 0.0
    for k in range(flows.number.shape[1]):
        if not flows.present[i, k] or k == place:
            continue
        apart = lanes.sensed[first + k, X] - x
        is_ahead = apart > 0.0 or (apart == 0.0 and flows.number[i, k] < flows.number[i, place])
        if is_ahead == ahead and (nearest == NOBODY or abs(apart) < least):
            nearest = k
            least = abs(apart)
    return nearest


@inlined
def show_parcels(
    rules: EnvParams,
    flow_rules: FlowRules,
    surfaces: SurfaceState,
    lanes: ParcelState,
    sites: BodyTable,
    flows: Flows,
    i: int,
) -> None:
    """Write every row of a surface's table."""
    rows = flows.number.shape[1]
    real = places_of(flow_rules, flows)
    first = i * rows
    for k in range(rows):
        lane = env_state(surfaces, lanes, sites, i, first + k, rules.elements)
        waits = k >= real and flows.number[i, k] != NOBODY
        if not (flows.present[i, k] or waits):
            show_nobody(lane)
            continue
        show_parcel(lane, waits)
        x, theta = lane.sensed[X], lane.sensed[THETA]
        front = x + reach_along(lane, theta, 1.0, 0.0)
        rear = x - reach_along(lane, theta, -1.0, 0.0)
        for ahead in range(2):
            place = _nearest(flows, lanes, i, k, ahead == 1)
            at = AHEAD if ahead == 1 else BEHIND
            if place == NOBODY:
                show_no_neighbour(lane, at)
                continue
            other = env_state(surfaces, lanes, sites, i, first + place, rules.elements)
            other_x, other_theta = other.sensed[X], other.sensed[THETA]
            if ahead == 1:
                gap = other_x - reach_along(other, other_theta, -1.0, 0.0) - front
            else:
                gap = rear - other_x - reach_along(other, other_theta, 1.0, 0.0)
            show_neighbour(lane, at, gap, other)
