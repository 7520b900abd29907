"""Points at which the sides of parcels touch: impulses from speeds.

To the potential of `settling.py` each point adds
    max(0, P - k (u + a))^2 / 2 k   and   the same of T - k w up to the limit mu P
with u and w the speeds of the second parcel against the first along the normal and along the side,
a the speed at which the point may still close, and P and T the impulses so far. Its derivatives are
the impulses: at the minimum they follow from the velocities. Taken as the next P and T (augmented
Lagrangian) they soon leave no closing speed. The limit of the side's friction lags one such round.
"""

from typing import NamedTuple

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import GYRATION, MASS, Array, Bodies, Integers

# Columns of `Group.point`.
(
    NORMAL_X,  # unit normal from the first parcel to the second; the side is a quarter turn on
    NORMAL_Y,
    FIRST_X,  # [m] arm from the first's centre of mass
    FIRST_Y,
    SECOND_X,  # [m] from the second's
    SECOND_Y,
    CLOSING,  # [m/s] at which the point may close
    PRESS,  # [N s] impulse along the normal
    RUB,  # [N s] along the side
    LIMIT,  # [N s] the most along the side
    PRESS_STIFFNESS,  # [kg] k along the normal
    RUB_STIFFNESS,  # [kg] along the side
) = range(12)
POINT_SIZE = 12

STIFFNESS = 1e5  # [-] k over the mass that an impulse between free parcels moves
SETTLED = 1e-9  # [m/s] left of any condition


class Group(NamedTuple):
    """Parcels that touch, directly or by others; P parcels of a company in all."""

    members: int  # parcels in it
    contacts: int  # points in it
    bodies: Bodies
    site: Integers  # (P,) row of each parcel in `bodies`
    tables: Array  # (P, TABLE_SIZE) what bears each parcel, as its step left it
    marks: Integers  # (P, MARKS_SIZE) the same
    bearing: Integers  # (P,) elements that bear each parcel
    member: Integers  # (P,) which parcels are in it
    slot: Integers  # (P,) the place of each among them
    low: Integers  # (P,) by place: the first of those that it touches, or itself
    contact: Integers  # (most points,) which points are in it
    ends: Integers  # (most points, 3) the parcels each point lies between, and the pair they are
    point: Array  # (most points, POINT_SIZE)
    velocity: Array  # (P, 3) [m/s, m/s, rad/s]
    target: Array  # (P, 3) that each would have if nothing bore it and nobody touched it
    trial: Array  # (P, 3) where the potential was looked at last
    gradient: Array  # (P, 3) [N s, N s, N m s] of it there
    direction: Array  # (P, 3) of a search
    matrix: Array  # (3 P, 3 P) second derivatives, the lower triangle


@inlined
def speeds(group: Group, c: int, velocity: Array) -> tuple[float, float]:
    """Of a point, the second against the first, along the normal and the side."""
    point = group.point
    i = group.ends[c, 0]
    j = group.ends[c, 1]
    ux = velocity[j, 0] - velocity[j, 2] * point[c, SECOND_Y]
    uy = velocity[j, 1] + velocity[j, 2] * point[c, SECOND_X]
    ux -= velocity[i, 0] - velocity[i, 2] * point[c, FIRST_Y]
    uy -= velocity[i, 1] + velocity[i, 2] * point[c, FIRST_X]
    nx = point[c, NORMAL_X]
    ny = point[c, NORMAL_Y]
    return nx * ux + ny * uy, nx * uy - ny * ux


@inlined
def impulses(point: Array, c: int, normal: float, side: float) -> tuple[float, float]:
    """Along the normal and the side, at these speeds of a point."""
    press = point[c, PRESS] - point[c, PRESS_STIFFNESS] * (normal + point[c, CLOSING])
    rub = point[c, RUB] - point[c, RUB_STIFFNESS] * side
    limit = point[c, LIMIT]
    return max(0.0, press), min(limit, max(-limit, rub))


@inlined
def add_impulse(group: Group, c: int, press: float, rub: float, values: Array, sign: float) -> None:
    """Add an impulse at a point to momenta (P, 3) of both parcels, with a sign."""
    point = group.point
    nx = point[c, NORMAL_X]
    ny = point[c, NORMAL_Y]
    px = sign * (press * nx - rub * ny)
    py = sign * (press * ny + rub * nx)
    i = group.ends[c, 0]
    j = group.ends[c, 1]
    values[i, 0] -= px
    values[i, 1] -= py
    values[i, 2] -= point[c, FIRST_X] * py - point[c, FIRST_Y] * px
    values[j, 0] += px
    values[j, 1] += py
    values[j, 2] += point[c, SECOND_X] * py - point[c, SECOND_Y] * px


@inlined
def weigh_points(group: Group) -> None:
    """Write the stiffness of each point, by the mass it moves; no impulses yet."""
    point = group.point
    for m in range(group.contacts):
        c = group.contact[m]
        first = group.bodies.body[group.site[group.ends[c, 0]]]
        second = group.bodies.body[group.site[group.ends[c, 1]]]
        nx = point[c, NORMAL_X]
        ny = point[c, NORMAL_Y]
        per_mass = 1.0 / first[MASS] + 1.0 / second[MASS]
        per_first = 1.0 / (first[MASS] * first[GYRATION])
        per_second = 1.0 / (second[MASS] * second[GYRATION])
        turn = point[c, FIRST_X] * ny - point[c, FIRST_Y] * nx
        twist = point[c, SECOND_X] * ny - point[c, SECOND_Y] * nx
        moved = per_mass + turn * turn * per_first + twist * twist * per_second
        point[c, PRESS_STIFFNESS] = STIFFNESS / moved
        turn = point[c, FIRST_X] * nx + point[c, FIRST_Y] * ny
        twist = point[c, SECOND_X] * nx + point[c, SECOND_Y] * ny
        moved = per_mass + turn * turn * per_first + twist * twist * per_second
        point[c, RUB_STIFFNESS] = STIFFNESS / moved
        point[c, PRESS] = 0.0
        point[c, RUB] = 0.0
        point[c, LIMIT] = 0.0


@inlined
def update_impulses(group: Group, friction: float, share: float) -> float:
    """Take over the impulses at the velocities; [m/s] the most that they left to be done.

    The limits of friction go a share of the way to those of these impulses.
    """
    point = group.point
    most = 0.0
    for m in range(group.contacts):
        c = group.contact[m]
        normal, side = speeds(group, c, group.velocity)
        press, rub = impulses(point, c, normal, side)
        most = max(most, abs(press - point[c, PRESS]) / point[c, PRESS_STIFFNESS])
        limit = friction * press
        if abs(rub) < point[c, LIMIT]:
            most = max(most, abs(rub - point[c, RUB]) / point[c, RUB_STIFFNESS])
        elif abs(rub) > 0.0 or abs(side) > SETTLED:
            change = abs(limit - point[c, LIMIT])
            most = max(most, change * STIFFNESS / point[c, RUB_STIFFNESS])
        point[c, PRESS] = press
        point[c, RUB] = rub
        point[c, LIMIT] += share * (limit - point[c, LIMIT])
    return most
