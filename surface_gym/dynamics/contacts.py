"""Which elements of the grid lie under a base: Section 3.2's F_lambda <= 0, row by row."""

import math

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import Array, Body, Grid, Scratch

EDGE_TOLERANCE = 1e-9  # [m] an element on the perimeter is a contact, whatever the round-off


@inlined
def _turn_edges(body: Body, cosine: float, sine: float, bounds: Array) -> None:
    """Write each edge as a bound on x along a row: x <= start + slope y, or >= if side < 0."""
    for k in range(body.edges.shape[0]):
        nx = cosine * body.edges[k, 0] - sine * body.edges[k, 1]
        ny = sine * body.edges[k, 0] + cosine * body.edges[k, 1]
        distance = body.edges[k, 2] + EDGE_TOLERANCE
        if abs(nx) > 1e-12:
            per_nx = 1.0 / nx
            bounds[k, 0] = distance * per_nx
            bounds[k, 1] = -ny * per_nx
            bounds[k, 2] = nx
        else:  # an edge along the row bounds y alone
            bounds[k, 0] = distance
            bounds[k, 1] = ny
            bounds[k, 2] = 0.0


@inlined
def _row_interval(body: Body, bounds: Array, dy: float) -> tuple[float, float]:
    """Ends of the base along the row at dy from the base's origin; the first exceeds if empty."""
    reach = body.radius + EDGE_TOLERANCE
    high = math.sqrt(max(0.0, reach * reach - dy * dy))
    low = -high
    for k in range(body.edges.shape[0]):
        side = bounds[k, 2]
        bound = bounds[k, 0] + bounds[k, 1] * dy
        if side > 0.0:
            high = min(high, bound)
        elif side < 0.0:
            low = max(low, bound)
        elif bounds[k, 1] * dy > bounds[k, 0]:
            low = high + 1.0
    return low, high


@inlined
def find_contacts(
    grid: Grid, body: Body, x: float, y: float, theta: float, scratch: Scratch
) -> int:
    """Find the elements under the base of a parcel whose centre of mass is at (x, y).

    Only the rows and columns around the base are looked at, so the cost does not depend on the
    size of the surface. Writes arms, axes and kinds into `scratch`.

    Returns:
        The number of elements under the base.
    """
    cosine = math.cos(theta)
    sine = math.sin(theta)
    offset_x = cosine * body.com_x - sine * body.com_y
    offset_y = sine * body.com_x + cosine * body.com_y
    # Everything below is seen from the base frame's origin, in pitches for the grid's indices.
    per_pitch = 1.0 / grid.pitch
    grid_x = grid.x0 - (x - offset_x)
    grid_y = grid.y0 - (y - offset_y)
    rows, columns = grid.rotor.shape
    reach = body.radius + EDGE_TOLERANCE
    first_row = max(0, math.ceil((-reach - grid_y) * per_pitch))
    last_row = min(rows - 1, math.floor((reach - grid_y) * per_pitch))
    _turn_edges(body, cosine, sine, scratch.edges)
    contacts = 0
    for row in range(first_row, last_row + 1):
        dy = grid_y + grid.pitch * row
        low, high = _row_interval(body, scratch.edges, dy)
        first = max(0, math.ceil((low - grid_x) * per_pitch))
        last = min(columns - 1, math.floor((high - grid_x) * per_pitch))
        for column in range(first, last + 1):
            scratch.arm_x[contacts] = grid_x + grid.pitch * column - offset_x
            scratch.arm_y[contacts] = dy - offset_y
            scratch.axis_x[contacts] = grid.direction[row, column, 0]
            scratch.axis_y[contacts] = grid.direction[row, column, 1]
            scratch.rotor[contacts] = grid.rotor[row, column]
            scratch.stiffness[contacts] = grid.stiffness[row, column]
            contacts += 1
    return contacts
