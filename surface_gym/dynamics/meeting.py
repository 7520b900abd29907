"""Which parcels meet on the ways that they would go alone: when, where, and in which groups."""

import math

from surface_gym.dynamics.company import Company, TogetherScratch
from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.facing import find_facing
from surface_gym.dynamics.gap import gap_between, moving, outline_of, place_at
from surface_gym.dynamics.impact import TOUCH, time_of_impact
from surface_gym.dynamics.sides import (
    CLOSING,
    FIRST_X,
    FIRST_Y,
    NORMAL_X,
    NORMAL_Y,
    SECOND_X,
    SECOND_Y,
)
from surface_gym.dynamics.step import OFF_SURFACE
from surface_gym.dynamics.types import COM_X, COM_Y, RADIUS, X, Y

LEAST_REST = 1e-9  # [s] that a step has left when two touch


@linked
def find_near(company: Company, scratch: TogetherScratch) -> int:
    """Write which parcels' bases may meet on their ways from `before`; how many pairs."""
    before, after, reach = scratch.before, company.state, scratch.reach
    rows = company.present.shape[0]
    for k in range(rows):
        reach[k] = -math.inf  # whoever is absent or off the surface meets nobody
        if company.present[k] and scratch.report[k] < OFF_SURFACE:
            body = company.bodies.body[company.site[k]]
            moved = abs(after[k, X] - before[k, X]) + abs(after[k, Y] - before[k, Y])
            reach[k] = body[RADIUS] + abs(body[COM_X]) + abs(body[COM_Y]) + moved + TOUCH
    pairs = 0
    for i in range(rows):
        if reach[i] < 0.0:
            continue
        for j in range(i + 1, rows):
            dx = before[i, X] - before[j, X]
            dy = before[i, Y] - before[j, Y]
            most = reach[i] + reach[j]
            if most > 0.0 and dx * dx + dy * dy <= most * most:
                scratch.near[pairs, 0] = i
                scratch.near[pairs, 1] = j
                pairs += 1
    return pairs


@linked
def find_meetings(company: Company, scratch: TogetherScratch, pairs: int, dt: float) -> bool:
    """Write when each near pair touches, since when each parcel does, and the groups of those that
    do; whether any two do.
    """
    bodies, before, after = company.bodies, scratch.before, company.state
    for k in range(company.present.shape[0]):
        scratch.since[k] = math.inf
        scratch.root[k] = k
    meet = False
    for e in range(pairs):
        i = scratch.near[e, 0]
        j = scratch.near[e, 1]
        when = time_of_impact(
            outline_of(bodies, company.site[i]),
            moving(before[i], after[i]),
            outline_of(bodies, company.site[j]),
            moving(before[j], after[j]),
            dt,
        )
        scratch.when[e] = when
        scratch.push[e] = 0.0
        if when < math.inf:
            meet = True
            scratch.since[i] = min(scratch.since[i], when)
            scratch.since[j] = min(scratch.since[j], when)
            _join(scratch, i, j)
    return meet


@inlined
def _join(scratch: TogetherScratch, i: int, j: int) -> None:
    """Make one group of those of two parcels."""
    root = scratch.root
    first = min(root[i], root[j])
    second = max(root[i], root[j])
    for k in range(root.shape[0]):
        if root[k] == second:
            root[k] = first


@linked
def find_points(company: Company, scratch: TogetherScratch, pairs: int, dt: float) -> int:
    """Write the points at which near pairs touch; how many."""
    bodies, before, after = company.bodies, scratch.before, company.state
    points = 0
    for e in range(pairs):
        when = scratch.when[e]
        if when == math.inf:
            continue
        i = scratch.near[e, 0]
        j = scratch.near[e, 1]
        first = outline_of(bodies, company.site[i])
        second = outline_of(bodies, company.site[j])
        place = place_at(first, moving(before[i], after[i]), when)
        at = place_at(second, moving(before[j], after[j]), when)
        gap = gap_between(first, place, second, at)
        facing = find_facing(first, place, second, at, gap)
        rest = max(dt - when, LEAST_REST)
        for n in range(facing.points):
            x, y, width = facing.x, facing.y, facing.width
            if n == 1:
                x, y, width = facing.second_x, facing.second_y, facing.second_width
            _write_point(company, scratch, points, e, x, y)
            scratch.point[points, NORMAL_X] = gap.nx
            scratch.point[points, NORMAL_Y] = gap.ny
            scratch.point[points, CLOSING] = max(0.0, width - TOUCH) / rest
            points += 1
    return points


@inlined
def _write_point(
    company: Company, scratch: TogetherScratch, c: int, e: int, x: float, y: float
) -> None:
    """Write who touches at (x, y), and the arms from where each of them first touches another."""
    scratch.ends[c, 2] = e
    for end in range(2):
        k = scratch.near[e, end]
        scratch.ends[c, end] = k
        motion = moving(scratch.before[k], company.state[k])
        arm_x = x - motion.x - scratch.since[k] * motion.vx
        arm_y = y - motion.y - scratch.since[k] * motion.vy
        if end == 0:
            scratch.point[c, FIRST_X] = arm_x
            scratch.point[c, FIRST_Y] = arm_y
        else:
            scratch.point[c, SECOND_X] = arm_x
            scratch.point[c, SECOND_Y] = arm_y


@inlined
def gather(scratch: TogetherScratch, root: int, points: int) -> tuple[int, int]:
    """Write who is in the group of a root, in the order of x, so that those who touch have places
    near each other, and which points are; how many of both.
    """
    members = 0
    for k in range(scratch.root.shape[0]):
        if scratch.root[k] == root:
            place = members
            while place > 0 and scratch.before[scratch.member[place - 1], X] > scratch.before[k, X]:
                scratch.member[place] = scratch.member[place - 1]
                place -= 1
            scratch.member[place] = k
            members += 1
    for place in range(members):
        scratch.slot[scratch.member[place]] = place
    contacts = 0
    for c in range(points):
        if scratch.root[scratch.ends[c, 0]] == root:
            scratch.contact[contacts] = c
            contacts += 1
    return members, contacts
