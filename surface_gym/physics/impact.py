"""Impacts between sides, with restitution and friction.

Restitution acts along the normal by Poisson's hypothesis: the impulse of restitution is e times the
impulse of compression. Coulomb friction acts in both phases. It stops slip and never reverses it;
only the normal impulse can reverse slip, by turning the parcels. A hit at one point is integrated.
A hit at several points is solved phase by phase. Neither method gains energy.
"""

import math

from surface_gym.compiler.jit import inlined, linked
from surface_gym.physics import island as islands, types as ph
from surface_gym.physics.island import Island
from surface_gym.physics.types import Array

PHASES = 4  # maximum: slip stops once, compression ends, restitution ends
MAX_SWEEPS = 100


@inlined
def integrate_impact(
    island: Island, c: int, start: Array, friction: float, restitution: float
) -> tuple[float, float]:
    """Integrate a hit at one point over its normal impulse, by Routh's method.

    While the slip keeps its direction, normal and tangential speed are linear in the normal
    impulse. Once slip has stopped, the sides stick, or the normal impulse makes them slip again
    (Wang and Mason, Journal of Applied Mechanics 59(3), 635-642, 1992).

    Args:
        c: index of the contact point.
        start: (P, 3) velocities before the hit.
        friction: [-] coefficient between sides.
        restitution: [-] ratio of the impulses of restitution and compression.

    Returns:
        Normal and tangential impulse [N s].
    """
    normal, slip = islands.relative_velocity(island, c, start)
    normal += island.point[c, ph.CLOSING]
    by_normal, coupling, by_side = islands.point_mobility(island, c)
    pn = pt = 0.0
    end = math.inf  # [N s] normal impulse of the whole hit; known after compression
    for _ in range(PHASES):
        heading = slip if slip != 0.0 else coupling
        ratio = -math.copysign(friction, heading)
        rate = coupling + by_side * ratio
        if slip == 0.0 and heading * rate <= 0.0:
            ratio = -coupling / by_side
            rate = 0.0
        opening = by_normal + coupling * ratio
        share = end - pn
        stops = slip * rate < 0.0 and -slip / rate < share
        if stops:
            share = -slip / rate
        compressed = end == math.inf and normal + share * opening >= 0.0
        if compressed:
            share = -normal / opening
            stops = False
        pn += share
        pt += share * ratio
        normal += share * opening
        slip = 0.0 if stops else slip + share * rate
        if compressed:
            end = (1.0 + restitution) * pn
        elif not stops:
            break
    return pn, pt


@linked
def part_sides(island: Island, start: Array, friction: float, restitution: float) -> None:
    """Replace an island's impulses of compression by its impulses of restitution, at all points.

    Normal impulses of restitution are normal impulses of compression times the restitution.
    Tangential impulses come from several sweeps over the points (projected Gauss-Seidel). At each
    point, a sweep takes the impulse with the least energy within the friction limit. The sweeps
    start from the tangential impulses of compression times the restitution. This start gains no
    energy, and every sweep reduces the energy. `start` (P, 3) holds the velocities after
    compression.
    """
    point, velocity = island.point, island.velocity
    for n in range(island.members):
        for axis in range(3):
            velocity[island.member[n], axis] = start[island.member[n], axis]
    for m in range(island.contacts):
        c = island.contact[m]
        point[c, ph.NORMAL_IMPULSE] *= restitution
        point[c, ph.TANGENT_IMPULSE] *= restitution
        _push(island, c, point[c, ph.NORMAL_IMPULSE], point[c, ph.TANGENT_IMPULSE])
    for _ in range(MAX_SWEEPS):
        most = 0.0
        for m in range(island.contacts):
            c = island.contact[m]
            _, slip = islands.relative_velocity(island, c, velocity)
            _, _, by_side = islands.point_mobility(island, c)
            limit = friction * point[c, ph.NORMAL_IMPULSE]
            old = point[c, ph.TANGENT_IMPULSE]
            new = min(limit, max(-limit, old - slip / by_side))
            _push(island, c, 0.0, new - old)
            point[c, ph.TANGENT_IMPULSE] = new
            most = max(most, abs(new - old) * by_side)
        if most < islands.VELOCITY_TOLERANCE:
            break


@inlined
def _push(island: Island, c: int, pn: float, pt: float) -> None:
    """Change the velocities of point c's parcels by impulses pn (normal) and pt (tangential)."""
    velocity, point = island.velocity, island.point
    nx = point[c, ph.NORMAL_X]
    ny = point[c, ph.NORMAL_Y]
    px = pn * nx - pt * ny
    py = pn * ny + pt * nx
    for end in range(2):
        k = island.ends[c, end]
        body = island.bodies.body[island.body[k]]
        x = point[c, ph.SECOND_X if end == 1 else ph.FIRST_X]
        y = point[c, ph.SECOND_Y if end == 1 else ph.FIRST_Y]
        per_mass = (1.0 if end == 1 else -1.0) / body[ph.MASS]
        velocity[k, 0] += per_mass * px
        velocity[k, 1] += per_mass * py
        velocity[k, 2] += per_mass * (x * py - y * px) / body[ph.GYRATION]
