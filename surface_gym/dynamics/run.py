"""Runs of steps that record every state."""

import numpy as np
from numpy.typing import NDArray

from surface_gym.dynamics.compiled import compiled
from surface_gym.dynamics.step import OFF_SURFACE, step_explicit, step_implicit
from surface_gym.dynamics.types import STATE_SIZE, Array, Body, Grid, Scratch


@compiled
def run_implicit(
    grid: Grid, body: Body, states: Array, reports: NDArray[np.int64], scratch: Scratch, dt: float
) -> int:
    """Fill states[1:] (steps + 1, STATE_SIZE) and reports[1:] from states[0].

    Returns:
        The steps done; fewer than asked for where a report ended the run.
    """
    for k in range(1, states.shape[0]):
        for j in range(STATE_SIZE):
            states[k, j] = states[k - 1, j]
        reports[k], _ = step_implicit(grid, body, states[k], scratch, dt)
        if reports[k] >= OFF_SURFACE:
            return k - 1
    return states.shape[0] - 1


@compiled
def run_explicit(
    grid: Grid, body: Body, states: Array, reports: NDArray[np.int64], scratch: Scratch, dt: float
) -> int:
    """`run_implicit` with the paper's loop in place of the implicit step."""
    for k in range(1, states.shape[0]):
        for j in range(STATE_SIZE):
            states[k, j] = states[k - 1, j]
        reports[k], _ = step_explicit(grid, body, states[k], scratch, dt)
        if reports[k] >= OFF_SURFACE:
            return k - 1
    return states.shape[0] - 1
