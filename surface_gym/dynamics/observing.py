"""The steps of a run done once more, with what bore the parcel and the friction that acted.

A run records states alone. Each step depends on the state before it and nothing else, so the same
functions lead from there to the same bits.
"""

from typing import NamedTuple

from surface_gym.dynamics.compiled import compiled, inlined
from surface_gym.dynamics.explicit import RESTART_SPEED, explicit_acceleration, held_share
from surface_gym.dynamics.friction import friction_gradient
from surface_gym.dynamics.step import advance_explicit, advance_implicit, bear_load, find_support
from surface_gym.dynamics.types import (
    AXIS_X,
    AXIS_Y,
    FORCE_X,
    FORCE_Y,
    NORMAL,
    OMEGA,
    ROTOR,
    SPAN_FIRST,
    SPAN_LAST,
    SPAN_ROW,
    SPANS,
    STATE_SIZE,
    VX,
    VY,
    Array,
    Body,
    Contacts,
    Grid,
    Integers,
    Scratch,
)


class Steps(NamedTuple):
    """The steps of a run: step k leads from row k - 1 to row k, and step 0 is none."""

    before: Array  # (T, STATE_SIZE) the states recorded
    length: Array  # (T,) [s]
    lead: Array  # (T,) [s] from a step's start to the pose whose contacts bear it
    first: Integers  # (T + 1,) the row of a step's first contact in what is observed


class Observed(NamedTuple):
    """What the steps leave, the contacts of a step one after the other in the order of the grid."""

    state: Array  # (T, STATE_SIZE) where each step leads
    element: Integers  # (contacts, 2) row and column
    normal: Array  # (contacts,) [m/s^2] normal force / mass
    force: Array  # (contacts, 2) [m/s^2] friction on the parcel / mass, in x and y


@compiled
def count_contacts(grid: Grid, body: Body, steps: Steps, scratch: Scratch, count: Integers) -> None:
    """Write how many contacts bear each step, (T,); all that follows asks for one at least."""
    for k in range(1, steps.before.shape[0]):
        contacts = find_support(grid, body, steps.before[k - 1], scratch, steps.lead[k])
        count[k] = contacts.total


@compiled
def bear_loads(grid: Grid, body: Body, steps: Steps, scratch: Scratch, observed: Observed) -> None:
    """Write the normal forces of all steps, by the dual of Eq. (1)."""
    for k in range(1, steps.before.shape[0]):
        contacts = find_support(grid, body, steps.before[k - 1], scratch, steps.lead[k])
        bear_load(grid, body, steps.before[k - 1], scratch, contacts)
        for i in range(contacts.total):
            observed.normal[steps.first[k] + i] = scratch.table[NORMAL + i]


@inlined
def _begin(
    grid: Grid, body: Body, steps: Steps, k: int, scratch: Scratch, observed: Observed
) -> Contacts:
    """Put a step's state, contacts and normal forces where the step takes them from."""
    state, first = observed.state[k], steps.first[k]
    for j in range(STATE_SIZE):
        state[j] = steps.before[k - 1, j]
    contacts = find_support(grid, body, state, scratch, steps.lead[k])
    for i in range(contacts.total):
        scratch.table[NORMAL + i] = observed.normal[first + i]
    i = first
    for span in range(scratch.marks[SPANS]):
        row = scratch.marks[SPAN_ROW + span]
        for column in range(scratch.marks[SPAN_FIRST + span], scratch.marks[SPAN_LAST + span] + 1):
            observed.element[i, 0] = row
            observed.element[i, 1] = column
            i += 1
    return contacts


@compiled
def repeat_implicit(
    grid: Grid, body: Body, steps: Steps, scratch: Scratch, observed: Observed
) -> None:
    """Do the implicit steps, normal forces given, and note the friction at their ends."""
    for k in range(1, steps.before.shape[0]):
        state, first, length = observed.state[k], steps.first[k], steps.length[k]
        contacts = _begin(grid, body, steps, k, scratch, observed)
        advance_implicit(grid, body, state, scratch, contacts, length)
        friction_gradient(scratch, contacts, state[VX], state[VY], state[OMEGA])
        for i in range(contacts.total):
            observed.force[first + i, 0] = -scratch.table[FORCE_X + i] / length
            observed.force[first + i, 1] = -scratch.table[FORCE_Y + i] / length


@compiled
def repeat_explicit(
    grid: Grid, level: Grid, body: Body, steps: Steps, scratch: Scratch, observed: Observed
) -> None:
    """Do the explicit steps, normal forces given, and note the friction at their starts.

    Args:
        grid: the surface.
        level: the same without the pull of gravity along it, so that friction alone is left.
        body: the parcel.
        steps: to do.
        scratch: of the steps.
        observed: normal forces in, all else out.
    """
    for k in range(1, steps.before.shape[0]):
        before, state, first = steps.before[k - 1], observed.state[k], steps.first[k]
        contacts = _begin(grid, body, steps, k, scratch, observed)
        advance_explicit(grid, body, state, scratch, contacts, steps.length[k])
        standing = before[VX] <= 0.0
        vx = RESTART_SPEED if standing else before[VX]
        along_x = 0.0
        other_x = grid.gravity_along
        for i in range(contacts.total):
            # The law for one contact at a time, which begins the tables.
            one = Scratch(scratch.table[i:], scratch.marks[i:])
            fx, fy, _, _ = explicit_acceleration(
                level, body.gyration, one, Contacts(1, 0), vx, before[VY], before[OMEGA]
            )
            observed.force[first + i, 0] = fx
            observed.force[first + i, 1] = fy
            pull = _along(scratch, i, fx, fy) * scratch.table[AXIS_X + i]
            along_x += pull
            other_x += fx - pull
        if standing and state[VX] == 0.0:  # Figure 5b's rule held it
            share = held_share(along_x, other_x)
            _scale_along(scratch, contacts, observed.force[first:], share)


@inlined
def _along(scratch: Scratch, i: int, fx: float, fy: float) -> float:
    """What of a contact's friction is along a rotor's axis; nothing of a support's."""
    axis_x, axis_y = scratch.table[AXIS_X + i], scratch.table[AXIS_Y + i]
    return scratch.marks[ROTOR + i] * (axis_x * fx + axis_y * fy)


@inlined
def _scale_along(scratch: Scratch, contacts: Contacts, force: Array, share: float) -> None:
    """Leave a share of the friction along the axes, and all other friction as it is."""
    for i in range(contacts.total):
        change = (share - 1.0) * _along(scratch, i, force[i, 0], force[i, 1])
        force[i, 0] += change * scratch.table[AXIS_X + i]
        force[i, 1] += change * scratch.table[AXIS_Y + i]
