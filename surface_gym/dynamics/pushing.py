"""What parcels that meet do to each other within a step.

A group is of all who touch, directly or by others. In each of them
    1. sides that close fast rebound, with no time for friction below: the impulses that stop them
       act once more, times the restitution (Poisson's hypothesis, which gains no energy);
    2. the velocities after the step are found, of all at once, so that no sides close on each other
       (`settling.py`), with friction for what the step has left since the touch;
    3. each parcel goes on with its new velocity from where it first touched.
Then what still overlaps is moved apart.
"""

import math

from surface_gym.dynamics.company import Company, TogetherScratch, Touching
from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.friction import implicit_velocity, load_contacts
from surface_gym.dynamics.gap import moving
from surface_gym.dynamics.meeting import find_points, gather
from surface_gym.dynamics.parting import part
from surface_gym.dynamics.settling import bearing_of, settle_group
from surface_gym.dynamics.sides import (
    CLOSING,
    PRESS,
    PRESS_STIFFNESS,
    RUB,
    STIFFNESS,
    Group,
    add_impulse,
    speeds,
)
from surface_gym.dynamics.types import (
    AX,
    AY,
    GYRATION,
    MASS,
    OMEGA,
    SUPPORTS,
    THETA,
    VX,
    VY,
    Array,
    Contacts,
    Grid,
    Integers,
    Scratch,
    X,
    Y,
)

RESTING = 0.02  # [m/s] Sides that close no faster do not rebound.
PUSHED = 1e-8  # [m/s] that an impulse changes a speed by at least, or it is none


@linked
def push(
    grid: Grid,
    company: Company,
    touching: Touching,
    scratch: TogetherScratch,
    pairs: int,
    dt: float,
) -> int:
    """Let those who meet push each other; how many pairs did."""
    points = find_points(company, scratch, pairs, dt)
    for first in range(company.present.shape[0]):
        if scratch.root[first] == first and scratch.since[first] < math.inf:
            members, contacts = gather(scratch, first, points)
            group = _group(company, scratch, scratch.bearing, members, contacts)
            _begin(company, scratch, group, dt)
            hit = _closes_fast(group, scratch.start)
            if hit and touching.restitution > 0.0:
                free = _group(company, scratch, scratch.nothing, members, contacts)
                _rebound(scratch, free, touching)
            _go_on(grid, touching, scratch, group, dt)
            for n in range(members):
                k = scratch.member[n]
                if _is_pushed(scratch, group, k):
                    _advance(grid, company, scratch, k, hit, dt)
    part(company, scratch, pairs)
    pushed = 0
    for e in range(pairs):
        if scratch.push[e] > 0.0:
            scratch.pair[pushed, 0] = scratch.near[e, 0]
            scratch.pair[pushed, 1] = scratch.near[e, 1]
            scratch.impulse[pushed] = scratch.push[e]
            pushed += 1
    return pushed


@inlined
def _group(
    company: Company, scratch: TogetherScratch, bearing: Integers, members: int, contacts: int
) -> Group:
    return Group(
        members,
        contacts,
        company.bodies,
        company.site,
        scratch.tables,
        scratch.marks,
        bearing,
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
def _begin(company: Company, scratch: TogetherScratch, group: Group, dt: float) -> None:
    """Begin with the velocities at which the members of a group come to touch, and with friction
    for what the step has left.
    """
    for n in range(group.members):
        k = group.member[n]
        share = scratch.since[k] / dt
        for axis in range(VX, OMEGA + 1):
            old = scratch.before[k, axis]
            scratch.start[k, axis - VX] = old + share * (company.state[k, axis] - old)
            scratch.velocity[k, axis - VX] = company.state[k, axis]
            scratch.met[k, axis - VX] = scratch.start[k, axis - VX]
        borne, contacts = bearing_of(group, k)
        load_contacts(borne, contacts, dt - scratch.since[k])


@inlined
def _closes_fast(group: Group, start: Array) -> bool:
    """Whether any sides of a group do."""
    for m in range(group.contacts):
        c = group.contact[m]
        normal, _ = speeds(group, c, start)
        if normal + group.point[c, CLOSING] < -RESTING:
            return True
    return False


@inlined
def _take_impulses(scratch: TogetherScratch, group: Group, times: float) -> None:
    """Add the impulses of a group, so many times, to the velocities at the start."""
    change = scratch.gradient
    for n in range(group.members):
        for axis in range(3):
            change[group.member[n], axis] = 0.0
    for m in range(group.contacts):
        c = group.contact[m]
        press = group.point[c, PRESS]
        if press > PUSHED * group.point[c, PRESS_STIFFNESS] / STIFFNESS:
            add_impulse(group, c, press, group.point[c, RUB], change, times)
            scratch.push[group.ends[c, 2]] += times * press
    for n in range(group.members):
        k = group.member[n]
        body = group.bodies.body[group.site[k]]
        scratch.start[k, 0] += change[k, 0] / body[MASS]
        scratch.start[k, 1] += change[k, 1] / body[MASS]
        scratch.start[k, 2] += change[k, 2] / (body[MASS] * body[GYRATION])


@linked
def _rebound(scratch: TogetherScratch, group: Group, touching: Touching) -> None:
    """Stop the sides of a group, and have the impulses that did so act once more."""
    for n in range(group.members):
        k = group.member[n]
        for axis in range(3):
            scratch.target[k, axis] = scratch.start[k, axis]
            scratch.velocity[k, axis] = scratch.start[k, axis]
    settle_group(group, touching.friction)
    _take_impulses(scratch, group, 1.0 + touching.restitution)


@linked
def _go_on(
    grid: Grid, touching: Touching, scratch: TogetherScratch, group: Group, dt: float
) -> None:
    """Find what the sides of a group do while friction acts below."""
    for n in range(group.members):
        k = group.member[n]
        for axis in range(3):
            scratch.target[k, axis] = scratch.start[k, axis]
        scratch.target[k, 0] += (dt - scratch.since[k]) * grid.gravity_along
    settle_group(group, touching.friction)
    _take_impulses(scratch, group, 1.0)


@inlined
def _is_pushed(scratch: TogetherScratch, group: Group, k: int) -> bool:
    """Whether anybody pushes a parcel of a group."""
    for m in range(group.contacts):
        c = group.contact[m]
        ours = group.ends[c, 0] == k or group.ends[c, 1] == k
        if ours and scratch.push[group.ends[c, 2]] > 0.0:
            return True
    return False


@linked
def _advance(
    grid: Grid, company: Company, scratch: TogetherScratch, k: int, hit: bool, dt: float
) -> None:
    """Move a parcel that is pushed: alone until it touches, on with its new velocity.

    Args:
        grid: the surface.
        company: that it is of.
        scratch: with its velocity where it touches, impulses taken in.
        k: its row.
        hit: whether velocities change at the touch, rather than over the step.
        dt: [s] step.
    """
    state, start, met = company.state[k], scratch.start[k], scratch.met[k]
    motion = moving(scratch.before[k], state)
    alone = scratch.since[k]
    rest = dt - alone
    vx, vy, omega = implicit_velocity(
        grid,
        company.bodies.body[company.site[k], GYRATION],
        Scratch(scratch.tables[k], scratch.marks[k]),
        Contacts(scratch.bearing[k], scratch.marks[k, SUPPORTS]),
        rest,
        start[0],
        start[1],
        start[2],
    )
    # The mean, as in the implicit step, where sides that touched before press on.
    new = 1.0 if hit else 0.5
    old = 1.0 - new
    state[X] = motion.x + alone * motion.vx + rest * (new * vx + old * met[0])
    state[Y] = motion.y + alone * motion.vy + rest * (new * vy + old * met[1])
    state[THETA] = motion.theta + alone * motion.omega + rest * (new * omega + old * met[2])
    state[AX] = (vx - start[0] + met[0] - scratch.before[k, VX]) / dt
    state[AY] = (vy - start[1] + met[1] - scratch.before[k, VY]) / dt
    state[VX] = vx
    state[VY] = vy
    state[OMEGA] = omega
