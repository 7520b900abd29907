"""Runs of steps together that record every state, and who pushed whom."""

from typing import NamedTuple

from surface_gym.dynamics.company import Company, TogetherScratch, Touching
from surface_gym.dynamics.compiled import compiled
from surface_gym.dynamics.gap import gap_between, outline_of, place_at, standing
from surface_gym.dynamics.step import OFF_SURFACE
from surface_gym.dynamics.together import step_together
from surface_gym.dynamics.types import STATE_SIZE, Array, Grid, Integers


class Records(NamedTuple):
    """What a run writes down, a row a step, the start first; and a row a touch."""

    state: Array  # (steps + 1, P, STATE_SIZE)
    report: Integers  # (steps + 1, P)
    step: Integers  # (most touches,) in which parcels pushed each other
    pair: Integers  # (most touches, 2) their rows
    impulse: Array  # (most touches,) [N s] along the normal


@compiled
def run_together(
    grid: Grid,
    company: Company,
    touching: Touching,
    scratch: TogetherScratch,
    records: Records,
    first: int,
    last: int,
    touches: int,
    dt: float,
) -> tuple[int, int]:
    """Do the steps from `first` to `last`; whoever leaves the surface is present no more.

    Args:
        grid: the surface that all are on.
        company: that takes the steps.
        touching: how sides behave.
        scratch: for as many parcels.
        records: to be written from `first` on.
        first: step.
        last: step.
        touches: that stand in the records already.
        dt: [s] step.

    Returns:
        The next step to be done, which is not past `last` where the records of touches may not
        have room for it; and how many touches stand in them.
    """
    rows = company.present.shape[0]
    for k in range(first, last + 1):
        if touches + scratch.pair.shape[0] > records.step.shape[0]:
            return k, touches
        pushed = step_together(grid, company, touching, scratch, dt)
        for e in range(pushed):
            records.step[touches] = k
            records.pair[touches, 0] = scratch.pair[e, 0]
            records.pair[touches, 1] = scratch.pair[e, 1]
            records.impulse[touches] = scratch.impulse[e]
            touches += 1
        for i in range(rows):
            records.report[k, i] = scratch.report[i]
            company.present[i] &= scratch.report[i] < OFF_SURFACE
            for j in range(STATE_SIZE):
                records.state[k, i, j] = company.state[i, j]
    return last + 1, touches


@compiled
def width_between(company: Company, i: int, j: int) -> float:
    """[m] of the gap between two parcels, negative where they overlap."""
    first = outline_of(company.bodies, company.site[i])
    second = outline_of(company.bodies, company.site[j])
    gap = gap_between(
        first,
        place_at(first, standing(company.state[i]), 0.0),
        second,
        place_at(second, standing(company.state[j]), 0.0),
    )
    return gap.width
