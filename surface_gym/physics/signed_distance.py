"""Signed distance, contact manifold and time of impact of two bases.

A base is a convex polygon with corners, or a disc: a point with a radius. Two polygons are separate
if and only if the normal of one of their edges separates them, so the sign of their distance is
exact. If a corner faces a corner, the true distance is larger than the distance computed here.
"""

import math
from typing import NamedTuple

from surface_gym.compiler.jit import inlined, linked
from surface_gym.physics import types as ph
from surface_gym.physics.types import Array, Bodies


class BaseOutline(NamedTuple):
    """Outline of a base in its own frame."""

    # (corners, 2) [m] from the centroid, anti-clockwise; repeated corners add no edge
    corners: Array
    edges: Array  # (edges, 3) outward normal and distance [m] from the centroid; a disc has none
    disc: float  # [m] radius of a disc, whose corners lie at the centroid; 0 for a polygon
    com_x: float  # [m] centre of mass from the centroid
    com_y: float  # [m]


class StepMotion(NamedTuple):
    """Motion of a centre of mass through a step: a start and a velocity."""

    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


class Transform(NamedTuple):
    """Pose of a base."""

    x: float  # [m] of its centroid
    y: float  # [m]
    cosine: float  # of its angle
    sine: float


class SignedDistance(NamedTuple):
    """Distance, normal and closest features of two bases."""

    width: float  # [m] negative where they overlap
    nx: float  # unit normal from the first to the second
    ny: float
    edge: int  # closest edge, counted over the first base and then over the second; -1: none


@inlined
def read_outline(bodies: Bodies, site: int) -> BaseOutline:
    """Read the outline of the base in row `site` of the bodies."""
    corners = bodies.corners[site]
    is_disc = corners[0, 0] == 0.0 and corners[0, 1] == 0.0
    return BaseOutline(
        corners,
        bodies.edges[site],
        bodies.body[site, ph.RADIUS] if is_disc else 0.0,
        bodies.body[site, ph.COM_X],
        bodies.body[site, ph.COM_Y],
    )


@inlined
def transform_at(outline: BaseOutline, motion: StepMotion, time: float) -> Transform:
    """Return the pose of a base at a time [s] of its motion."""
    theta = motion.theta + time * motion.omega
    cosine = math.cos(theta)
    sine = math.sin(theta)
    return Transform(
        motion.x + time * motion.vx - cosine * outline.com_x + sine * outline.com_y,
        motion.y + time * motion.vy - sine * outline.com_x - cosine * outline.com_y,
        cosine,
        sine,
    )


@inlined
def sweep_at_rest(state: Array) -> StepMotion:
    """Return the motion of a parcel that stays at its state's pose."""
    return StepMotion(state[ph.X], state[ph.Y], state[ph.THETA], 0.0, 0.0, 0.0)


@inlined
def sweep_between(before: Array, after: Array) -> StepMotion:
    """Return a motion from the pose in `before`, at the mean velocity of the two states."""
    return StepMotion(
        before[ph.X],
        before[ph.Y],
        before[ph.THETA],
        0.5 * (before[ph.VX] + after[ph.VX]),
        0.5 * (before[ph.VY] + after[ph.VY]),
        0.5 * (before[ph.OMEGA] + after[ph.OMEGA]),
    )


@inlined
def next_corner(corners: Array, k: int) -> int:
    """Return the index of the corner after corner k."""
    return k + 1 if k + 1 < corners.shape[0] else 0


@inlined
def _separating_edge(
    outline: BaseOutline, pose: Transform, other: BaseOutline, other_pose: Transform
) -> SignedDistance:
    """Return the greatest distance from an edge of the base `outline` to the base `other`.

    An edge's distance is measured outwards, from the edge's line to the nearest corner of `other`.
    """
    corners = outline.corners
    width = -math.inf
    nx = ny = 0.0
    edge = -1
    for k in range(corners.shape[0]):
        end = next_corner(corners, k)
        side_x = corners[end, 0] - corners[k, 0]
        side_y = corners[end, 1] - corners[k, 1]
        length = math.sqrt(side_x * side_x + side_y * side_y)
        if length == 0.0:
            continue
        own_x = side_y / length
        own_y = -side_x / length
        x = pose.cosine * own_x - pose.sine * own_y
        y = pose.sine * own_x + pose.cosine * own_y
        turned_x = other_pose.cosine * x + other_pose.sine * y
        turned_y = other_pose.cosine * y - other_pose.sine * x
        nearest = math.inf
        for j in range(other.corners.shape[0]):
            nearest = min(nearest, turned_x * other.corners[j, 0] + turned_y * other.corners[j, 1])
        beyond = x * (other_pose.x - pose.x) + y * (other_pose.y - pose.y) + nearest
        beyond -= own_x * corners[k, 0] + own_y * corners[k, 1]
        if beyond > width:
            width, nx, ny, edge = beyond, x, y, k
    return SignedDistance(width, nx, ny, edge)


@inlined
def _to_point(
    outline: BaseOutline, pose: Transform, x: float, y: float
) -> tuple[float, float, float]:
    """Return distance [m] and unit normal from a polygon to a point (x, y) outside the polygon."""
    corners = outline.corners
    dx = pose.cosine * (x - pose.x) + pose.sine * (y - pose.y)
    dy = pose.cosine * (y - pose.y) - pose.sine * (x - pose.x)
    least = math.inf
    nx = ny = 0.0
    for k in range(corners.shape[0]):
        end = next_corner(corners, k)
        side_x = corners[end, 0] - corners[k, 0]
        side_y = corners[end, 1] - corners[k, 1]
        from_x = dx - corners[k, 0]
        from_y = dy - corners[k, 1]
        square = side_x * side_x + side_y * side_y
        along = 0.0
        if square > 0.0:
            along = min(1.0, max(0.0, (from_x * side_x + from_y * side_y) / square))
        from_x -= along * side_x
        from_y -= along * side_y
        distance = from_x * from_x + from_y * from_y
        if distance < least:
            least, nx, ny = distance, from_x, from_y
    least = math.sqrt(least)
    nx /= least
    ny /= least
    return least, pose.cosine * nx - pose.sine * ny, pose.sine * nx + pose.cosine * ny


@inlined
def _polygon_to_disc(
    polygon: BaseOutline, pose: Transform, disc: BaseOutline, other_pose: Transform
) -> SignedDistance:
    inside = _separating_edge(polygon, pose, disc, other_pose)
    width, nx, ny = inside.width, inside.nx, inside.ny
    if width > 0.0:
        width, nx, ny = _to_point(polygon, pose, other_pose.x, other_pose.y)
    return SignedDistance(width - disc.disc, nx, ny, -1)


@linked
def signed_distance(
    first: BaseOutline, pose: Transform, second: BaseOutline, other_pose: Transform
) -> SignedDistance:
    """Return the signed distance from one base to another, at their poses."""
    if first.disc > 0.0 and second.disc > 0.0:
        nx = other_pose.x - pose.x
        ny = other_pose.y - pose.y
        distance = math.sqrt(nx * nx + ny * ny)
        if distance == 0.0:
            return SignedDistance(-first.disc - second.disc, 1.0, 0.0, -1)
        return SignedDistance(distance - first.disc - second.disc, nx / distance, ny / distance, -1)
    if second.disc > 0.0:
        return _polygon_to_disc(first, pose, second, other_pose)
    if first.disc > 0.0:
        back = _polygon_to_disc(second, other_pose, first, pose)
        return SignedDistance(back.width, -back.nx, -back.ny, -1)
    gap = _separating_edge(first, pose, second, other_pose)
    back = _separating_edge(second, other_pose, first, pose)
    if back.width > gap.width:
        return SignedDistance(back.width, -back.nx, -back.ny, first.corners.shape[0] + back.edge)
    return gap


@inlined
def facing_gap(
    outline: BaseOutline, pose: Transform, other: BaseOutline, other_pose: Transform
) -> SignedDistance:
    """Return the distance from one edge of a base to the `other` base.

    The edge faces the other base's centroid. `signed_distance` checks all edges and takes longer.
    The result of `signed_distance` is never smaller than the result of `facing_gap`.
    """
    dx = other_pose.x - pose.x
    dy = other_pose.y - pose.y
    own_x = pose.cosine * dx + pose.sine * dy
    own_y = pose.cosine * dy - pose.sine * dx
    edges = outline.edges
    most = -math.inf
    edge = 0
    for k in range(edges.shape[0]):
        beyond = edges[k, 0] * own_x + edges[k, 1] * own_y - edges[k, 2]
        if beyond > most:
            most = beyond
            edge = k
    nx = pose.cosine * edges[edge, 0] - pose.sine * edges[edge, 1]
    ny = pose.sine * edges[edge, 0] + pose.cosine * edges[edge, 1]
    turned_x = other_pose.cosine * nx + other_pose.sine * ny
    turned_y = other_pose.cosine * ny - other_pose.sine * nx
    nearest = math.inf
    for j in range(other.corners.shape[0]):
        nearest = min(nearest, turned_x * other.corners[j, 0] + turned_y * other.corners[j, 1])
    return SignedDistance(most + nearest - other.disc, nx, ny, -1)


CLEAR = 1e-4  # [m] margin beyond an edge at which `signed_distance` finds no touch either


@inlined
def stay_clear(
    first: BaseOutline,
    pose: Transform,
    second: BaseOutline,
    other_pose: Transform,
    ux: float,
    uy: float,
    turning: float,
) -> bool:
    """Return True if a quick test shows that two bases stay apart during a motion.

    The test measures two gaps. Each gap is between one edge of a base and the other base. So the
    result can be False although the bases stay apart.

    Args:
        ux, uy: [m] motion of the first base relative to the second base.
        turning: [m] maximum decrease of the gap due to turning.
    """
    gap = facing_gap(first, pose, second, other_pose)
    if max(0.0, gap.nx * ux + gap.ny * uy + turning) < gap.width - CLEAR:
        return True
    gap = facing_gap(second, other_pose, first, pose)
    return max(0.0, turning - gap.nx * ux - gap.ny * uy) < gap.width - CLEAR


class Manifold(NamedTuple):
    """Contact manifold: up to two points midway between two bases."""

    points: int
    x: float  # [m]
    y: float  # [m]
    width: float  # [m] width of the gap at the point
    second_x: float  # [m]
    second_y: float  # [m]
    second_width: float  # [m]


@inlined
def _corner(outline: BaseOutline, pose: Transform, k: int) -> tuple[float, float]:
    x, y = outline.corners[k, 0], outline.corners[k, 1]
    return (pose.x + pose.cosine * x - pose.sine * y, pose.y + pose.sine * x + pose.cosine * y)


@inlined
def _opposite_edge(outline: BaseOutline, pose: Transform, nx: float, ny: float) -> int:
    """Return the edge whose normal is most opposed to (nx, ny), a vector in the world's frame."""
    corners = outline.corners
    own_x = pose.cosine * nx + pose.sine * ny
    own_y = pose.cosine * ny - pose.sine * nx
    least = math.inf
    edge = 0
    for k in range(corners.shape[0]):
        end = next_corner(corners, k)
        side_x = corners[end, 0] - corners[k, 0]
        side_y = corners[end, 1] - corners[k, 1]
        length = math.sqrt(side_x * side_x + side_y * side_y)
        if length > 0.0 and (side_y * own_x - side_x * own_y) / length < least:
            least = (side_y * own_x - side_x * own_y) / length
            edge = k
    return edge


@inlined
def _facing_edges(
    outline: BaseOutline,
    pose: Transform,
    edge: int,
    other: BaseOutline,
    other_pose: Transform,
    nx: float,
    ny: float,
) -> Manifold:
    """Return contact points between `edge`, with normal (nx, ny), and `other`'s opposite edge."""
    x0, y0 = _corner(outline, pose, edge)
    x1, y1 = _corner(outline, pose, next_corner(outline.corners, edge))
    length = math.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
    across = _opposite_edge(other, other_pose, nx, ny)
    ax, ay = _corner(other, other_pose, across)
    bx, by = _corner(other, other_pose, next_corner(other.corners, across))
    # Coordinates along the edge, which runs along (-ny, nx), and away from it.
    a_along = nx * (ay - y0) - ny * (ax - x0)
    b_along = nx * (by - y0) - ny * (bx - x0)
    a_away = nx * (ax - x0) + ny * (ay - y0)
    b_away = nx * (bx - x0) + ny * (by - y0)
    if max(a_along, b_along) < 0.0 or min(a_along, b_along) > length or a_along == b_along:
        if b_away < a_away:
            a_along, a_away = b_along, b_away
        half = 0.5 * a_away
        return Manifold(
            1, x0 - ny * a_along + nx * half, y0 + nx * a_along + ny * half, a_away, 0.0, 0.0, 0.0
        )
    rise = (b_away - a_away) / (b_along - a_along)
    first = min(length, max(0.0, a_along))
    second = min(length, max(0.0, b_along))
    b_away = a_away + rise * (second - a_along)
    a_away += rise * (first - a_along)
    return Manifold(
        2,
        x0 - ny * first + 0.5 * a_away * nx,
        y0 + nx * first + 0.5 * a_away * ny,
        a_away,
        x0 - ny * second + 0.5 * b_away * nx,
        y0 + nx * second + 0.5 * b_away * ny,
        b_away,
    )


@linked
def find_manifold(
    first: BaseOutline,
    pose: Transform,
    second: BaseOutline,
    other_pose: Transform,
    gap: SignedDistance,
) -> Manifold:
    """Find the contact points of two bases. `gap` is the signed distance of the bases.

    There are two points if an edge meets an edge, else one point.
    """
    corners = first.corners.shape[0]
    if gap.edge >= corners:
        return _facing_edges(second, other_pose, gap.edge - corners, first, pose, -gap.nx, -gap.ny)
    if gap.edge >= 0:
        return _facing_edges(first, pose, gap.edge, second, other_pose, gap.nx, gap.ny)
    half = 0.5 * gap.width
    if first.disc > 0.0:
        out = first.disc + half
        x, y = pose.x + out * gap.nx, pose.y + out * gap.ny
    else:
        out = second.disc + half
        x, y = other_pose.x - out * gap.nx, other_pose.y - out * gap.ny
    return Manifold(1, x, y, gap.width, 0.0, 0.0, 0.0)


CONTACT_DISTANCE = 1e-6  # [m] smaller gaps are contacts; overlaps up to it may remain
MAX_ADVANCES = 64


@inlined
def _reach(outline: BaseOutline) -> float:
    """Return the distance [m] from the centre of mass to the farthest corner."""
    square = 0.0
    for k in range(outline.corners.shape[0]):
        x = outline.corners[k, 0] - outline.com_x
        y = outline.corners[k, 1] - outline.com_y
        square = max(square, x * x + y * y)
    return math.sqrt(square)


@linked
def time_of_impact(
    first: BaseOutline, sweep: StepMotion, second: BaseOutline, other_sweep: StepMotion, dt: float
) -> float:
    """Return the time [s] until two bases touch, or infinity if they do not touch within `dt` [s].

    The bases move by `sweep` and `other_sweep`. The method is conservative advancement. The maximum
    closing speed is the speed of the centres of mass along the normal, plus the speed of the
    farthest corners due to turning. The gap divided by the maximum closing speed is a lower
    bound on the time until a touch. Each iteration advances the bases by this lower bound.
    """
    turning = abs(sweep.omega) * _reach(first) + abs(other_sweep.omega) * _reach(second)
    time = 0.0
    for _ in range(MAX_ADVANCES):
        gap = signed_distance(
            first, transform_at(first, sweep, time), second, transform_at(second, other_sweep, time)
        )
        if gap.width <= CONTACT_DISTANCE:
            return time
        speed = turning
        speed += gap.nx * (sweep.vx - other_sweep.vx) + gap.ny * (sweep.vy - other_sweep.vy)
        if speed * (dt - time) <= gap.width:
            return math.inf
        time += (gap.width - 0.5 * CONTACT_DISTANCE) / speed
    return time
