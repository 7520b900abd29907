"""Forces of one step: between parcels and the surface's elements, and between parcels."""

from typing import NamedTuple

import numpy as np

from surface_gym.compiler.jit import compiled, inlined
from surface_gym.physics import collision, signed_distance as sd, step, types as ph
from surface_gym.physics.collision import ContactMaterial, World, WorldScratch
from surface_gym.physics.contact_solver import step_world
from surface_gym.physics.friction import friction_gradient
from surface_gym.physics.types import Array, Contacts, Grid, Integers, Scratch


class WorldForces(NamedTuple):
    """Buffers for the forces of one step of P parcels."""

    alone: Array  # (P, STATE_SIZE) state after each parcel's step alone
    first: Integers  # (P + 1,) row of each parcel's first contact in `below`
    element: Integers  # (most contacts, 2) row and column
    below: Array  # (most contacts, 3) [N] normal force, and friction on the parcel in x and y
    pair: Integers  # (most pairs, 2) rows of parcels that push each other
    push: Array  # (most pairs, 4) [m] point of action, and [N] force on the second, in x and y


def make_world_forces(parcels: int) -> WorldForces:
    """Make buffers for a number of parcels."""
    contacts, pairs = parcels * ph.CAPACITY, parcels * (parcels - 1) // 2
    return WorldForces(
        alone=np.zeros((parcels, ph.STATE_SIZE)),
        first=np.zeros(parcels + 1, dtype=np.int64),
        element=np.zeros((contacts, 2), dtype=np.int64),
        below=np.zeros((contacts, 3)),
        pair=np.zeros((pairs, 2), dtype=np.int64),
        push=np.zeros((pairs, 4)),
    )


@compiled
def observe_world(
    grid: Grid,
    world: World,
    material: ContactMaterial,
    scratch: WorldScratch,
    dt: float,
    forces: WorldForces,
) -> int:
    """Do one step by `step_world`, and write the mean forces of the step to `forces`.

    The force between sides that hit each other includes the whole impact. Return the number of
    pairs that push each other.
    """
    rows = world.present.shape[0]
    for k in range(rows):
        forces.first[k + 1] = forces.first[k]
        if world.present[k]:
            for j in range(ph.STATE_SIZE):
                forces.alone[k, j] = world.state[k, j]
            body = collision.read_body(world.bodies, world.body[k])
            under = Scratch(scratch.tables[k], scratch.marks[k])
            report, contacts = step.step_implicit(grid, body, forces.alone[k], under, dt)
            if report < step.OFF_SURFACE:
                _write_elements(under, forces.element[forces.first[k] :])
                forces.first[k + 1] += contacts.total
                rows_below = forces.below[forces.first[k] : forces.first[k + 1]]
                mass = world.bodies.body[world.body[k], ph.MASS]
                for i in range(contacts.total):
                    rows_below[i, 0] = mass * under.table[ph.NORMAL + i]
                    rows_below[i, 1] = rows_below[i, 2] = 0.0
                _add_friction(under, contacts, forces.alone[k], mass / dt, rows_below)
    scratch.ends[:, 2] = -1  # marks the end of this step's points
    pushed = step_world(grid, world, material, scratch, dt)
    for k in range(rows):
        if is_among(scratch, pushed, k):
            _share_friction(world, scratch, k, dt, forces)
    for e in range(pushed):
        _write_push(scratch, e, dt, forces)
    return pushed


@inlined
def _write_elements(scratch: Scratch, element: Integers) -> None:
    i = 0
    for span in range(scratch.marks[ph.SPANS]):
        for column in range(
            scratch.marks[ph.SPAN_FIRST + span], scratch.marks[ph.SPAN_LAST + span] + 1
        ):
            element[i, 0] = scratch.marks[ph.SPAN_ROW + span]
            element[i, 1] = column
            i += 1


@inlined
def _add_friction(
    scratch: Scratch, contacts: Contacts, state: Array, scale: float, below: Array
) -> None:
    """Add `scale` times the friction of each contact to the contact's row in the array `below`.

    Friction depends on the velocity in `state` and on the normal forces in `scratch`.
    """
    friction_gradient(scratch, contacts, state[ph.VX], state[ph.VY], state[ph.OMEGA])
    for i in range(contacts.total):
        below[i, 1] -= scale * scratch.table[ph.FORCE_X + i]
        below[i, 2] -= scale * scratch.table[ph.FORCE_Y + i]


@inlined
def is_among(scratch: WorldScratch, pushed: int, k: int) -> bool:
    """Return whether parcel `k` is in the first `pushed` rows of `scratch.pair`."""
    found = False
    for e in range(pushed):
        found |= scratch.pair[e, 0] == k or scratch.pair[e, 1] == k
    return found


@inlined
def _share_friction(
    world: World, scratch: WorldScratch, k: int, dt: float, forces: WorldForces
) -> None:
    """Set the friction on parcel `k` to the mean friction over the step.

    A touch changes the friction. The mean is weighted by the durations of the old
    and the new friction.
    """
    below = forces.below[forces.first[k] : forces.first[k + 1]]
    for i in range(below.shape[0]):
        below[i, 1] *= scratch.since[k] / dt
        below[i, 2] *= scratch.since[k] / dt
    mass = world.bodies.body[world.body[k], ph.MASS]
    under = Scratch(scratch.tables[k], scratch.marks[k])
    marks = scratch.marks[k]
    contacts = Contacts(below.shape[0], marks[ph.ISOTROPICS], marks[ph.SUPPORTS])
    _add_friction(under, contacts, world.state[k], mass / dt, below)


@inlined
def _write_push(scratch: WorldScratch, e: int, dt: float, forces: WorldForces) -> None:
    """Write the force of pair `e`, acting at the impulse-weighted mean of the contact points."""
    i, j = scratch.pair[e, 0], scratch.pair[e, 1]
    motion = sd.sweep_between(scratch.before[i], forces.alone[i])
    x = motion.x + scratch.since[i] * motion.vx
    y = motion.y + scratch.since[i] * motion.vy
    normal = side = nx = ny = arm_x = arm_y = 0.0
    for c in range(scratch.ends.shape[0]):
        if scratch.ends[c, 2] < 0:
            break
        if scratch.ends[c, 0] == i and scratch.ends[c, 1] == j:
            point = scratch.point[c]
            weight = point[ph.NORMAL_TOTAL]
            normal += weight
            side += point[ph.TANGENT_TOTAL]
            arm_x += weight * point[ph.FIRST_X]
            arm_y += weight * point[ph.FIRST_Y]
            nx, ny = point[ph.NORMAL_X], point[ph.NORMAL_Y]
    forces.pair[e, 0] = i
    forces.pair[e, 1] = j
    forces.push[e, 0] = x + arm_x / normal
    forces.push[e, 1] = y + arm_y / normal
    forces.push[e, 2] = (normal * nx - side * ny) / dt
    forces.push[e, 3] = (normal * ny + side * nx) / dt
