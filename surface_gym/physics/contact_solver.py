"""One step of all parcels on a surface, with collisions between them.

Each parcel first steps alone. Parcels whose bases meet on the way then push each other. All others
keep the result of their step alone, to the bit. Parcels that touch, directly or through others,
form an island. In each island:
    1. sides that close fast hit each other: compression, then restitution, in which the surface's
       friction has no time to act (`impact.py`);
    2. the velocities after the step are solved together, so that no sides close on each other;
       friction acts for the rest of the step (`island.py`);
    3. each parcel moves on with its new velocity from its pose at first touch.
Remaining overlaps are resolved last.

Each parcel's contacts with elements, and the normal forces there, come from its step alone. The
acceleration in a state loads the elements in the next step; it includes friction and gravity only.
Sides press at the height of the centre of mass, so they tip no parcel. If a push moves a parcel
into a third parcel, the same step moves both apart. These two push each other in the next step.
"""

import math

from surface_gym.compiler.jit import inlined, linked
from surface_gym.physics import (
    collision,
    impact,
    island as islands,
    signed_distance as sd,
    types as ph,
)
from surface_gym.physics.collision import ContactMaterial, World, WorldScratch
from surface_gym.physics.friction import implicit_velocity, load_contacts
from surface_gym.physics.island import Island
from surface_gym.physics.step import step_implicit
from surface_gym.physics.types import Array, Contacts, Grid, Integers, Scratch

MAX_SWEEPS = 100


@inlined
def resolve_overlaps(world: World, scratch: WorldScratch, pairs: int) -> None:
    """Move overlapping parcels apart along their contact's normal. The heavier parcel moves less.

    Velocities do not change. A sweep handles every near pair once, so a chain of parcels takes
    several sweeps. A moved parcel may overlap a third parcel. So the function searches for near
    pairs again when all pairs are apart.
    """
    bodies, state = world.bodies, world.state
    near, moved = collision.add_pushed_pairs(world, scratch, pairs), False
    for _ in range(MAX_SWEEPS):
        apart = True
        for e in range(near):
            i = scratch.near[e, 0]
            j = scratch.near[e, 1]
            first = sd.read_outline(bodies, world.body[i])
            second = sd.read_outline(bodies, world.body[j])
            pose = sd.transform_at(first, sd.sweep_at_rest(state[i]), 0.0)
            other_pose = sd.transform_at(second, sd.sweep_at_rest(state[j]), 0.0)
            if sd.stay_clear(first, pose, second, other_pose, 0.0, 0.0, 0.0):
                continue
            gap = sd.signed_distance(first, pose, second, other_pose)
            if gap.width >= -sd.CONTACT_DISTANCE:
                continue
            apart = False
            overlap = -gap.width - 0.5 * sd.CONTACT_DISTANCE
            mass = bodies.body[world.body[i], ph.MASS]
            other_mass = bodies.body[world.body[j], ph.MASS]
            share = other_mass / (mass + other_mass)
            state[i, ph.X] -= share * overlap * gap.nx
            state[i, ph.Y] -= share * overlap * gap.ny
            state[j, ph.X] += (1.0 - share) * overlap * gap.nx
            state[j, ph.Y] += (1.0 - share) * overlap * gap.ny
        if not apart:
            moved = True
        elif moved:
            near, moved = collision.add_pushed_pairs(world, scratch, pairs), False
        else:
            break


RESTING = 0.02  # [m/s] Sides that close no faster do not rebound.
PUSHED = 1e-8  # [m/s] impulses with a smaller change of speed do not count


@linked
def solve_contacts(
    grid: Grid,
    world: World,
    material: ContactMaterial,
    scratch: WorldScratch,
    pairs: int,
    dt: float,
) -> int:
    """Solve the contacts of all islands, and return the number of pairs that pushed each other.

    `pairs` is the number of near pairs in `scratch`.
    """
    points = collision.find_contact_points(world, scratch, pairs, dt)
    for first in range(world.present.shape[0]):
        if scratch.root[first] == first and scratch.since[first] < math.inf:
            members, contacts = collision.gather_island(scratch, first, points)
            island = _make_island(world, scratch, scratch.floor, members, contacts)
            _begin(world, scratch, island, dt)
            hit = _closes_fast(island, scratch.start)
            if hit:
                free = _make_island(world, scratch, scratch.nothing, members, contacts)
                _rebound(scratch, free, material)
            _continue(grid, material, scratch, island, dt)
            for n in range(members):
                k = scratch.member[n]
                if _is_pushed(scratch, island, k):
                    _advance(grid, world, scratch, k, hit, dt)
    resolve_overlaps(world, scratch, pairs)
    pushed = 0
    for e in range(pairs):
        if scratch.push[e] > 0.0:
            scratch.pair[pushed, 0] = scratch.near[e, 0]
            scratch.pair[pushed, 1] = scratch.near[e, 1]
            scratch.impulse[pushed] = scratch.push[e]
            pushed += 1
    return pushed


@inlined
def _make_island(
    world: World, scratch: WorldScratch, floor: Integers, members: int, contacts: int
) -> Island:
    return Island(
        members,
        contacts,
        world.bodies,
        world.body,
        scratch.tables,
        scratch.marks,
        floor,
        scratch.member,
        scratch.slot,
        scratch.low,
        scratch.contact,
        scratch.ends,
        scratch.point,
        scratch.velocity,
        scratch.target,
        scratch.trial,
        scratch.gradient,
        scratch.direction,
        scratch.matrix,
    )


@inlined
def _begin(world: World, scratch: WorldScratch, island: Island, dt: float) -> None:
    """Write an island's velocities at first touch, and limits of floor friction after the touch."""
    for n in range(island.members):
        k = island.member[n]
        share = scratch.since[k] / dt
        for axis in range(ph.VX, ph.OMEGA + 1):
            old = scratch.before[k, axis]
            scratch.start[k, axis - ph.VX] = old + share * (world.state[k, axis] - old)
            scratch.velocity[k, axis - ph.VX] = world.state[k, axis]
            scratch.met[k, axis - ph.VX] = scratch.start[k, axis - ph.VX]
        elements, contacts = islands.floor_contacts(island, k)
        load_contacts(elements, contacts, dt - scratch.since[k])


@inlined
def _closes_fast(island: Island, start: Array) -> bool:
    """Return whether any two touching sides of parcels in an island approach each other fast.

    `start`, shape (P, 3) [m/s, m/s, rad/s], are the parcels' velocities.
    """
    for m in range(island.contacts):
        c = island.contact[m]
        normal, _ = islands.relative_velocity(island, c, start)
        if normal + island.point[c, ph.CLOSING] < -RESTING:
            return True
    return False


@inlined
def _presses(island: Island, c: int) -> bool:
    """Return whether the normal impulse of contact point c is too large to be neglected."""
    point = island.point
    least = PUSHED * point[c, ph.NORMAL_STIFFNESS] / islands.STIFFNESS
    return bool(point[c, ph.NORMAL_IMPULSE] > least)


@inlined
def _apply_impulses(scratch: WorldScratch, island: Island) -> None:
    """Change the velocities `scratch.start` by the impulses of an island."""
    change = scratch.gradient
    for n in range(island.members):
        for axis in range(3):
            change[island.member[n], axis] = 0.0
    for m in range(island.contacts):
        c = island.contact[m]
        if _presses(island, c):
            pn = island.point[c, ph.NORMAL_IMPULSE]
            pt = island.point[c, ph.TANGENT_IMPULSE]
            islands.add_impulse(island, c, pn, pt, change, 1.0)
            island.point[c, ph.NORMAL_TOTAL] += pn
            island.point[c, ph.TANGENT_TOTAL] += pt
            scratch.push[island.ends[c, 2]] += pn
    for n in range(island.members):
        k = island.member[n]
        body = island.bodies.body[island.body[k]]
        scratch.start[k, 0] += change[k, 0] / body[ph.MASS]
        scratch.start[k, 1] += change[k, 1] / body[ph.MASS]
        scratch.start[k, 2] += change[k, 2] / (body[ph.MASS] * body[ph.GYRATION])


@linked
def _rebound(scratch: WorldScratch, island: Island, material: ContactMaterial) -> None:
    """Apply compression and restitution between parcels of an island, without surface friction."""
    for n in range(island.members):
        k = island.member[n]
        for axis in range(3):
            scratch.target[k, axis] = scratch.start[k, axis]
            scratch.velocity[k, axis] = scratch.start[k, axis]
    islands.solve_velocities(island, material.friction)
    pressed, only = 0, 0
    for m in range(island.contacts):
        if _presses(island, island.contact[m]):
            pressed += 1
            only = island.contact[m]
    if pressed == 1:
        pn, pt = impact.integrate_impact(
            island, only, scratch.start, material.friction, material.restitution
        )
        island.point[only, ph.NORMAL_IMPULSE] = pn
        island.point[only, ph.TANGENT_IMPULSE] = pt
    else:
        _apply_impulses(scratch, island)
        impact.part_sides(island, scratch.start, material.friction, material.restitution)
    _apply_impulses(scratch, island)


@linked
def _continue(
    grid: Grid, material: ContactMaterial, scratch: WorldScratch, island: Island, dt: float
) -> None:
    """Solve an island's velocities from contact to the step's end, with the surface's friction."""
    for n in range(island.members):
        k = island.member[n]
        for axis in range(3):
            scratch.target[k, axis] = scratch.start[k, axis]
        rest = dt - scratch.since[k]
        scratch.target[k, 0] += rest * grid.gravity_x
        scratch.target[k, 1] += rest * grid.gravity_y
    islands.solve_velocities(island, material.friction)
    _apply_impulses(scratch, island)


@inlined
def _is_pushed(scratch: WorldScratch, island: Island, k: int) -> bool:
    """Return whether any parcel of an island pushes the parcel in row k."""
    for m in range(island.contacts):
        c = island.contact[m]
        involved = island.ends[c, 0] == k or island.ends[c, 1] == k
        if involved and scratch.push[island.ends[c, 2]] > 0.0:
            return True
    return False


@inlined
def _advance(grid: Grid, world: World, scratch: WorldScratch, k: int, hit: bool, dt: float) -> None:
    """Move pushed parcel `k` by a step of `dt` [s]. The push begins at the parcel's first touch.

    Args:
        scratch: holds the parcel's velocity at the touch, before and after the impulses.
        hit: if true, the whole change of velocity happens at the touch. If false, the velocity
            changes gradually from the touch to the end of the step.
    """
    state, start, met = world.state[k], scratch.start[k], scratch.met[k]
    motion = sd.sweep_between(scratch.before[k], state)
    alone = scratch.since[k]
    rest = dt - alone
    marks = scratch.marks[k]
    vx, vy, omega = implicit_velocity(
        grid,
        world.bodies.body[world.body[k], ph.GYRATION],
        Scratch(scratch.tables[k], marks),
        Contacts(scratch.floor[k], marks[ph.ISOTROPICS], marks[ph.SUPPORTS]),
        rest,
        start[0],
        start[1],
        start[2],
    )
    # The mean velocity, as in the implicit step, if the sides touched before.
    new = 1.0 if hit else 0.5
    old = 1.0 - new
    state[ph.X] = motion.x + alone * motion.vx + rest * (new * vx + old * met[0])
    state[ph.Y] = motion.y + alone * motion.vy + rest * (new * vy + old * met[1])
    state[ph.THETA] = motion.theta + alone * motion.omega + rest * (new * omega + old * met[2])
    state[ph.AX] = (vx - start[0] + met[0] - scratch.before[k, ph.VX]) / dt
    state[ph.AY] = (vy - start[1] + met[1] - scratch.before[k, ph.VY]) / dt
    state[ph.VX] = vx
    state[ph.VY] = vy
    state[ph.OMEGA] = omega


@inlined
def step_world(
    grid: Grid, world: World, material: ContactMaterial, scratch: WorldScratch, dt: float
) -> int:
    """Move every present parcel by one implicit step.

    A parcel whose report is OFF_SURFACE or UNSUPPORTED keeps its state and touches no parcel.

    Returns:
        Number n of pairs that pushed each other. The first n rows of `scratch.pair` are these
        pairs. The first n numbers of `scratch.impulse` are the impulses along the normal.
    """
    for k in range(world.present.shape[0]):
        if world.present[k]:
            state = world.state[k]
            for j in range(ph.STATE_SIZE):
                scratch.before[k, j] = state[j]
            report, contacts = step_implicit(
                grid,
                collision.read_body(world.bodies, world.body[k]),
                state,
                Scratch(scratch.tables[k], scratch.marks[k]),
                dt,
            )
            scratch.report[k] = report
            scratch.floor[k] = contacts.total
            scratch.rotors[k] = contacts.total - contacts.supports
    pairs = collision.find_near_pairs(world, scratch)
    if pairs == 0 or not collision.find_impacts(world, scratch, pairs, dt):
        return 0
    return solve_contacts(grid, world, material, scratch, pairs, dt)
