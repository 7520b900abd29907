"""Contacts of one parcel with the elements (modules and supports) of the surface."""

import math

from surface_gym.compiler.jit import inlined
from surface_gym.physics import types as ph
from surface_gym.physics.types import Array, Body, Contacts, Grid, Scratch


@inlined
def bounded(value: float, least: float, most: float) -> float:
    """Clip a number to [least, most]; NaN becomes `least`.

    Use `bounded` before every conversion from float to an index or a count. The conversion is
    undefined for floats outside the integer range. `least` and `most` must be whole numbers.
    """
    if not value > least:
        return least
    return most if value > most else value


EDGE_TOLERANCE = 1e-9  # [m] elements on the perimeter count as contacts despite round-off


@inlined
def _turn_edges(body: Body, cosine: float, sine: float, table: Array) -> None:
    """Write each edge of a turned body as a bound on x along a row.

    If side > 0, the bound is x <= start + slope y. If side < 0, the bound is x >= start + slope y.
    Here x and y are relative to the centroid. `table` gets start, slope and side. `cosine` and
    `sine` belong to the body's angle.
    """
    for k in range(body.edges.shape[0]):
        nx = cosine * body.edges[k, 0] - sine * body.edges[k, 1]
        ny = sine * body.edges[k, 0] + cosine * body.edges[k, 1]
        distance = body.edges[k, 2] + EDGE_TOLERANCE
        if abs(nx) > 1e-12:
            per_nx = 1.0 / nx
            table[ph.BOUND_START + k] = distance * per_nx
            table[ph.BOUND_SLOPE + k] = -ny * per_nx
            table[ph.BOUND_SIDE + k] = nx
        else:  # an edge along the row bounds y alone
            table[ph.BOUND_START + k] = distance
            table[ph.BOUND_SLOPE + k] = ny
            table[ph.BOUND_SIDE + k] = 0.0


@inlined
def _row_interval(body: Body, table: Array, dy: float) -> tuple[float, float]:
    """Return the lowest and highest x [m] of the base in a row, relative to the base's centroid.

    The row is at `dy` [m] relative to the centroid. If the base does not reach the row, the lowest
    x is greater than the highest. `_turn_edges` has written `table`.
    """
    reach = body.radius + EDGE_TOLERANCE
    high = math.sqrt(max(0.0, reach * reach - dy * dy))
    low = -high
    for k in range(body.edges.shape[0]):
        side = table[ph.BOUND_SIDE + k]
        bound = table[ph.BOUND_START + k] + table[ph.BOUND_SLOPE + k] * dy
        if side > 0.0:
            high = min(high, bound)
        elif side < 0.0:
            low = max(low, bound)
        elif table[ph.BOUND_SLOPE + k] * dy > table[ph.BOUND_START + k]:
            low = high + 1.0
    return low, high


@inlined
def _gather(grid: Grid, scratch: Scratch) -> int:
    """Write axes, drives and friction of the contacts; return the number of supports."""
    table, marks = scratch.table, scratch.marks
    i = 0
    isotropic = 0
    supports = 0
    for k in range(marks[ph.SPANS]):
        row = marks[ph.SPAN_ROW + k]
        for column in range(marks[ph.SPAN_FIRST + k], marks[ph.SPAN_LAST + k] + 1):
            table[ph.STIFFNESS + i] = grid.stiffness[row, column]
            cosine, sine, along, across = 1.0, 0.0, 0.0, 0.0
            kind = ph.SUPPORT
            if grid.rotor[row, column]:
                axis = grid.axis[row, column]
                cosine, sine = grid.direction[axis, 0], grid.direction[axis, 1]
                along, across = grid.drive[axis, 0], grid.drive[axis, 1]
                kind = ph.DRIVEN if grid.drive[axis, 2] > 0.0 else ph.ROTOR
                mu = grid.friction[row, column, 0] * grid.along_factor
                mu_across = grid.friction[row, column, 1] * grid.across_factor
            else:
                mu = grid.friction[row, column, 2] * grid.support_factor
                mu_across = mu
                supports += 1
            if kind != ph.ROTOR:
                marks[ph.ISOTROPIC + isotropic] = i
                isotropic += 1
            if kind == ph.DRIVEN:  # without an axis: along x and y
                along, across = cosine * along - sine * across, sine * along + cosine * across
                cosine, sine = 1.0, 0.0
                mu_across = mu
            marks[ph.KIND + i] = kind
            table[ph.AXIS_X + i] = cosine
            table[ph.AXIS_Y + i] = sine
            table[ph.DRIVE_ALONG + i] = along
            table[ph.DRIVE_ACROSS + i] = across
            table[ph.MU_ALONG + i] = mu
            table[ph.MU_ACROSS + i] = mu_across
            i += 1
    marks[ph.ISOTROPICS] = isotropic
    return supports


@inlined
def invalidate_contacts(scratch: Scratch) -> None:
    """Discard all contacts, after the surface or its axes have changed."""
    scratch.marks[ph.SPANS] = -1


@inlined
def find_contacts(
    grid: Grid, body: Body, x: float, y: float, theta: float, scratch: Scratch
) -> Contacts:
    """Find the elements under the base of a parcel whose centre of mass is at (x, y).

    The search covers only the rows and columns around the base, so the cost does not depend on the
    size of the surface. The contacts' data in `scratch` are rewritten only after
    `invalidate_contacts`, or if the elements have changed since the last call.
    """
    table, marks = scratch.table, scratch.marks
    cosine = math.cos(theta)
    sine = math.sin(theta)
    offset_x = cosine * body.com_x - sine * body.com_y
    offset_y = sine * body.com_x + cosine * body.com_y
    # Positions below are relative to the base frame's origin, in pitches for grid indices.
    per_pitch_x = 1.0 / grid.pitch_x
    per_pitch_y = 1.0 / grid.pitch_y
    grid_x = grid.x0 - (x - offset_x)
    grid_y = grid.y0 - (y - offset_y)
    rows, columns = grid.rotor.shape
    reach = body.radius + EDGE_TOLERANCE
    lowest = bounded((-reach - grid_y) * per_pitch_y, -1.0, rows)
    highest = bounded((reach - grid_y) * per_pitch_y, -1.0, rows)
    first_row = max(0, math.ceil(lowest))
    last_row = min(rows - 1, math.floor(highest))
    _turn_edges(body, cosine, sine, table)
    count = 0
    spans = 0
    changed = False
    for row in range(first_row, last_row + 1):
        dy = grid_y + grid.pitch_y * row
        low, high = _row_interval(body, table, dy)
        from_column = bounded((low - grid_x) * per_pitch_x, -1.0, columns)
        to_column = bounded((high - grid_x) * per_pitch_x, -1.0, columns)
        first = max(0, math.ceil(from_column))
        last = min(columns - 1, math.floor(to_column))
        last = min(last, first + ph.CAPACITY - 1 - count)  # bounds the index for any input
        if first > last:
            continue
        for column in range(first, last + 1):
            table[ph.ARM_X + count] = grid_x + grid.pitch_x * column - offset_x
            table[ph.ARM_Y + count] = dy - offset_y
            count += 1
        changed |= (marks[ph.SPAN_ROW + spans] != row) | (marks[ph.SPAN_FIRST + spans] != first)
        changed |= marks[ph.SPAN_LAST + spans] != last
        marks[ph.SPAN_ROW + spans] = row
        marks[ph.SPAN_FIRST + spans] = first
        marks[ph.SPAN_LAST + spans] = last
        spans += 1
    if changed or marks[ph.SPANS] != spans:
        marks[ph.SPANS] = spans
        marks[ph.SUPPORTS] = _gather(grid, scratch)
    return Contacts(count, marks[ph.ISOTROPICS], marks[ph.SUPPORTS])
