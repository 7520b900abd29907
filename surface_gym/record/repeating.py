"""What it takes to do the steps of a run once more, and doing them."""

from dataclasses import dataclass

import numpy as np

from surface_gym.parcel import Parcel
from surface_gym.physics.references import find_support
from surface_gym.physics.rollout import (
    ContactForces,
    RecordedSteps,
    count_contacts,
    repeat_explicit,
    repeat_implicit,
    support_loads,
)
from surface_gym.physics.types import NORMAL, Array, Scratch, make_scratch, table_row
from surface_gym.surface import Surface


@dataclass(frozen=True, eq=False)
class Run:
    """How a trajectory by `surface_gym.simulate` came about; each of its steps follows from it."""

    surface: Surface
    parcel: Parcel
    dt: float  # [s] of a step; the last may be shorter
    method: str  # "implicit" or "explicit"
    normal_forces: str  # "dual", "osqp" or "scipy": what solved Eq. (1)
    # (T, 8) the centre of mass's x, y [m], theta [rad], vx, vy [m/s], omega [rad/s], and the
    # acceleration ax, ay [m/s^2] of the step that led here
    states: Array

    def lengths(self, time: Array) -> Array:
        """(T,) [s] of the step that led to each row, 0 for the start; time is (T,) [s]."""
        length = np.full(len(time), self.dt)
        if time[-1] != self.dt * (len(time) - 1):
            length[-1] = time[-1] - time[-2]
        length[0] = 0.0
        return length

    def leads(self, time: Array) -> Array:
        """(T,) [s] from the start of each step to the pose whose contacts bear it."""
        return (0.5 if self.method == "implicit" else 0.0) * self.lengths(time)


def repeat(run: Run, time: Array) -> tuple[RecordedSteps, ContactForces]:
    """Do each step of a run once more, from the state recorded before it.

    Args:
        run: how the steps were done.
        time: (T,) [s] their ends, the start first.

    Raises:
        ValueError: nothing bears the parcel in a step, so that the states are those of no run.
    """
    grid, body = run.surface.grid, run.parcel.body
    scratch = make_scratch()
    count = np.zeros(len(time), dtype=np.int64)
    first = np.zeros(len(time) + 1, dtype=np.int64)
    steps = RecordedSteps(run.states, run.lengths(time), run.leads(time), first)
    count_contacts(grid, body, steps, scratch, count)
    if not count[1:].all():
        step = 1 + int(np.argmin(count[1:]))
        raise ValueError(f"states must be over elements in every step, got none in step {step}")
    first[1:] = np.cumsum(count)
    total = int(first[-1])
    observed = ContactForces(
        run.states.copy(),
        np.zeros((total, 2), dtype=np.int64),
        np.zeros(total),
        np.zeros((total, 2)),
    )
    if run.normal_forces == "dual":
        support_loads(grid, body, steps, scratch, observed)
    else:
        _bear_by_reference(run, steps, scratch, observed)
    if run.method == "implicit":
        repeat_implicit(grid, body, steps, scratch, observed)
    else:
        level = grid._replace(gravity_along=0.0)
        repeat_explicit(grid, level, body, steps, scratch, observed)
    return steps, observed


def _bear_by_reference(
    run: Run, steps: RecordedSteps, scratch: Scratch, observed: ContactForces
) -> None:
    """Write the normal forces of all steps as OSQP or SciPy finds them."""
    from surface_gym.physics.references import support_load_by

    grid, body = run.surface.grid, run.parcel.body
    for k in range(1, len(run.states)):
        state, first = run.states[k - 1], steps.first[k]
        count = find_support(grid, body, state, scratch, float(steps.lead[k])).total
        support_load_by(run.normal_forces, grid, body, state, scratch, count)
        observed.normal[first : first + count] = table_row(scratch, NORMAL, count)
