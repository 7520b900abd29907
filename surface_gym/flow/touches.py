"""Who begins to touch whom."""

from surface_gym.flow.memory import TOUCHED, TOUCHES, Flows
from surface_gym.physics.collision import WorldScratch
from surface_gym.physics.jit import inlined
from surface_gym.state import ParcelState

APART = 0.2  # [s] two that have not pushed each other for so long begin anew


@inlined
def note_touches(
    lanes: ParcelState, flows: Flows, scratch: WorldScratch, i: int, pairs: int, apart: int
) -> None:
    """Count who begins to touch whom."""
    rows = flows.number.shape[1]
    for k in range(pairs):
        a, b = scratch.pair[k, 0], scratch.pair[k, 1]
        if flows.steps[i] - flows.touched_at[i, a, b] > apart:
            flows.tally[i, TOUCHES] += 1
            flows.touches[i, flows.number[i, a]] += 1
            flows.touches[i, flows.number[i, b]] += 1
            lanes.memory[i * rows + a, TOUCHED] += 1.0
            lanes.memory[i * rows + b, TOUCHED] += 1.0
        flows.touched_at[i, a, b] = flows.steps[i]
        flows.touched_at[i, b, a] = flows.steps[i]
