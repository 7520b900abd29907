"""A base's outline over the grid: the modules of a row it covers, and how far one is beyond it."""

import math

from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.contacts import EDGE_TOLERANCE
from surface_gym.dynamics.types import RADIUS
from surface_gym.lanes.lane import Lane


@lane_function
def between_places(low: float, high: float, count: int) -> tuple[int, int]:
    """First and last of the places 0 ... count - 1 that lie in [low, high]; the first exceeds the
    last if none does. The bounds may be any floats: none beyond the places becomes an integer.
    """
    first, last = count, -1
    if low <= 0.0:
        first = 0
    elif low < count:
        first = math.ceil(low)
    if high >= count - 1.0:
        last = count - 1
    elif high >= 0.0:
        last = math.floor(high)
    return first, last


@lane_function
def covered_columns(
    lane: Lane,
    row: int,
    x: float,
    y: float,
    cosine: float,
    sine: float,
) -> tuple[int, int]:
    """First and last column that a base at (x, y), turned by theta, covers of a row.

    The first exceeds the last if none is. As for contacts, F_lambda <= 0 up to round-off.
    """
    reach = lane.body[RADIUS] + EDGE_TOLERANCE
    dy = lane.elements.y0 + lane.elements.pitch_y * row - y
    square = reach * reach - dy * dy
    if square < 0.0:
        return 1, 0
    high = math.sqrt(square)
    low = -high
    edges = lane.edges
    for k in range(edges.shape[0]):
        nx = cosine * edges[k, 0] - sine * edges[k, 1]
        ny = sine * edges[k, 0] + cosine * edges[k, 1]
        room = edges[k, 2] + EDGE_TOLERANCE - ny * dy
        if nx > 1e-12:
            high = min(high, room / nx)
        elif nx < -1e-12:
            low = max(low, room / nx)
        elif room < 0.0:
            return 1, 0
    per_pitch = 1.0 / lane.elements.pitch_x
    return between_places(
        (x + low - lane.elements.x0) * per_pitch,
        (x + high - lane.elements.x0) * per_pitch,
        lane.rotor.shape[1],
    )


@lane_function
def outside(
    lane: Lane, dx: float, dy: float, cosine: float, sine: float, ux: float, uy: float
) -> tuple[float, float, float]:
    """F_lambda, Section 3.2, of the edge that the point at (dx, dy) from the centroid is most
    beyond, and its outward normal; of a disc, those of its circle.

    Returns:
        [m] how far the point is outside, and the normal (x, y).
    """
    x = cosine * dx + sine * dy
    y = cosine * dy - sine * dx
    wx = cosine * ux + sine * uy
    wy = cosine * uy - sine * ux
    edges = lane.edges
    radius = lane.body[RADIUS]
    farthest = -4.0 * radius
    best = -4.0 * radius
    nx = 0.0
    ny = 0.0
    for k in range(edges.shape[0]):
        beyond = edges[k, 0] * x + edges[k, 1] * y - edges[k, 2]
        score = beyond
        if edges[k, 0] * wx + edges[k, 1] * wy < 0.0:
            score -= 2.0 * radius
        if score > best:
            best = score
            farthest = beyond
            nx = edges[k, 0]
            ny = edges[k, 1]
    if farthest > -4.0 * radius:
        return farthest, cosine * nx - sine * ny, sine * nx + cosine * ny
    # No edge bounds a disc: those it is padded with are far off.
    distance = math.sqrt(dx * dx + dy * dy)
    per_distance = 1.0 / distance if distance > 0.0 else 0.0
    return distance - radius, dx * per_distance, dy * per_distance
