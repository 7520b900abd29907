"""One step of all parcels on a surface, which may push each other.

Each parcel first takes its step as if it were alone. Those whose bases meet on these ways push each
other (`pushing.py`); all others stay where their steps led, to the bit. The contacts with elements
and their normal forces remain those of the steps alone. The acceleration in a state, which loads
the elements, is that of friction and gravity: sides press at the height of the centre of mass and
tip nobody.

A parcel that is pushed into a third in the same step is moved out of it, and pushes it in the next.
"""

from surface_gym.dynamics.company import Company, TogetherScratch, Touching, body_of
from surface_gym.dynamics.compiled import linked
from surface_gym.dynamics.meeting import find_meetings, find_near
from surface_gym.dynamics.pushing import push
from surface_gym.dynamics.step import step_implicit
from surface_gym.dynamics.types import STATE_SIZE, Grid, Scratch


@linked
def step_together(
    grid: Grid, company: Company, touching: Touching, scratch: TogetherScratch, dt: float
) -> int:
    """One implicit step of all parcels present.

    A parcel whose report is OFF_SURFACE or UNBORNE keeps its state and touches nobody.

    Args:
        grid: the surface that all are on.
        company: whose states are moved on.
        touching: how sides behave.
        scratch: for as many parcels as the company has rows.
        dt: [s] step.

    Returns:
        How many pairs pushed each other: the first entries of `scratch.pair` and `impulse`.
    """
    for k in range(company.present.shape[0]):
        if company.present[k]:
            state = company.state[k]
            for j in range(STATE_SIZE):
                scratch.before[k, j] = state[j]
            report, contacts = step_implicit(
                grid,
                body_of(company.bodies, company.site[k]),
                state,
                Scratch(scratch.tables[k], scratch.marks[k]),
                dt,
            )
            scratch.report[k] = report
            scratch.bearing[k] = contacts.total
            scratch.rotors[k] = contacts.total - contacts.supports
    pairs = find_near(company, scratch)
    if pairs == 0 or not find_meetings(company, scratch, pairs, dt):
        return 0
    return push(grid, company, touching, scratch, pairs, dt)
