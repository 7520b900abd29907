"""Runs of many steps, recorded or repeated from a record.

A run records states only. Each step depends on the state before it and nothing else, so a repeated
step gives the same bits.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.compiler.jit import compiled, inlined
from surface_gym.physics import signed_distance as sd, step, types as ph
from surface_gym.physics.collision import ContactMaterial, World, WorldScratch
from surface_gym.physics.contact_solver import step_world
from surface_gym.physics.friction import friction_gradient
from surface_gym.physics.types import Array, Body, Contacts, Grid, Integers, Scratch


@compiled
def run_implicit(
    grid: Grid, body: Body, states: Array, reports: NDArray[np.int64], scratch: Scratch, dt: float
) -> int:
    """Fill states[1:] and reports[1:] from states[0]. Return the number of steps done.

    The array `states` has the shape (steps + 1, STATE_SIZE). The run ends early if a report is
    OFF_SURFACE or higher. The step of this report is not counted.
    """
    for k in range(1, states.shape[0]):
        for j in range(ph.STATE_SIZE):
            states[k, j] = states[k - 1, j]
        reports[k], _ = step.step_implicit(grid, body, states[k], scratch, dt)
        if reports[k] >= step.OFF_SURFACE:
            return k - 1
    return states.shape[0] - 1


@compiled
def run_explicit(
    grid: Grid, body: Body, states: Array, reports: NDArray[np.int64], scratch: Scratch, dt: float
) -> int:
    """Fill the arrays `states` and `reports` by the loop of the paper's Figure 5a.

    Arguments and result are as for `run_implicit`.
    """
    for k in range(1, states.shape[0]):
        for j in range(ph.STATE_SIZE):
            states[k, j] = states[k - 1, j]
        reports[k], _ = step.step_explicit(grid, body, states[k], scratch, dt)
        if reports[k] >= step.OFF_SURFACE:
            return k - 1
    return states.shape[0] - 1


class Records(NamedTuple):
    """Record of a run: states at the start and after each step, and pushes between parcels."""

    state: Array  # (steps + 1, P, STATE_SIZE)
    report: Integers  # (steps + 1, P)
    step: Integers  # (most contacts,) the step in which two parcels pushed each other
    pair: Integers  # (most contacts, 2) rows of the two parcels
    impulse: Array  # (most contacts,) [N s] along the normal


@compiled
def run_world(
    grid: Grid,
    world: World,
    material: ContactMaterial,
    scratch: WorldScratch,
    records: Records,
    first: int,
    last: int,
    touches: int,
    dt: float,
) -> tuple[int, int]:
    """Do the steps `first` to `last` (inclusive). Parcels that leave the surface become absent.

    Args:
        records: written from step `first` on.
        touches: number of parcel contacts already in the records.

    Returns:
        The next step to do, and the number of parcel contacts in the records. The run ends early
        if the records may have no room for the contacts of the next step.
    """
    rows = world.present.shape[0]
    for k in range(first, last + 1):
        if touches + scratch.pair.shape[0] > records.step.shape[0]:
            return k, touches
        pushed = step_world(grid, world, material, scratch, dt)
        for e in range(pushed):
            records.step[touches] = k
            records.pair[touches, 0] = scratch.pair[e, 0]
            records.pair[touches, 1] = scratch.pair[e, 1]
            records.impulse[touches] = scratch.impulse[e]
            touches += 1
        for i in range(rows):
            records.report[k, i] = scratch.report[i]
            world.present[i] &= scratch.report[i] < step.OFF_SURFACE
            for j in range(ph.STATE_SIZE):
                records.state[k, i, j] = world.state[i, j]
    return last + 1, touches


@compiled
def distance_between(world: World, i: int, j: int) -> float:
    """Return the signed distance [m] of two parcels; negative if they overlap."""
    first = sd.read_outline(world.bodies, world.body[i])
    second = sd.read_outline(world.bodies, world.body[j])
    gap = sd.signed_distance(
        first,
        sd.transform_at(first, sd.sweep_at_rest(world.state[i]), 0.0),
        second,
        sd.transform_at(second, sd.sweep_at_rest(world.state[j]), 0.0),
    )
    return gap.width


class RecordedSteps(NamedTuple):
    """Steps of a run. Step k leads from recorded state k - 1 to state k, so no step has index 0."""

    before: Array  # (T, STATE_SIZE) recorded states
    length: Array  # (T,) [s]
    lead: Array  # (T,) [s] from a step's start to the pose at which contacts are found
    first: Integers  # (T + 1,) row of a step's first contact in `ContactForces`


class ContactForces(NamedTuple):
    """Contacts and forces of recorded steps. A step's contacts are sorted by row, then column."""

    state: Array  # (T, STATE_SIZE) state after each step
    element: Integers  # (contacts, 2) row and column
    normal: Array  # (contacts,) [m/s^2] normal force / mass
    force: Array  # (contacts, 2) [m/s^2] friction on the parcel / mass, in x and y


@compiled
def count_contacts(
    grid: Grid, body: Body, steps: RecordedSteps, scratch: Scratch, count: Integers
) -> None:
    """Write the number of contacts of each step to `count` (T,).

    The functions below need at least one contact in each step.
    """
    for k in range(1, steps.before.shape[0]):
        contacts = step.find_support(grid, body, steps.before[k - 1], scratch, steps.lead[k])
        count[k] = contacts.total


@compiled
def support_loads(
    grid: Grid, body: Body, steps: RecordedSteps, scratch: Scratch, observed: ContactForces
) -> None:
    """Write the normal forces of all steps to `observed.normal`, by the dual of Eq. (1)."""
    for k in range(1, steps.before.shape[0]):
        contacts = step.find_support(grid, body, steps.before[k - 1], scratch, steps.lead[k])
        step.support_load(grid, body, steps.before[k - 1], scratch, contacts)
        for i in range(contacts.total):
            observed.normal[steps.first[k] + i] = scratch.table[ph.NORMAL + i]


@inlined
def _begin(
    grid: Grid, body: Body, steps: RecordedSteps, k: int, scratch: Scratch, observed: ContactForces
) -> Contacts:
    """Find step `k`'s contacts, set their normal forces, and write their elements to `observed`."""
    state, first = observed.state[k], steps.first[k]
    for j in range(ph.STATE_SIZE):
        state[j] = steps.before[k - 1, j]
    contacts = step.find_support(grid, body, state, scratch, steps.lead[k])
    for i in range(contacts.total):
        scratch.table[ph.NORMAL + i] = observed.normal[first + i]
    i = first
    for span in range(scratch.marks[ph.SPANS]):
        row = scratch.marks[ph.SPAN_ROW + span]
        for column in range(
            scratch.marks[ph.SPAN_FIRST + span], scratch.marks[ph.SPAN_LAST + span] + 1
        ):
            observed.element[i, 0] = row
            observed.element[i, 1] = column
            i += 1
    return contacts


@compiled
def repeat_implicit(
    grid: Grid, body: Body, steps: RecordedSteps, scratch: Scratch, observed: ContactForces
) -> None:
    """Repeat implicit steps with given normal forces, and record the friction at each step's end.

    `observed` holds the normal forces. The function writes all other fields of `observed`.
    """
    for k in range(1, steps.before.shape[0]):
        state, first, length = observed.state[k], steps.first[k], steps.length[k]
        contacts = _begin(grid, body, steps, k, scratch, observed)
        step.advance_implicit(grid, body, state, scratch, contacts, length)
        friction_gradient(scratch, contacts, state[ph.VX], state[ph.VY], state[ph.OMEGA])
        for i in range(contacts.total):
            observed.force[first + i, 0] = -scratch.table[ph.FORCE_X + i] / length
            observed.force[first + i, 1] = -scratch.table[ph.FORCE_Y + i] / length


@compiled
def repeat_explicit(
    grid: Grid,
    level: Grid,
    body: Body,
    steps: RecordedSteps,
    scratch: Scratch,
    observed: ContactForces,
) -> None:
    """Repeat explicit steps with given normal forces; record the friction at each step's start.

    Args:
        level: the grid without gravity in its plane, so that only friction accelerates.
        observed: holds the normal forces; all its other fields are written.
    """
    for k in range(1, steps.before.shape[0]):
        before, state, first = steps.before[k - 1], observed.state[k], steps.first[k]
        contacts = _begin(grid, body, steps, k, scratch, observed)
        step.advance_explicit(grid, body, state, scratch, contacts, steps.length[k])
        standing = before[ph.VX] <= 0.0 and not step.is_driven(grid)
        vx = step.RESTART_SPEED if standing else before[ph.VX]
        along_x = 0.0
        other_x = grid.gravity_x
        for i in range(contacts.total):
            # Apply the law to one contact: its scratch's tables begin at the contact.
            one = Scratch(scratch.table[i:], scratch.marks[i:])
            fx, fy, _, _ = step.explicit_acceleration(
                level, body.gyration, one, Contacts(1, 0, 0), vx, before[ph.VY], before[ph.OMEGA]
            )
            observed.force[first + i, 0] = fx
            observed.force[first + i, 1] = fy
            pull = _along(scratch, i, fx, fy) * scratch.table[ph.AXIS_X + i]
            along_x += pull
            other_x += fx - pull
        if standing and state[ph.VX] == 0.0:  # Figure 5b's rule held it
            share = step.held_share(along_x, other_x)
            _scale_along(scratch, contacts, observed.force[first:], share)


@inlined
def _along(scratch: Scratch, i: int, fx: float, fy: float) -> float:
    """Return the part of a force (fx, fy) along contact i's axis, or 0 without an idle rotor."""
    axis_x, axis_y = scratch.table[ph.AXIS_X + i], scratch.table[ph.AXIS_Y + i]
    rotor = scratch.marks[ph.KIND + i] == ph.ROTOR
    return rotor * (axis_x * fx + axis_y * fy)


@inlined
def _scale_along(scratch: Scratch, contacts: Contacts, force: Array, share: float) -> None:
    """Multiply the part of the `force` (contacts, 2) along the rotors' axes by `share`."""
    for i in range(contacts.total):
        change = (share - 1.0) * _along(scratch, i, force[i, 0], force[i, 1])
        force[i, 0] += change * scratch.table[ph.AXIS_X + i]
        force[i, 1] += change * scratch.table[ph.AXIS_Y + i]
