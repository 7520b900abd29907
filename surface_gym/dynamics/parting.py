"""Parcels that overlap, moved apart."""

from surface_gym.dynamics.company import Company, TogetherScratch
from surface_gym.dynamics.compiled import linked
from surface_gym.dynamics.gap import gap_between, outline_of, place_at, standing
from surface_gym.dynamics.impact import TOUCH
from surface_gym.dynamics.types import MASS, X, Y

MAX_SWEEPS = 20


@linked
def part(company: Company, scratch: TogetherScratch, pairs: int) -> None:
    """Move near pairs that overlap apart along their normals, the heavier less.

    Their velocities stay. A chain of parcels takes several sweeps.
    """
    bodies, state = company.bodies, company.state
    for _ in range(MAX_SWEEPS):
        apart = True
        for e in range(pairs):
            i = scratch.near[e, 0]
            j = scratch.near[e, 1]
            first = outline_of(bodies, company.site[i])
            second = outline_of(bodies, company.site[j])
            gap = gap_between(
                first,
                place_at(first, standing(state[i]), 0.0),
                second,
                place_at(second, standing(state[j]), 0.0),
            )
            if gap.width >= -TOUCH:
                continue
            apart = False
            overlap = -gap.width - 0.5 * TOUCH
            own = bodies.body[company.site[i], MASS]
            other = bodies.body[company.site[j], MASS]
            share = other / (own + other)
            state[i, X] -= share * overlap * gap.nx
            state[i, Y] -= share * overlap * gap.ny
            state[j, X] += (1.0 - share) * overlap * gap.nx
            state[j, Y] += (1.0 - share) * overlap * gap.ny
        if apart:
            break
