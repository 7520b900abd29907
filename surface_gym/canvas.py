"""Pictures as observations: their size and colours, and the compiled functions that draw them.

A shape's colour is mixed into a pixel by the exact share of the pixel that the shape covers. So the
mirror image of a picture is the picture of the mirrored scene, except for rounding.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.compiler.jit import inlined, linked
from surface_gym.physics.contacts import bounded
from surface_gym.physics.types import CAPACITY, Array, Integers

Pixels = NDArray[np.uint8]

IMAGE = "image"  # value of `observe` for `Image()`
LEAST, MOST = 8, 1024  # [px] height and width
AWAY = 1e9  # [px] shapes that reach as far from the picture are not drawn
NARROWEST = 1.5  # [px] width of a line

# Paints, and their shares of red, green and blue. Only a parcel contains blue, and all of it does.
SUPPORT, GOAL, PARCEL, FRONT = range(4)
PAINTS = ((0.1, 0.1, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 1.0))
# Colour of a module, and its changes by the cosine and by the sine of twice the axis angle.
MODULE = ((0.4, 0.4, 0.0), (0.35, 0.0, 0.0), (0.0, 0.35, 0.0))
LUMINANCE = (0.299, 0.587, 0.114)  # of red, green and blue in grey (ITU-R BT.601)
FULL = 255.0  # value of a channel's full share

# Offsets in a scratch's table: corners [px] of a shape, then its shares of a row of pixels.
COVER = 2 * CAPACITY
FREE = COVER + MOST  # first number that shapes do not use


@dataclass(frozen=True)
class Image:
    """A picture from above as the observation: `observe=Image(...)`, or "image" for the defaults.

    The observation is an array (height, width, channels) of bytes instead of features. It shows the
    true state at the end of the control period, as an ideal camera would: without delay and noise.
    The argument `sensors` does not change the picture. Friction, tilt, mass and load are invisible.
    Velocity is invisible in a single picture: stack pictures to show the velocity.

    x runs to the right and y upwards. The scale is fixed, and the same along x and y. It is the
    largest scale that shows the whole `area`. With 64 x 64 pixels, a pixel of Sort is 47 mm wide.

    | drawn | red, green and blue |
    | --- | --- |
    | beyond the surface | black |
    | support | a dark grey without blue: 0.1, 0.1, 0 |
    | module whose axis is at angle a | 0.4 + 0.35 cos(2 a), 0.4 + 0.35 sin(2 a), 0 |
    | driven module whose surface moves at (vx, vy) m/s | 0.4 + 0.35 vx / 2, 0.4 + 0.35 vy / 2, 0 |
    | goal, as the task draws it | 1, 1, 0 |
    | parcel | 1, 1, 1, with a line of 0, 0, 1 from its centre towards its front |

    A grey picture has the luminance of these colours.

    >>> import gymnasium as gym, surface_gym as sg
    >>> env = gym.make("SmartSurface/Sort-v0", observe=sg.Image(height=48, width=72, channels=3))
    >>> env.observation_space.shape, env.observation_space.dtype.name
    ((48, 72, 3), 'uint8')
    """

    height: int = 64  # [px]
    width: int = 64  # [px]
    channels: int = 1  # 1: grey; 3: red, green and blue
    # [m] least and greatest x, least and greatest y of the shown area; None: the whole surface
    area: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        size = (checks.integer, LEAST, MOST)
        checks.settle(self, height=size, width=size, channels=(checks.one_of, (1, 3)))
        if self.area is not None:
            area = checks.limited("area", checks.array("area", self.area, (4,)), checks.FARTHEST)
            left, right, low, high = area.tolist()
            if right - left < 1e-3 or high - low < 1e-3:
                raise ValueError(
                    "area must be the least and greatest x and the least and greatest y, at least "
                    f"1 mm apart, got {self.area!r}"
                )
            checks.set_fields(self, area=(left, right, low, high))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of a picture: height, width, channels."""
        return self.height, self.width, self.channels


class Viewport(NamedTuple):
    """Area, scale and colours of all pictures of a batch."""

    left: float  # [m] x of the left edge
    top: float  # [m] y of the upper edge
    scale: float  # [px/m]
    paints: Array  # (paints, channels) values of SUPPORT, GOAL, PARCEL and FRONT, up to 255
    module: Array  # (3, channels) colour of a module, and its change by the axis's cosine and sine
    # (overlaps, 2) rows of pixels and of elements that overlap; (overlaps,) [-] share of the pixels
    # that the elements cover; then the same for columns
    rows: Integers
    row_share: Array
    columns: Integers
    column_share: Array


class Canvas(NamedTuple):
    """A picture that is being drawn."""

    pixels: Pixels  # (height, width x channels), from y at the top downwards
    viewport: Viewport
    table: Array  # memory of a scratch


@inlined
def _area_before(place: float, first: float, last: float) -> float:
    """Return the mean of max(0, place - u) [px] for u uniform between `first` and `last` [px]."""
    if place <= first:
        return 0.0
    if place >= last:
        return place - 0.5 * (first + last)
    return 0.5 * (place - first) ** 2 / (last - first)


@inlined
def _cover_edge(table: Array, start: int, end: int, row: int, first: int, last: int) -> None:
    """Add an edge of a polygon to the covers of the pixels `first` to `last` of a row.

    A cover is the share of a pixel that the polygon covers; `table` holds covers and corners. The
    edge runs from corner `start` to corner `end`. A downward edge adds, for each pixel, the
    share that lies right of the edge. An upward edge subtracts this share.
    """
    u, v = table[2 * start], table[2 * start + 1]
    along, down = table[2 * end] - u, table[2 * end + 1] - v
    above, below = max(row, min(v, v + down)), min(row + 1.0, max(v, v + down))
    if not below > above:
        return
    one, other = u + along * ((above - v) / down), u + along * ((below - v) / down)
    near, far = min(one, other), max(one, other)
    height = math.copysign(below - above, down)
    before = _area_before(first, near, far)
    for column in range(first, last + 1):
        after = _area_before(column + 1.0, near, far)
        table[COVER + column] += height * (after - before)
        before = after


@linked
def fill(canvas: Canvas, corners: int, paint: int) -> None:
    """Fill a polygon with the paint of index `paint`.

    The first 2 * `corners` numbers of `canvas.table` are the x and y [px] of the corners.
    """
    pixels, table, paints = canvas.pixels, canvas.table, canvas.viewport.paints
    channels = paints.shape[1]
    height, width = pixels.shape[0], pixels.shape[1] // channels
    left = top = math.inf
    right = bottom = -math.inf
    for k in range(corners):
        left, right = min(left, table[2 * k]), max(right, table[2 * k])
        top, bottom = min(top, table[2 * k + 1]), max(bottom, table[2 * k + 1])
    if not (min(left, top) > -AWAY and max(right, bottom) < AWAY):
        return
    first = math.floor(bounded(left, 0.0, width))
    last = math.ceil(bounded(right, 0.0, width)) - 1
    for row in range(
        math.floor(bounded(top, 0.0, height)), math.ceil(bounded(bottom, 0.0, height))
    ):
        for column in range(first, last + 1):
            table[COVER + column] = 0.0
        for k in range(corners):
            _cover_edge(table, k - 1 if k > 0 else corners - 1, k, row, first, last)
        for column in range(first, last + 1):
            share = min(1.0, abs(table[COVER + column]))
            if not share > 0.0:
                continue
            for c in range(channels):
                before = float(pixels[row, channels * column + c])
                mixed = before + share * (paints[paint, c] - before)
                pixels[row, channels * column + c] = np.uint8(np.int32(mixed + 0.5))


@inlined
def put_corner(canvas: Canvas, k: int, x: float, y: float) -> None:
    """Set corner `k`, counted from 0, of the next polygon to (x, y) [m]."""
    viewport = canvas.viewport
    canvas.table[2 * k] = (x - viewport.left) * viewport.scale
    canvas.table[2 * k + 1] = (viewport.top - y) * viewport.scale


@linked
def draw_line(
    canvas: Canvas, start: tuple[float, float], end: tuple[float, float], width: float
) -> None:
    """Draw a line in the goal's colour between two points (x, y) [m].

    A `width` [m] that is less than 1.5 pixels is drawn as 1.5 pixels.
    """
    wide = max(width, NARROWEST / canvas.viewport.scale)
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.sqrt(dx * dx + dy * dy)
    if not length > 0.0:
        return
    half = 0.5 * wide / length
    put_corner(canvas, 0, start[0] - half * dy, start[1] + half * dx)
    put_corner(canvas, 1, start[0] + half * dy, start[1] - half * dx)
    put_corner(canvas, 2, end[0] + half * dy, end[1] - half * dx)
    put_corner(canvas, 3, end[0] - half * dy, end[1] + half * dx)
    fill(canvas, 4, GOAL)
