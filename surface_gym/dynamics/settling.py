"""The velocities of parcels that touch: one convex step for all of a group.

`friction.py` finds the velocity of one parcel as the minimum of a convex potential. Parcels that
touch share one: the sum of theirs, times their masses, and what `sides.py` adds a point.
"""

import math

from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.friction import friction_curvature, friction_gradient
from surface_gym.dynamics.sides import (
    FIRST_X,
    FIRST_Y,
    LIMIT,
    NORMAL_X,
    NORMAL_Y,
    PRESS_STIFFNESS,
    RUB_STIFFNESS,
    SECOND_X,
    SECOND_Y,
    SETTLED,
    Group,
    add_impulse,
    impulses,
    speeds,
    update_impulses,
    weigh_points,
)
from surface_gym.dynamics.solving import clear_matrix, solve
from surface_gym.dynamics.types import GYRATION, MASS, SUPPORTS, Array, Contacts, Scratch

MAX_ROUNDS = 60
HASTY_ROUNDS = 8  # after which limits go half the way, lest they swing
MAX_ITERATIONS = 60
MAX_TRIALS = 40
# A full Newton step may leave this share of the starting slope, a search that.
FULL_STEP_SLOPE = 0.5
SEARCHED_SLOPE = 0.05


@inlined
def bearing_of(group: Group, k: int) -> tuple[Scratch, Contacts]:
    """What bears a parcel."""
    total = group.bearing[k]
    supports = group.marks[k, SUPPORTS] if total > 0 else 0
    return Scratch(group.tables[k], group.marks[k]), Contacts(total, supports)


@linked
def _slope(group: Group, step: float) -> float:
    """Look at the potential `step` along the direction: write its gradient, return its slope."""
    gradient, trial, direction = group.gradient, group.trial, group.direction
    for n in range(group.members):
        k = group.member[n]
        mass = group.bodies.body[group.site[k], MASS]
        gyration = group.bodies.body[group.site[k], GYRATION]
        for axis in range(3):
            trial[k, axis] = group.velocity[k, axis] + step * direction[k, axis]
        scratch, bearing = bearing_of(group, k)
        gx, gy, gw, _ = friction_gradient(scratch, bearing, trial[k, 0], trial[k, 1], trial[k, 2])
        gradient[k, 0] = mass * (gx + trial[k, 0] - group.target[k, 0])
        gradient[k, 1] = mass * (gy + trial[k, 1] - group.target[k, 1])
        gradient[k, 2] = mass * (gw + gyration * (trial[k, 2] - group.target[k, 2]))
    for m in range(group.contacts):
        c = group.contact[m]
        normal, side = speeds(group, c, trial)
        press, rub = impulses(group.point, c, normal, side)
        add_impulse(group, c, press, rub, gradient, -1.0)
    slope = 0.0
    for n in range(group.members):
        k = group.member[n]
        for axis in range(3):
            slope += gradient[k, axis] * direction[k, axis]
    return slope


@inlined
def _add_product(
    matrix: Array,
    i: int,
    j: int,
    stiffness: float,
    first: tuple[float, float, float],
    second: tuple[float, float, float],
) -> None:
    """Add a point's second derivatives with respect to the velocities of two members."""
    for a in range(3):
        for b in range(3):
            matrix[3 * i + a, 3 * j + b] += stiffness * first[a] * second[b]


@inlined
def _add_point(group: Group, c: int, stiffness: float, ex: float, ey: float) -> None:
    """Add what a point adds to the second derivatives, along (ex, ey)."""
    point = group.point
    i = group.slot[group.ends[c, 0]]
    j = group.slot[group.ends[c, 1]]
    first = (-ex, -ey, point[c, FIRST_Y] * ex - point[c, FIRST_X] * ey)
    second = (ex, ey, point[c, SECOND_X] * ey - point[c, SECOND_Y] * ex)
    _add_product(group.matrix, i, i, stiffness, first, first)
    _add_product(group.matrix, j, j, stiffness, second, second)
    if i > j:
        _add_product(group.matrix, i, j, stiffness, first, second)
    else:
        _add_product(group.matrix, j, i, stiffness, second, first)


@linked
def _write_matrix(group: Group) -> None:
    """The lower triangle of the second derivatives, where the gradient was taken last."""
    matrix = group.matrix
    clear_matrix(group)
    velocity, point = group.velocity, group.point
    for n in range(group.members):
        k = group.member[n]
        mass = group.bodies.body[group.site[k], MASS]
        scratch, bearing = bearing_of(group, k)
        hxx, hxy, hxw, hyy, hyw, hww = friction_curvature(
            scratch, bearing, velocity[k, 0], velocity[k, 1], velocity[k, 2]
        )
        at = 3 * n
        matrix[at, at] = mass * (1.0 + hxx)
        matrix[at + 1, at] = mass * hxy
        matrix[at + 1, at + 1] = mass * (1.0 + hyy)
        matrix[at + 2, at] = mass * hxw
        matrix[at + 2, at + 1] = mass * hyw
        matrix[at + 2, at + 2] = mass * (group.bodies.body[group.site[k], GYRATION] + hww)
    for m in range(group.contacts):
        c = group.contact[m]
        nx = point[c, NORMAL_X]
        ny = point[c, NORMAL_Y]
        normal, side = speeds(group, c, velocity)
        press, rub = impulses(point, c, normal, side)
        if press > 0.0:
            _add_point(group, c, point[c, PRESS_STIFFNESS], nx, ny)
        if abs(rub) < point[c, LIMIT]:
            _add_point(group, c, point[c, RUB_STIFFNESS], -ny, nx)


@inlined
def _left(group: Group) -> float:
    """[m/s] of the optimality condition, the most of any member."""
    most = 0.0
    for n in range(group.members):
        k = group.member[n]
        gx, gy, gw = group.gradient[k, 0], group.gradient[k, 1], group.gradient[k, 2]
        radius = math.sqrt(group.bodies.body[group.site[k], GYRATION])
        left = (abs(gx) + abs(gy) + abs(gw) / radius) / group.bodies.body[group.site[k], MASS]
        most = max(most, left)
    return most


@inlined
def _search(group: Group, start: float, end: float) -> None:
    """Look where the slope, which only grows, passes zero between no step and a full one.

    Args:
        start: [J] slope at no step, negative.
        end: [J] at a full one, positive.
    """
    low, high = 0.0, 1.0
    at_low, at_high = start, end
    for _ in range(MAX_TRIALS):
        step = low - at_low * (high - low) / (at_high - at_low)
        slope = _slope(group, step)
        if abs(slope) <= -SEARCHED_SLOPE * start:
            break
        # The end that stays counts half, so that it moves next time (Illinois).
        if slope < 0.0:
            low, at_low, at_high = step, slope, 0.5 * at_high
        else:
            high, at_high, at_low = step, slope, 0.5 * at_low


@linked
def _minimise(group: Group) -> None:
    """Bring the velocities to the minimum of the potential."""
    _slope(group, 0.0)
    for _ in range(MAX_ITERATIONS):
        if _left(group) < SETTLED:
            break
        _write_matrix(group)
        solve(group)
        start = 0.0
        for n in range(group.members):
            k = group.member[n]
            for axis in range(3):
                start += group.gradient[k, axis] * group.direction[k, axis]
        end = _slope(group, 1.0)
        if end > -FULL_STEP_SLOPE * start:
            _search(group, start, end)
        for n in range(group.members):
            k = group.member[n]
            for axis in range(3):
                group.velocity[k, axis] = group.trial[k, axis]


@linked
def settle_group(group: Group, friction: float) -> int:
    """Find the impulses at the points of a group, and the velocities.

    They settle to 1e-9 m/s within some ten rounds; at a friction of 0.8 or more, one group of a
    hundred is left off the limit of friction, by up to 1e-4 m/s. Whatever the rounds, the
    velocities are those that the impulses make.

    Args:
        group: with velocities to begin from, targets and points.
        friction: [-] between sides.

    Returns:
        The rounds that it took.
    """
    weigh_points(group)
    for n in range(group.members):
        for axis in range(3):
            group.direction[group.member[n], axis] = 0.0
    for rounds in range(1, MAX_ROUNDS + 1):
        _minimise(group)
        share = 1.0 if rounds < HASTY_ROUNDS else 0.5
        if update_impulses(group, friction, share) < SETTLED:
            return rounds
    return MAX_ROUNDS
