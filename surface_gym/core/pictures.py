"""Pictures of a batch's environments: the surface, the goal and the parcel, drawn from above."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from surface_gym import canvas as cv, state as st
from surface_gym.canvas import Canvas, Pixels, Viewport
from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.core.assembly import compiled_functions
from surface_gym.feature_groups import SHOWN_DRIVE
from surface_gym.physics.contacts import bounded
from surface_gym.physics.types import RADIUS, THETA, Array, Integers, Scratch, X, Y
from surface_gym.state import BodyTable, EnvState, Geometry, ParcelState, SurfaceState
from surface_gym.tasks.base import Task

DISC_CORNERS = 48  # of the polygon that is drawn for a disc
# Its radius divided by the disc's, so that both have the same area.
DISC_FACTOR = math.sqrt(2.0 * math.pi / DISC_CORNERS / math.sin(2.0 * math.pi / DISC_CORNERS))
NOSE = 0.7  # length of the line to the front, divided by the front's distance from the centre
NOSE_WIDTH = 0.4  # width of this line, divided by the same distance


def make_viewport(config: EnvConfig) -> Viewport:
    """Return the viewport of the pictures of a configuration."""
    image, line = config.image, config.chosen_line
    assert image is not None
    left, right, low, high = line.extent if image.area is None else image.area
    scale = min(image.width / (right - left), image.height / (high - low))
    left = 0.5 * (left + right) - 0.5 * image.width / scale
    top = 0.5 * (low + high) + 0.5 * image.height / scale
    colours = np.eye(3) if image.channels == 3 else np.array(cv.LUMINANCE)[:, np.newaxis]
    first_x, _, first_y, _ = line.extent
    row, column = (np.arange(count + 1.0) for count in (line.rows, line.columns))
    across: Array = scale * (top - first_y - line.pitch_y * row)
    along: Array = scale * (first_x + line.pitch_x * column - left)
    rows, row_share = _overlaps(image.height, across[::-1])
    rows[:, 1] = line.rows - 1 - rows[:, 1]  # elements are counted upwards
    return Viewport(
        left,
        top,
        scale,
        cv.FULL * np.array(cv.PAINTS) @ colours,
        cv.FULL * np.array(cv.MODULE) @ colours,
        rows,
        row_share,
        *_overlaps(image.width, along),
    )


def _overlaps(pixels: int, edges: Array) -> tuple[Integers, Array]:
    """Return the overlaps of pixels and elements along one direction of a picture.

    An element is a module or a support. The first result (overlaps, 2) holds the indices of pixel
    and element. The second (overlaps,) is the part of the pixel's length that the element covers.
    Element k is from edges[k] to edges[k + 1], in pixels.
    """
    pixel = np.arange(pixels)[:, np.newaxis]
    share = np.minimum(pixel + 1.0, edges[1:]) - np.maximum(pixel, edges[:-1])
    found = np.argwhere(share > 1e-9)
    return found, share[found[:, 0], found[:, 1]]


@inlined
def _mix_row(viewport: Viewport, state: EnvState, row: int, levels: Array, mixed: Array) -> None:
    """Draw a row of elements into `mixed`, a row of pixels with shape (width x channels,).

    `levels` (columns x channels,) gets the colours of the elements.
    """
    channels = viewport.paints.shape[1]
    for column in range(state.rotor.shape[1]):
        place = channels * column
        if not state.rotor[row, column]:
            for c in range(channels):
                levels[place + c] = viewport.paints[cv.SUPPORT, c]
            continue
        axis = state.axis[row, column]
        cosine, sine = state.direction[axis, 0], state.direction[axis, 1]
        first, second = cosine * cosine - sine * sine, 2.0 * sine * cosine
        if state.drive[axis, st.DRIVEN] > 0.0:
            along, across = state.drive[axis, st.ALONG], state.drive[axis, st.ACROSS]
            first = bounded((cosine * along - sine * across) / SHOWN_DRIVE, -1.0, 1.0)
            second = bounded((sine * along + cosine * across) / SHOWN_DRIVE, -1.0, 1.0)
        for c in range(channels):
            levels[place + c] = (
                viewport.module[0, c]
                + viewport.module[1, c] * first
                + viewport.module[2, c] * second
            )
    for j in range(mixed.shape[0]):
        mixed[j] = 0.0
    for k in range(viewport.columns.shape[0]):
        pixel, column, share = (
            viewport.columns[k, 0],
            viewport.columns[k, 1],
            viewport.column_share[k],
        )
        for c in range(channels):
            mixed[channels * pixel + c] += share * levels[channels * column + c]


@linked
def draw_ground(canvas: Canvas, state: EnvState) -> None:
    """Draw supports and modules. A pixel gets the mean colour of the elements in the pixel.

    Each element counts by its area in the pixel.
    """
    viewport, table = canvas.viewport, canvas.table
    height, size = canvas.pixels.shape
    first = cv.FREE + state.rotor.shape[1] * viewport.paints.shape[1]
    levels = table[cv.FREE : first]
    mixed, total = table[first : first + size], table[first + size : first + 2 * size]
    k, current = 0, -1
    for pixel in range(height):
        line = canvas.pixels[pixel]
        for j in range(size):
            total[j] = 0.5  # to round
        while k < viewport.rows.shape[0] and viewport.rows[k, 0] == pixel:
            if viewport.rows[k, 1] != current:
                current = viewport.rows[k, 1]
                _mix_row(viewport, state, current, levels, mixed)
            share = viewport.row_share[k]
            for j in range(size):
                total[j] += share * mixed[j]
            k += 1
        for j in range(size):
            line[j] = np.uint8(np.int32(total[j]))


Turn = tuple[float, float]  # cosine and sine of an angle


@inlined
def _put(canvas: Canvas, k: int, pose: Array, turn: Turn, x: float, y: float) -> None:
    """Set corner k to the point (x, y) [m] in the frame of a base with this `pose` and `turn`."""
    cosine, sine = turn
    cv.put_corner(canvas, k, pose[X] + cosine * x - sine * y, pose[Y] + sine * x + cosine * y)


@linked
def draw_parcel(canvas: Canvas, state: EnvState) -> None:
    """Draw the base at its true pose, and a line from its centre towards its front."""
    truth, corners, edges, radius = state.truth, state.corners, state.edges, state.body[RADIUS]
    turn = math.cos(truth[THETA]), math.sin(truth[THETA])
    if edges[0, 2] > radius:  # a disc without edges and corners
        for k in range(DISC_CORNERS):
            angle, reach = 2.0 * math.pi * k / DISC_CORNERS, DISC_FACTOR * radius
            _put(canvas, k, truth, turn, reach * math.cos(angle), reach * math.sin(angle))
        cv.fill(canvas, DISC_CORNERS, cv.PARCEL)
    else:
        for k in range(corners.shape[0]):
            _put(canvas, k, truth, turn, corners[k, 0], corners[k, 1])
        cv.fill(canvas, corners.shape[0], cv.PARCEL)
    front = radius  # distance of the perimeter ahead of the centre
    for k in range(edges.shape[0]):
        if edges[k, 0] > 0.0:
            front = min(front, edges[k, 2] / edges[k, 0])
    for k in range(4):
        ahead = NOSE * front if k in (1, 2) else 0.0
        _put(canvas, k, truth, turn, ahead, (0.5 if k < 2 else -0.5) * NOSE_WIDTH * front)
    cv.fill(canvas, 4, cv.FRONT)


def make_drawing(config: EnvConfig) -> Any:
    """Build `draw_envs`, the kernel that draws environments of a configuration."""
    functions = compiled_functions(config.task, Task, "draw_goal")
    return _make_drawing(functions["draw_goal"], f"{type(config.task).__name__}-pictures")


@lru_cache(maxsize=64)
def _make_drawing(draw_goal: Callable[..., None], label: str) -> Any:
    def draw_envs(
        elements: Geometry,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        viewport: Viewport,
        pictures: Pixels,
        scratch: Scratch,
        sensor_scratch: Scratch,
        chosen: Integers,
    ) -> int:
        for i in chosen:
            state = st.env_state(surfaces, parcels, bodies, i, i, elements)
            canvas = Canvas(pictures[i], viewport, scratch.table)
            draw_ground(canvas, state)
            draw_goal(state, canvas)
            draw_parcel(canvas, state)
        return 0

    return compiled(draw_envs, label)
