"""How far two bases are from each other, and which way.

A base is a convex polygon by its corners, or a disc: a point with a radius. Polygons lie apart if
and only if the normal of some edge of theirs parts them, so that the sign of the gap between two
polygons is exact; apart from corner to corner, their distance is more.
"""

import math
from typing import NamedTuple

from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.types import (
    COM_X,
    COM_Y,
    OMEGA,
    RADIUS,
    THETA,
    VX,
    VY,
    Array,
    Bodies,
    X,
    Y,
)


class Outline(NamedTuple):
    """A base, in its own frame."""

    corners: Array  # (corners, 2) [m] from the centroid, anti-clockwise; repeats are no edges
    disc: float  # [m] radius of a disc, all of whose corners lie at the centroid; else 0
    com_x: float  # [m] centre of mass from the centroid
    com_y: float  # [m]


class Motion(NamedTuple):
    """Where a centre of mass is at first, and how it moves on from there."""

    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


class Place(NamedTuple):
    """Where a base lies."""

    x: float  # [m] of its centroid
    y: float  # [m]
    cosine: float  # of its angle
    sine: float


class Gap(NamedTuple):
    """What lies between two bases."""

    width: float  # [m] negative where they overlap
    nx: float  # unit normal from the first to the second
    ny: float
    edge: int  # that faces the other: of the first, or of the second from `corners` on; -1: round


@inlined
def outline_of(bodies: Bodies, site: int) -> Outline:
    """The base in a row of the bodies."""
    corners = bodies.corners[site]
    is_disc = corners[0, 0] == 0.0 and corners[0, 1] == 0.0
    return Outline(
        corners,
        bodies.body[site, RADIUS] if is_disc else 0.0,
        bodies.body[site, COM_X],
        bodies.body[site, COM_Y],
    )


@inlined
def place_at(outline: Outline, motion: Motion, time: float) -> Place:
    """Where the base lies some time on [s]."""
    theta = motion.theta + time * motion.omega
    cosine = math.cos(theta)
    sine = math.sin(theta)
    return Place(
        motion.x + time * motion.vx - cosine * outline.com_x + sine * outline.com_y,
        motion.y + time * motion.vy - sine * outline.com_x - cosine * outline.com_y,
        cosine,
        sine,
    )


@inlined
def standing(state: Array) -> Motion:
    """A state as a motion that goes nowhere."""
    return Motion(state[X], state[Y], state[THETA], 0.0, 0.0, 0.0)


@inlined
def moving(before: Array, after: Array) -> Motion:
    """The motion of a step, at the mean of its velocities as the implicit step's is."""
    return Motion(
        before[X],
        before[Y],
        before[THETA],
        0.5 * (before[VX] + after[VX]),
        0.5 * (before[VY] + after[VY]),
        0.5 * (before[OMEGA] + after[OMEGA]),
    )


@inlined
def next_corner(corners: Array, k: int) -> int:
    """The corner at the end of the edge that begins at a corner."""
    return k + 1 if k + 1 < corners.shape[0] else 0


@inlined
def _parting_edge(outline: Outline, place: Place, other: Outline, at: Place) -> Gap:
    """The edge that lies farthest from the other base, whose corners alone count."""
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
        x = place.cosine * own_x - place.sine * own_y
        y = place.sine * own_x + place.cosine * own_y
        their_x = at.cosine * x + at.sine * y
        their_y = at.cosine * y - at.sine * x
        nearest = math.inf
        for j in range(other.corners.shape[0]):
            nearest = min(nearest, their_x * other.corners[j, 0] + their_y * other.corners[j, 1])
        beyond = x * (at.x - place.x) + y * (at.y - place.y) + nearest
        beyond -= own_x * corners[k, 0] + own_y * corners[k, 1]
        if beyond > width:
            width, nx, ny, edge = beyond, x, y, k
    return Gap(width, nx, ny, edge)


@inlined
def _to_point(outline: Outline, place: Place, x: float, y: float) -> tuple[float, float, float]:
    """From a polygon to a point outside it: [m] distance and unit normal."""
    corners = outline.corners
    dx = place.cosine * (x - place.x) + place.sine * (y - place.y)
    dy = place.cosine * (y - place.y) - place.sine * (x - place.x)
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
    return least, place.cosine * nx - place.sine * ny, place.sine * nx + place.cosine * ny


@inlined
def _polygon_to_disc(polygon: Outline, place: Place, disc: Outline, at: Place) -> Gap:
    inside = _parting_edge(polygon, place, disc, at)
    width, nx, ny = inside.width, inside.nx, inside.ny
    if width > 0.0:
        width, nx, ny = _to_point(polygon, place, at.x, at.y)
    return Gap(width - disc.disc, nx, ny, -1)


@linked
def gap_between(first: Outline, place: Place, second: Outline, at: Place) -> Gap:
    """The gap from one base to another.

    Args:
        first: a base.
        place: where it lies.
        second: another.
        at: where that lies.
    """
    if first.disc > 0.0 and second.disc > 0.0:
        nx = at.x - place.x
        ny = at.y - place.y
        distance = math.sqrt(nx * nx + ny * ny)
        if distance == 0.0:
            return Gap(-first.disc - second.disc, 1.0, 0.0, -1)
        return Gap(distance - first.disc - second.disc, nx / distance, ny / distance, -1)
    if second.disc > 0.0:
        return _polygon_to_disc(first, place, second, at)
    if first.disc > 0.0:
        back = _polygon_to_disc(second, at, first, place)
        return Gap(back.width, -back.nx, -back.ny, -1)
    gap = _parting_edge(first, place, second, at)
    back = _parting_edge(second, at, first, place)
    if back.width > gap.width:
        return Gap(back.width, -back.nx, -back.ny, first.corners.shape[0] + back.edge)
    return gap
