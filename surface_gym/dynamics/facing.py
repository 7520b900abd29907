"""Where two bases face each other: the points at which they press when they touch."""

import math
from typing import NamedTuple

from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.gap import Gap, Outline, Place, next_corner


class Facing(NamedTuple):
    """Up to two points midway between two bases that face each other."""

    points: int
    x: float  # [m]
    y: float  # [m]
    width: float  # [m] of the gap there
    second_x: float  # [m]
    second_y: float  # [m]
    second_width: float  # [m]


@inlined
def _corner(outline: Outline, place: Place, k: int) -> tuple[float, float]:
    x, y = outline.corners[k, 0], outline.corners[k, 1]
    return (
        place.x + place.cosine * x - place.sine * y,
        place.y + place.sine * x + place.cosine * y,
    )


@inlined
def _opposite_edge(outline: Outline, place: Place, nx: float, ny: float) -> int:
    """The edge whose normal is most against (nx, ny)."""
    corners = outline.corners
    own_x = place.cosine * nx + place.sine * ny
    own_y = place.cosine * ny - place.sine * nx
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
    outline: Outline, place: Place, edge: int, other: Outline, at: Place, nx: float, ny: float
) -> Facing:
    """The part of the other's opposite edge that lies over an edge of normal (nx, ny)."""
    x0, y0 = _corner(outline, place, edge)
    x1, y1 = _corner(outline, place, next_corner(outline.corners, edge))
    length = math.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
    across = _opposite_edge(other, at, nx, ny)
    ax, ay = _corner(other, at, across)
    bx, by = _corner(other, at, next_corner(other.corners, across))
    # Along the edge and away from it; the edge itself runs along (-ny, nx).
    a_along = nx * (ay - y0) - ny * (ax - x0)
    b_along = nx * (by - y0) - ny * (bx - x0)
    a_away = nx * (ax - x0) + ny * (ay - y0)
    b_away = nx * (bx - x0) + ny * (by - y0)
    if max(a_along, b_along) < 0.0 or min(a_along, b_along) > length or a_along == b_along:
        if b_away < a_away:
            a_along, a_away = b_along, b_away
        half = 0.5 * a_away
        return Facing(
            1, x0 - ny * a_along + nx * half, y0 + nx * a_along + ny * half, a_away, 0.0, 0.0, 0.0
        )
    rise = (b_away - a_away) / (b_along - a_along)
    first = min(length, max(0.0, a_along))
    second = min(length, max(0.0, b_along))
    b_away = a_away + rise * (second - a_along)
    a_away += rise * (first - a_along)
    return Facing(
        2,
        x0 - ny * first + 0.5 * a_away * nx,
        y0 + nx * first + 0.5 * a_away * ny,
        a_away,
        x0 - ny * second + 0.5 * b_away * nx,
        y0 + nx * second + 0.5 * b_away * ny,
        b_away,
    )


@linked
def find_facing(first: Outline, place: Place, second: Outline, at: Place, gap: Gap) -> Facing:
    """Where two bases face each other across a gap: at two points where edge faces edge.

    Args:
        first: a base.
        place: where it lies.
        second: another.
        at: where that lies.
        gap: between them, as `gap_between` gives it.
    """
    corners = first.corners.shape[0]
    if gap.edge >= corners:
        return _facing_edges(second, at, gap.edge - corners, first, place, -gap.nx, -gap.ny)
    if gap.edge >= 0:
        return _facing_edges(first, place, gap.edge, second, at, gap.nx, gap.ny)
    half = 0.5 * gap.width
    if first.disc > 0.0:
        out = first.disc + half
        x, y = place.x + out * gap.nx, place.y + out * gap.ny
    else:
        out = second.disc + half
        x, y = at.x - out * gap.nx, at.y - out * gap.ny
    return Facing(1, x, y, gap.width, 0.0, 0.0, 0.0)
