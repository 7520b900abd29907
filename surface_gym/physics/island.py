"""Velocities of an island of touching parcels, solved as one convex problem.

`friction.py` finds the velocity of one parcel as the minimum of a convex potential. Parcels that
touch share one potential: the sum of their own potentials times their masses, plus for each contact
point
    max(0, P - k (u + a))^2 / 2 k   and the same for T - k w up to the limit mu P
with u and w the normal and tangential velocity of the second parcel relative to the first, a the
allowed closing speed, k the stiffness, and P and T the normal and tangential impulse so far. The
derivatives of these terms are impulses, which become the next P and T (augmented Lagrangian). After
a few rounds no closing speed remains. The friction limit lags by one round.

The Newton direction comes from a symmetric system, solved by a Cholesky factorisation. Parcels that
do not touch share no derivatives. Each member's rows begin at its first touching member,
`Island.low`, and the factors fill no more than these rows.
"""

import math
from typing import NamedTuple

from surface_gym.compiler.jit import inlined, linked
from surface_gym.physics import types as ph
from surface_gym.physics.friction import friction_curvature, friction_gradient
from surface_gym.physics.types import Array, Bodies, Contacts, Integers, Scratch

STIFFNESS = 1e5  # [-] k divided by the effective mass of two free parcels
VELOCITY_TOLERANCE = 1e-9  # [m/s] maximum residual of any condition


class Island(NamedTuple):
    """Parcels that touch directly or through other parcels. The world has P parcels in total."""

    members: int  # number of parcels in the island
    contacts: int  # number of contact points in the island
    bodies: Bodies
    body: Integers  # (P,) row of each parcel in `bodies`
    tables: Array  # (P, TABLE_SIZE) contacts with elements after each parcel's step alone
    marks: Integers  # (P, MARKS_SIZE) the same
    floor: Integers  # (P,) contacts of each parcel with elements
    member: Integers  # (P,) rows of the island's parcels in the world
    slot: Integers  # (P,) index of each parcel in `member`
    low: Integers  # (P,) by slot: the first slot it touches, or its own
    contact: Integers  # (most points,) indices of the island's points
    ends: Integers  # (most points, 3) the two parcels of each point, and their pair
    point: Array  # (most points, POINT_SIZE)
    velocity: Array  # (P, 3) [m/s, m/s, rad/s]
    target: Array  # (P, 3) velocity without friction and contacts
    trial: Array  # (P, 3) velocity of the last evaluation
    gradient: Array  # (P, 3) [N s, N s, N m s] gradient of the potential at `trial`
    direction: Array  # (P, 3) direction of the line search
    matrix: Array  # (3 P, 3 P) second derivatives, the lower triangle


@inlined
def relative_velocity(island: Island, c: int, velocity: Array) -> tuple[float, float]:
    """Return the normal and the tangential relative velocity [m/s] at contact point c.

    At `c`, the relative velocity is the second parcel's velocity minus the first parcel's velocity.
    `velocity` (P, 3) holds the velocities of all parcels.
    """
    point = island.point
    i = island.ends[c, 0]
    j = island.ends[c, 1]
    ux = velocity[j, 0] - velocity[j, 2] * point[c, ph.SECOND_Y]
    uy = velocity[j, 1] + velocity[j, 2] * point[c, ph.SECOND_X]
    ux -= velocity[i, 0] - velocity[i, 2] * point[c, ph.FIRST_Y]
    uy -= velocity[i, 1] + velocity[i, 2] * point[c, ph.FIRST_X]
    nx = point[c, ph.NORMAL_X]
    ny = point[c, ph.NORMAL_Y]
    return nx * ux + ny * uy, nx * uy - ny * ux


@inlined
def contact_impulse(point: Array, c: int, normal: float, side: float) -> tuple[float, float]:
    """Return point c's normal and tangential impulse at a velocity (`normal`, `side`) [m/s]."""
    pn = point[c, ph.NORMAL_IMPULSE] - point[c, ph.NORMAL_STIFFNESS] * (
        normal + point[c, ph.CLOSING]
    )
    pt = point[c, ph.TANGENT_IMPULSE] - point[c, ph.TANGENT_STIFFNESS] * side
    limit = point[c, ph.FRICTION_LIMIT]
    return max(0.0, pn), min(limit, max(-limit, pt))


@inlined
def add_impulse(island: Island, c: int, pn: float, pt: float, values: Array, sign: float) -> None:
    """Add an impulse at contact point `c` to the momenta `values`, shape (parcels, 3).

    The normal part of the impulse is `sign * pn` [N s]. The tangential part is `sign * pt` [N s].
    """
    point = island.point
    nx = point[c, ph.NORMAL_X]
    ny = point[c, ph.NORMAL_Y]
    px = sign * (pn * nx - pt * ny)
    py = sign * (pn * ny + pt * nx)
    i = island.ends[c, 0]
    j = island.ends[c, 1]
    values[i, 0] -= px
    values[i, 1] -= py
    values[i, 2] -= point[c, ph.FIRST_X] * py - point[c, ph.FIRST_Y] * px
    values[j, 0] += px
    values[j, 1] += py
    values[j, 2] += point[c, ph.SECOND_X] * py - point[c, ph.SECOND_Y] * px


@inlined
def point_mobility(island: Island, c: int) -> tuple[float, float, float]:
    """Return the relative speeds per unit impulse [1/kg] at point `c` between two parcels.

    No other force acts on the parcels. The three values are the normal speed per normal impulse,
    the tangential speed per normal impulse, and the tangential speed per tangential impulse.
    """
    point = island.point
    first = island.bodies.body[island.body[island.ends[c, 0]]]
    second = island.bodies.body[island.body[island.ends[c, 1]]]
    nx = point[c, ph.NORMAL_X]
    ny = point[c, ph.NORMAL_Y]
    per_mass = 1.0 / first[ph.MASS] + 1.0 / second[ph.MASS]
    per_first = 1.0 / (first[ph.MASS] * first[ph.GYRATION])
    per_second = 1.0 / (second[ph.MASS] * second[ph.GYRATION])
    turn = point[c, ph.FIRST_X] * ny - point[c, ph.FIRST_Y] * nx
    twist = point[c, ph.SECOND_X] * ny - point[c, ph.SECOND_Y] * nx
    turn_by_side = point[c, ph.FIRST_X] * nx + point[c, ph.FIRST_Y] * ny
    twist_by_side = point[c, ph.SECOND_X] * nx + point[c, ph.SECOND_Y] * ny
    return (
        per_mass + turn * turn * per_first + twist * twist * per_second,
        turn * turn_by_side * per_first + twist * twist_by_side * per_second,
        per_mass
        + turn_by_side * turn_by_side * per_first
        + twist_by_side * twist_by_side * per_second,
    )


@inlined
def set_contact_stiffness(island: Island) -> None:
    """Set the stiffness of each point from the point's effective mass; set all impulses to zero."""
    point = island.point
    for m in range(island.contacts):
        c = island.contact[m]
        normal, _, side = point_mobility(island, c)
        point[c, ph.NORMAL_STIFFNESS] = STIFFNESS / normal
        point[c, ph.TANGENT_STIFFNESS] = STIFFNESS / side
        point[c, ph.NORMAL_IMPULSE] = 0.0
        point[c, ph.TANGENT_IMPULSE] = 0.0
        point[c, ph.FRICTION_LIMIT] = 0.0


@inlined
def update_impulses(island: Island, friction: float, share: float) -> float:
    """Compute the impulses at the island's velocities; return the largest residual [m/s].

    The friction limit of a point moves towards `friction` times the new normal impulse. The
    limit moves by the part `share` [-] of the difference.
    """
    point = island.point
    most = 0.0
    for m in range(island.contacts):
        c = island.contact[m]
        normal, side = relative_velocity(island, c, island.velocity)
        pn, pt = contact_impulse(point, c, normal, side)
        most = max(most, abs(pn - point[c, ph.NORMAL_IMPULSE]) / point[c, ph.NORMAL_STIFFNESS])
        limit = friction * pn
        if abs(pt) < point[c, ph.FRICTION_LIMIT]:
            most = max(
                most, abs(pt - point[c, ph.TANGENT_IMPULSE]) / point[c, ph.TANGENT_STIFFNESS]
            )
        elif abs(pt) > 0.0 or abs(side) > VELOCITY_TOLERANCE:
            change = abs(limit - point[c, ph.FRICTION_LIMIT])
            most = max(most, change * STIFFNESS / point[c, ph.TANGENT_STIFFNESS])
        point[c, ph.NORMAL_IMPULSE] = pn
        point[c, ph.TANGENT_IMPULSE] = pt
        point[c, ph.FRICTION_LIMIT] += share * (limit - point[c, ph.FRICTION_LIMIT])
    return most


@inlined
def clear_matrix(island: Island) -> None:
    """Compute `island.low`, and set the used entries of the matrix's lower triangle to zero.

    The number `low[n]` is the lowest index among member n and the members that touch member n. A
    member has three rows and three columns of the matrix. In the rows of member n, only the columns
    of the members `low[n]` to n are used.
    """
    low = island.low
    for n in range(island.members):
        low[n] = n
    for m in range(island.contacts):
        c = island.contact[m]
        i = island.slot[island.ends[c, 0]]
        j = island.slot[island.ends[c, 1]]
        low[max(i, j)] = min(low[max(i, j)], min(i, j))
    for row in range(3 * island.members):
        for column in range(3 * low[row // 3], row + 1):
            island.matrix[row, column] = 0.0


@inlined
def _factorise(island: Island) -> None:
    """Factorise the matrix by Cholesky, in place."""
    matrix, low = island.matrix, island.low
    for row in range(3 * island.members):
        first = 3 * low[row // 3]
        for column in range(first, row + 1):
            value = matrix[row, column]
            for k in range(max(first, 3 * low[column // 3]), column):
                value -= matrix[row, k] * matrix[column, k]
            if row == column:
                matrix[row, row] = math.sqrt(value)
            else:
                matrix[row, column] = value / matrix[column, column]


@linked
def solve_direction(island: Island) -> None:
    """Write the Newton direction to `direction`. The computation overwrites the array `matrix`."""
    matrix, low, direction, member = island.matrix, island.low, island.direction, island.member
    _factorise(island)
    size = 3 * island.members
    for row in range(size):
        value = -island.gradient[member[row // 3], row % 3]
        for k in range(3 * low[row // 3], row):
            value -= matrix[row, k] * direction[member[k // 3], k % 3]
        direction[member[row // 3], row % 3] = value / matrix[row, row]
    for row in range(size - 1, -1, -1):
        value = direction[member[row // 3], row % 3] / matrix[row, row]
        direction[member[row // 3], row % 3] = value
        for k in range(3 * low[row // 3], row):
            direction[member[k // 3], k % 3] -= matrix[row, k] * value


MAX_ROUNDS = 60
FULL_ROUNDS = 8  # later rounds move the limits half the way, so that they do not oscillate
MAX_ITERATIONS = 60
MAX_TRIALS = 40
# Accepted share of the starting slope after a full Newton step, and after a search.
FULL_STEP_SLOPE = 0.5
SEARCHED_SLOPE = 0.05


@inlined
def floor_contacts(island: Island, k: int) -> tuple[Scratch, Contacts]:
    """Return the contacts between the elements and the parcel in row `k`."""
    total = island.floor[k]
    isotropic = island.marks[k, ph.ISOTROPICS] if total > 0 else 0
    supports = island.marks[k, ph.SUPPORTS] if total > 0 else 0
    return Scratch(island.tables[k], island.marks[k]), Contacts(total, isotropic, supports)


@linked
def _slope(island: Island, step: float) -> float:
    """Write the potential's gradient after a `step`; return the slope [J] along `direction`."""
    gradient, trial, direction = island.gradient, island.trial, island.direction
    for n in range(island.members):
        k = island.member[n]
        mass = island.bodies.body[island.body[k], ph.MASS]
        gyration = island.bodies.body[island.body[k], ph.GYRATION]
        for axis in range(3):
            trial[k, axis] = island.velocity[k, axis] + step * direction[k, axis]
        scratch, floor = floor_contacts(island, k)
        gx, gy, gw, _ = friction_gradient(scratch, floor, trial[k, 0], trial[k, 1], trial[k, 2])
        gradient[k, 0] = mass * (gx + trial[k, 0] - island.target[k, 0])
        gradient[k, 1] = mass * (gy + trial[k, 1] - island.target[k, 1])
        gradient[k, 2] = mass * (gw + gyration * (trial[k, 2] - island.target[k, 2]))
    for m in range(island.contacts):
        c = island.contact[m]
        normal, side = relative_velocity(island, c, trial)
        pn, pt = contact_impulse(island.point, c, normal, side)
        add_impulse(island, c, pn, pt, gradient, -1.0)
    slope = 0.0
    for n in range(island.members):
        k = island.member[n]
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
    """Add `stiffness` times the outer product of `first` and `second` to block (i, j)."""
    for a in range(3):
        for b in range(3):
            matrix[3 * i + a, 3 * j + b] += stiffness * first[a] * second[b]


@inlined
def _add_point(island: Island, c: int, stiffness: float, ex: float, ey: float) -> None:
    """Add contact point `c` to the Hessian, with its `stiffness` [kg] along (ex, ey)."""
    point = island.point
    i = island.slot[island.ends[c, 0]]
    j = island.slot[island.ends[c, 1]]
    first = (-ex, -ey, point[c, ph.FIRST_Y] * ex - point[c, ph.FIRST_X] * ey)
    second = (ex, ey, point[c, ph.SECOND_X] * ey - point[c, ph.SECOND_Y] * ex)
    _add_product(island.matrix, i, i, stiffness, first, first)
    _add_product(island.matrix, j, j, stiffness, second, second)
    if i > j:
        _add_product(island.matrix, i, j, stiffness, first, second)
    else:
        _add_product(island.matrix, j, i, stiffness, second, first)


@linked
def _write_matrix(island: Island) -> None:
    """Write the potential's Hessian (lower triangle) at the velocities that `_slope` used last."""
    matrix = island.matrix
    clear_matrix(island)
    velocity, point = island.velocity, island.point
    for n in range(island.members):
        k = island.member[n]
        mass = island.bodies.body[island.body[k], ph.MASS]
        scratch, floor = floor_contacts(island, k)
        hxx, hxy, hxw, hyy, hyw, hww = friction_curvature(scratch, floor)
        at = 3 * n
        matrix[at, at] = mass * (1.0 + hxx)
        matrix[at + 1, at] = mass * hxy
        matrix[at + 1, at + 1] = mass * (1.0 + hyy)
        matrix[at + 2, at] = mass * hxw
        matrix[at + 2, at + 1] = mass * hyw
        matrix[at + 2, at + 2] = mass * (island.bodies.body[island.body[k], ph.GYRATION] + hww)
    for m in range(island.contacts):
        c = island.contact[m]
        nx = point[c, ph.NORMAL_X]
        ny = point[c, ph.NORMAL_Y]
        normal, side = relative_velocity(island, c, velocity)
        pn, pt = contact_impulse(point, c, normal, side)
        if pn > 0.0:
            _add_point(island, c, point[c, ph.NORMAL_STIFFNESS], nx, ny)
        if abs(pt) < point[c, ph.FRICTION_LIMIT]:
            _add_point(island, c, point[c, ph.TANGENT_STIFFNESS], -ny, nx)


@inlined
def _residual(island: Island) -> float:
    """Return the largest residual [m/s] of the optimality condition, over the island's parcels."""
    most = 0.0
    for n in range(island.members):
        k = island.member[n]
        gx, gy, gw = island.gradient[k, 0], island.gradient[k, 1], island.gradient[k, 2]
        radius = math.sqrt(island.bodies.body[island.body[k], ph.GYRATION])
        residual = (abs(gx) + abs(gy) + abs(gw) / radius) / island.bodies.body[
            island.body[k], ph.MASS
        ]
        most = max(most, residual)
    return most


@inlined
def _search(island: Island, start: float, end: float) -> None:
    """Find the step length in (0, 1) at which the potential's slope is nearly zero (line search).

    The array `trial` gets the velocities at this step length. The slope grows with the step length.

    Args:
        start: [J] slope at step length 0, negative.
        end: [J] slope at step length 1, positive.
    """
    low, high = 0.0, 1.0
    at_low, at_high = start, end
    for _ in range(MAX_TRIALS):
        step = low - at_low * (high - low) / (at_high - at_low)
        slope = _slope(island, step)
        if abs(slope) <= -SEARCHED_SLOPE * start:
            break
        # Halve the value of the end that stays (Illinois method), so that it moves next time.
        if slope < 0.0:
            low, at_low, at_high = step, slope, 0.5 * at_high
        else:
            high, at_high, at_low = step, slope, 0.5 * at_low


@linked
def _minimise(island: Island) -> None:
    """Move the velocities to the minimum of the potential."""
    _slope(island, 0.0)
    for _ in range(MAX_ITERATIONS):
        if _residual(island) < VELOCITY_TOLERANCE:
            break
        _write_matrix(island)
        solve_direction(island)
        start = 0.0
        for n in range(island.members):
            k = island.member[n]
            for axis in range(3):
                start += island.gradient[k, axis] * island.direction[k, axis]
        end = _slope(island, 1.0)
        if end > -FULL_STEP_SLOPE * start:
            _search(island, start, end)
        for n in range(island.members):
            k = island.member[n]
            for axis in range(3):
                island.velocity[k, axis] = island.trial[k, axis]


@linked
def solve_velocities(island: Island, friction: float) -> int:
    """Solve an island's impulses and velocities together; return the number of rounds.

    The residual falls to 1e-9 m/s in about ten rounds. If the friction coefficient is 0.8 or more,
    one island in a hundred keeps a residual of up to 1e-4 m/s: the friction limit of a sliding
    contact differs from `friction` times the normal impulse. Even then, the velocities follow
    exactly from the impulses.
    """
    set_contact_stiffness(island)
    for n in range(island.members):
        for axis in range(3):
            island.direction[island.member[n], axis] = 0.0
    for rounds in range(1, MAX_ROUNDS + 1):
        _minimise(island)
        share = 1.0 if rounds < FULL_ROUNDS else 0.5
        if update_impulses(island, friction, share) < VELOCITY_TOLERANCE:
            return rounds
    return MAX_ROUNDS
