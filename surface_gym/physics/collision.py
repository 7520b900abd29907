"""Broad phase and contact points of the parcels on one surface."""

import math
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.jit import inlined, linked
from surface_gym.physics import signed_distance as sd, types as ph
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.step import OFF_SURFACE
from surface_gym.physics.types import Array, Bodies, Body, Booleans, Integers, Scratch


class World(NamedTuple):
    """Parcels on one surface, one row per parcel."""

    state: Array  # (P, STATE_SIZE)
    present: Booleans  # (P,) whether the row holds a parcel
    body: Integers  # (P,) row of the parcel in `bodies`
    bodies: Bodies


class ContactMaterial(NamedTuple):
    """Restitution and friction between the sides of parcels."""

    restitution: float  # [-] 0: they stay together; 1: they separate as fast as they met
    friction: float  # [-] between sides


class WorldScratch(NamedTuple):
    """Scratch memory and results of one step of a world of P parcels."""

    tables: Array  # (P, TABLE_SIZE) one `Scratch` per parcel
    marks: Integers  # (P, MARKS_SIZE)
    report: Integers  # (P,) report of each parcel's step alone
    rotors: Integers  # (P,) number of rotors under each parcel
    pair: Integers  # (most pairs, 2) rows of parcels that pushed each other
    impulse: Array  # (most pairs,) [N s] along the normal
    before: Array  # (P, STATE_SIZE) states at the start
    floor: Integers  # (P,) contacts of each parcel with elements
    nothing: Integers  # (P,) zeros: no contacts with elements while sides hit each other
    reach: Array  # (P,) [m] from a centre of mass at the start to its base's farthest point
    place: Array  # (P, 5) `Transform` of each base at the start; [m] a corner moves by turning
    near: Integers  # (most pairs, 2) rows of parcels whose bases may touch
    when: Array  # (most pairs,) [s] time of first touch; infinite if they do not touch
    push: Array  # (most pairs,) [N s] impulse along the normal
    since: Array  # (P,) [s] time of each parcel's first touch; infinite if none
    root: Integers  # (P,) island of each parcel, named by its lowest row
    member: Integers  # (P,) from here to `point`: see `Island`
    slot: Integers  # (P,)
    low: Integers  # (P,)
    contact: Integers  # (most points,)
    ends: Integers  # (most points, 3)
    point: Array  # (most points, POINT_SIZE)
    met: Array  # (P, 3) [m/s, m/s, rad/s] velocities where parcels first touch
    start: Array  # (P, 3) the same plus the impulses between sides
    velocity: Array  # (P, 3)
    target: Array  # (P, 3)
    trial: Array  # (P, 3)
    gradient: Array  # (P, 3)
    direction: Array  # (P, 3)
    matrix: Array  # (3 P, 3 P)


def make_world_scratch(parcels: int) -> WorldScratch:
    """Make scratch memory for a number of parcels. The scratch memory has no contacts yet."""
    n, pairs, points = parcels, parcels * (parcels - 1) // 2, parcels * (parcels - 1)
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(WorldScratch._fields, (n,))
    shapes |= dict.fromkeys(("met", "start", "velocity", "target"), (n, 3))
    shapes |= dict.fromkeys(("trial", "gradient", "direction"), (n, 3))
    shapes |= dict.fromkeys(("pair", "near"), (pairs, 2))
    shapes |= dict.fromkeys(("impulse", "when", "push"), (pairs,))
    shapes |= {"tables": (n, ph.TABLE_SIZE), "marks": (n, ph.MARKS_SIZE)}
    shapes |= {"before": (n, ph.STATE_SIZE), "matrix": (3 * n, 3 * n), "place": (n, 5)}
    shapes |= {"contact": (points,), "ends": (points, 3), "point": (points, ph.POINT_SIZE)}
    kinds = WorldScratch.__annotations__
    arrays: dict[str, Any] = {
        name: np.zeros(shape, np.int64 if kinds[name] is Integers else np.float64)
        for name, shape in shapes.items()
    }
    scratch = WorldScratch(**arrays)
    scratch.marks[:, ph.SPANS] = -1
    return scratch


@inlined
def world_scratch(scratches: WorldScratch, i: int) -> WorldScratch:
    """Return scratch `i` of a stack. A stack's arrays have one row for each scratch."""
    return WorldScratch(
        scratches.tables[i],
        scratches.marks[i],
        scratches.report[i],
        scratches.rotors[i],
        scratches.pair[i],
        scratches.impulse[i],
        scratches.before[i],
        scratches.floor[i],
        scratches.nothing[i],
        scratches.reach[i],
        scratches.place[i],
        scratches.near[i],
        scratches.when[i],
        scratches.push[i],
        scratches.since[i],
        scratches.root[i],
        scratches.member[i],
        scratches.slot[i],
        scratches.low[i],
        scratches.contact[i],
        scratches.ends[i],
        scratches.point[i],
        scratches.met[i],
        scratches.start[i],
        scratches.velocity[i],
        scratches.target[i],
        scratches.trial[i],
        scratches.gradient[i],
        scratches.direction[i],
        scratches.matrix[i],
    )


@inlined
def invalidate_world(scratch: WorldScratch) -> None:
    """Discard all contacts with the surface, after the surface or its axes have changed."""
    for k in range(scratch.marks.shape[0]):
        invalidate_contacts(Scratch(scratch.tables[k], scratch.marks[k]))


@inlined
def read_body(bodies: Bodies, site: int) -> Body:
    """Return row `site` of `bodies` as a `Body`."""
    row = bodies.body[site]
    return Body(
        bodies.edges[site],
        row[ph.RADIUS],
        row[ph.COM_X],
        row[ph.COM_Y],
        row[ph.COM_HEIGHT],
        row[ph.GYRATION],
    )


LEAST_REST = 1e-9  # [s] minimum time that remains in a step after a touch


@inlined
def find_near_pairs(world: World, scratch: WorldScratch) -> int:
    """Write the pairs whose bases may touch in this step (broad phase); return their number."""
    before, after, reach = scratch.before, world.state, scratch.reach
    rows = world.present.shape[0]
    for k in range(rows):
        reach[k] = -math.inf  # an absent parcel touches none
        if world.present[k] and scratch.report[k] < OFF_SURFACE:
            body = world.bodies.body[world.body[k]]
            moved = abs(after[k, ph.X] - before[k, ph.X]) + abs(after[k, ph.Y] - before[k, ph.Y])
            reach[k] = (
                body[ph.RADIUS]
                + abs(body[ph.COM_X])
                + abs(body[ph.COM_Y])
                + moved
                + sd.CONTACT_DISTANCE
            )
    pairs = 0
    for i in range(rows):
        if reach[i] < 0.0:
            continue
        for j in range(i + 1, rows):
            dx = before[i, ph.X] - before[j, ph.X]
            dy = before[i, ph.Y] - before[j, ph.Y]
            most = reach[i] + reach[j]
            if most > 0.0 and dx * dx + dy * dy <= most * most:
                scratch.near[pairs, 0] = i
                scratch.near[pairs, 1] = j
                pairs += 1
    return pairs


@inlined
def add_pushed_pairs(world: World, scratch: WorldScratch, pairs: int) -> int:
    """Add pairs of parcels that are near only because of a push; return the new number of pairs.

    `find_near_pairs` has already found `pairs` near pairs, as if no parcel were pushed. A pushed
    parcel may move farther.
    """
    before, after, reach = scratch.before, world.state, scratch.reach
    rows = world.present.shape[0]
    for i in range(rows):
        if reach[i] < 0.0:
            continue
        for j in range(i + 1, rows):
            most = reach[i] + reach[j]
            dx = after[i, ph.X] - after[j, ph.X]
            dy = after[i, ph.Y] - after[j, ph.Y]
            if most < 0.0 or dx * dx + dy * dy > most * most:
                continue
            dx = before[i, ph.X] - before[j, ph.X]
            dy = before[i, ph.Y] - before[j, ph.Y]
            if dx * dx + dy * dy > most * most:
                scratch.near[pairs, 0] = i
                scratch.near[pairs, 1] = j
                pairs += 1
    return pairs


@inlined
def _place_base(world: World, scratch: WorldScratch, k: int, dt: float) -> None:
    """Write base k's pose at the step's start, and how far [m] a corner can move by rotation."""
    outline = sd.read_outline(world.bodies, world.body[k])
    motion = sd.sweep_between(scratch.before[k], world.state[k])
    pose = sd.transform_at(outline, motion, 0.0)
    farthest = world.bodies.body[world.body[k], ph.RADIUS]
    farthest += abs(outline.com_x) + abs(outline.com_y)
    scratch.place[k, 0] = pose.x
    scratch.place[k, 1] = pose.y
    scratch.place[k, 2] = pose.cosine
    scratch.place[k, 3] = pose.sine
    scratch.place[k, 4] = dt * abs(motion.omega) * farthest


@inlined
def _read_place(scratch: WorldScratch, k: int) -> sd.Transform:
    place = scratch.place[k]
    return sd.Transform(place[0], place[1], place[2], place[3])


@inlined
def find_impacts(world: World, scratch: WorldScratch, pairs: int, dt: float) -> bool:
    """Write islands, and the time of impact of each near pair; return whether any pair touches."""
    bodies, before, after = world.bodies, scratch.before, world.state
    for k in range(world.present.shape[0]):
        scratch.since[k] = math.inf
        scratch.root[k] = k
        if scratch.reach[k] >= 0.0:
            _place_base(world, scratch, k, dt)
    touching = False
    for e in range(pairs):
        i = scratch.near[e, 0]
        j = scratch.near[e, 1]
        first = sd.read_outline(bodies, world.body[i])
        second = sd.read_outline(bodies, world.body[j])
        sweep = sd.sweep_between(before[i], after[i])
        other_sweep = sd.sweep_between(before[j], after[j])
        scratch.when[e] = math.inf
        scratch.push[e] = 0.0
        if sd.stay_clear(
            first,
            _read_place(scratch, i),
            second,
            _read_place(scratch, j),
            dt * (sweep.vx - other_sweep.vx),
            dt * (sweep.vy - other_sweep.vy),
            scratch.place[i, 4] + scratch.place[j, 4],
        ):
            continue
        when = sd.time_of_impact(first, sweep, second, other_sweep, dt)
        scratch.when[e] = when
        if when < math.inf:
            touching = True
            scratch.since[i] = min(scratch.since[i], when)
            scratch.since[j] = min(scratch.since[j], when)
            _join(scratch, i, j)
    return touching


@inlined
def _join(scratch: WorldScratch, i: int, j: int) -> None:
    """Merge the islands of two parcels."""
    root = scratch.root
    first = min(root[i], root[j])
    second = max(root[i], root[j])
    for k in range(root.shape[0]):
        if root[k] == second:
            root[k] = first


@linked
def find_contact_points(world: World, scratch: WorldScratch, pairs: int, dt: float) -> int:
    """Write contact points of the first `pairs` near pairs; return the number of points."""
    bodies, before, after = world.bodies, scratch.before, world.state
    points = 0
    for e in range(pairs):
        when = scratch.when[e]
        if when == math.inf:
            continue
        i = scratch.near[e, 0]
        j = scratch.near[e, 1]
        first = sd.read_outline(bodies, world.body[i])
        second = sd.read_outline(bodies, world.body[j])
        pose = sd.transform_at(first, sd.sweep_between(before[i], after[i]), when)
        other_pose = sd.transform_at(second, sd.sweep_between(before[j], after[j]), when)
        gap = sd.signed_distance(first, pose, second, other_pose)
        manifold = sd.find_manifold(first, pose, second, other_pose, gap)
        rest = max(dt - when, LEAST_REST)
        for n in range(manifold.points):
            x, y, width = manifold.x, manifold.y, manifold.width
            if n == 1:
                x, y, width = manifold.second_x, manifold.second_y, manifold.second_width
            _write_point(world, scratch, points, e, x, y)
            scratch.point[points, ph.NORMAL_X] = gap.nx
            scratch.point[points, ph.NORMAL_Y] = gap.ny
            scratch.point[points, ph.CLOSING] = max(0.0, width - sd.CONTACT_DISTANCE) / rest
            scratch.point[points, ph.NORMAL_TOTAL] = 0.0
            scratch.point[points, ph.TANGENT_TOTAL] = 0.0
            points += 1
    return points


@inlined
def _write_point(world: World, scratch: WorldScratch, c: int, e: int, x: float, y: float) -> None:
    """Write contact point c of near pair e, at (x, y) [m].

    The data of a point are the two parcels, and an arm for each parcel. The arm [m] leads from the
    parcel's centre of mass to the point, at the moment when the parcel is first touched.
    """
    scratch.ends[c, 2] = e
    for end in range(2):
        k = scratch.near[e, end]
        scratch.ends[c, end] = k
        motion = sd.sweep_between(scratch.before[k], world.state[k])
        arm_x = x - motion.x - scratch.since[k] * motion.vx
        arm_y = y - motion.y - scratch.since[k] * motion.vy
        if end == 0:
            scratch.point[c, ph.FIRST_X] = arm_x
            scratch.point[c, ph.FIRST_Y] = arm_y
        else:
            scratch.point[c, ph.SECOND_X] = arm_x
            scratch.point[c, ph.SECOND_Y] = arm_y


@inlined
def gather_island(scratch: WorldScratch, root: int, points: int) -> tuple[int, int]:
    """Write an island's members and contact points; return the numbers of members and points.

    `root` is the lowest row of a member. Only the first `points` points in `scratch` are searched.
    Members are sorted by x, so parcels that touch are close to each other in the list.
    """
    members = 0
    for k in range(scratch.root.shape[0]):
        if scratch.root[k] == root:
            slot = members
            while (
                slot > 0
                and scratch.before[scratch.member[slot - 1], ph.X] > scratch.before[k, ph.X]
            ):
                scratch.member[slot] = scratch.member[slot - 1]
                slot -= 1
            scratch.member[slot] = k
            members += 1
    for slot in range(members):
        scratch.slot[scratch.member[slot]] = slot
    contacts = 0
    for c in range(points):
        if scratch.root[scratch.ends[c, 0]] == root:
            scratch.contact[contacts] = c
            contacts += 1
    return members, contacts
