"""Colours, and functions that draw strokes, areas and text.

Smooth shapes are painted on an enlarged layer, which is then scaled down (anti-aliasing). So a
slowly moving parcel can lie between pixels. Strokes are faster and whole pixels wide, for scenes
with many parcels. Text uses pygame's default font.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

Colour: TypeAlias = tuple[int, int, int]

PAPER: Colour = (255, 255, 255)
PLATE: Colour = (244, 245, 246)  # the surface's supports
PLATE_EDGE: Colour = (203, 208, 214)
SUPPORT: Colour = (216, 220, 225)
DRIVEN: Colour = (66, 84, 108)  # driven modules
ZONE: Colour = (255, 255, 255)
ZONE_EDGE: Colour = (112, 122, 136)
INK: Colour = (33, 39, 48)
FAINT_INK: Colour = (108, 116, 128)
PARCEL: Colour = (146, 152, 164)
GOAL: Colour = (190, 24, 72)
SENSED: Colour = (94, 60, 170)
RUNS: Colour = (52, 60, 72)  # a conveyor after the surface that runs
STANDS: Colour = (172, 177, 185)  # the same conveyor at rest

# Far from the four orientations' colours and from each other, for dichromats too.
EXITS: tuple[Colour, ...] = (
    (172, 112, 252), (252, 216, 24), (84, 252, 180), (168, 12, 132), (12, 36, 132), (252, 180, 252),
    (180, 204, 108),
)  # fmt: skip

# The axis colours lie on an ellipse in Oklab (https://bottosson.github.io/posts/oklab). Its plane
# contains lightness and the axis from blue to orange, which dichromats see too: 0 deg is dark, 90
# deg light, 45 deg blue and -45 deg orange.
_CENTRE = np.array([0.620, 0.012, 0.005])
_TO_ROLLING = np.array([0.170, -0.080, -0.005])  # from the centre to 90 deg
_TO_PLUS = np.array([-0.055, -0.045, -0.125])  # to 45 deg

_OKLAB_TO_LMS = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_LMS_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def axis_colours(angle: ArrayLike) -> NDArray[np.uint8]:
    """Compute the colours (..., 3) in sRGB of axis angles (...) [rad].

    >>> axis_colours([0.0, np.pi / 4, np.pi]).tolist()  # 0 and 180 deg are one orientation
    [[127, 61, 77], [62, 119, 189], [127, 61, 77]]
    """
    double = 2.0 * np.asarray(angle, dtype=np.float64)[..., np.newaxis]
    oklab = _CENTRE - np.cos(double) * _TO_ROLLING + np.sin(double) * _TO_PLUS
    linear = (oklab @ _OKLAB_TO_LMS.T) ** 3 @ _LMS_TO_RGB.T
    encoded = np.where(
        linear <= 0.0031308,
        12.92 * linear,
        1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055,
    )
    return np.round(255.0 * encoded).astype(np.uint8)


def axis_colour(angle: float) -> Colour:
    """Compute the colour in sRGB of one axis angle [rad]."""
    red, green, blue = axis_colours(math.remainder(angle, math.pi)).tolist()
    return (red, green, blue)


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """Mix two colours. `share` [-] is the share of the colour `other`."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(colour, other, strict=True))
    return (red, green, blue)


def exit_colour(index: int) -> Colour:
    """Return the colour of an exit or a group of parcels. Colours repeat for large indices."""
    return EXITS[index % len(EXITS)]


def text_on(colour: Colour) -> Colour:
    """Choose the colour of text on a background colour."""
    red, green, blue = colour
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 120.0 else PAPER


Points = NDArray[np.float64]  # (points, 2) [px]

_FINE, _COARSE = 8, 4  # samples per pixel and direction
_LARGE = 20_000  # [px] larger layers use the coarse number of samples
_DASH = 0.6  # share of the dash in a period
_DASHES_AT_ONCE = 4
_LETTER_SAMPLES = 2  # per pixel and direction: letters at twice the size keep their spacing


class _Layer:
    """A transparent, enlarged picture. Shapes are painted here first, then on the canvas."""

    def __init__(self, canvas: pygame.Surface, points: Points, grow: float, colour: Colour) -> None:
        (left, top), (right, bottom) = points.min(axis=0) - grow, points.max(axis=0) + grow
        corner = (math.floor(left), math.floor(top))
        size = (math.ceil(right) - corner[0], math.ceil(bottom) - corner[1])
        self.area = pygame.Rect(corner, size).clip(canvas.get_clip())
        self.canvas = canvas
        self.colour = colour
        self.samples = _FINE if self.area.width * self.area.height < _LARGE else _COARSE
        self.patch = pygame.Surface(
            (self.samples * self.area.width, self.samples * self.area.height), pygame.SRCALPHA
        )
        self.patch.fill((*colour, 0))

    def _samples_at(self, points: Points) -> Any:
        """Convert points (..., 2) [px] of the canvas to pixels of the layer, as nested lists."""
        samples = np.rint(self.samples * (points - self.area.topleft) - 0.5)
        return samples.astype(np.int64).tolist()

    def polygon(self, points: Points) -> None:
        pygame.draw.polygon(self.patch, self.colour, self._samples_at(points))

    def disc(self, centre: Points, radius: float) -> None:
        x, y = self._samples_at(centre)
        pygame.draw.circle(self.patch, self.colour, (x, y), self.samples * radius)

    def lines(self, pieces: Sequence[Points], width: float) -> None:
        """Paint a quadrilateral of a width [px] for each segment, and a disc for each joint."""
        half = 0.5 * (width - 1.0 / self.samples)  # pygame paints a polygon's border too
        start = np.concatenate([piece[:-1] for piece in pieces])
        end = np.concatenate([piece[1:] for piece in pieces])
        along = end - start
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), np.finfo(np.float64).tiny)
        across = half * np.stack([-along[:, 1], along[:, 0]], axis=-1) / length[:, np.newaxis]
        corners = np.stack([start + across, end + across, end - across, start - across], axis=1)
        for quadrilateral in self._samples_at(corners):
            pygame.draw.polygon(self.patch, self.colour, quadrilateral)
        for x, y in self._samples_at(np.concatenate([piece[1:-1] for piece in pieces])):
            pygame.draw.circle(self.patch, self.colour, (x, y), self.samples * half)

    def press(self, opacity: float = 1.0) -> None:
        """Scale the layer down, and draw it on the canvas with an opacity from 0 to 1."""
        if self.area.width and self.area.height:
            smooth = pygame.transform.smoothscale(self.patch, self.area.size)
            smooth.set_alpha(round(255 * opacity))
            self.canvas.blit(smooth, self.area)


def polygon(canvas: pygame.Surface, points: Points, colour: Colour, opacity: float = 1.0) -> None:
    """Fill the polygon with corners `points` (n, 2) [px]. `opacity` is from 0 to 1 (opaque)."""
    layer = _Layer(canvas, points, 1.0, colour)
    layer.polygon(points)
    layer.press(opacity)


def disc(canvas: pygame.Surface, centre: Points, radius: float, colour: Colour) -> None:
    """Fill a disc around `centre` (2,) [px] with a radius [px]."""
    layer = _Layer(canvas, centre[np.newaxis], radius + 1.0, colour)
    layer.disc(centre, radius)
    layer.press()


def line(
    canvas: pygame.Surface, points: Points, width: float, colour: Colour, opacity: float = 1.0
) -> None:
    """Draw a line of a width [px] through points (n, 2) [px], with round joints and flat ends."""
    lines(canvas, [points], width, colour, opacity)


def lines(
    canvas: pygame.Surface,
    pieces: Sequence[Points],
    width: float,
    colour: Colour,
    opacity: float = 1.0,
) -> None:
    """Draw several lines of a width [px] at once. Each line goes through points (n, 2) [px]."""
    layer = _Layer(canvas, np.concatenate(pieces), width, colour)
    layer.lines(pieces, width)
    layer.press(opacity)


def outline(canvas: pygame.Surface, points: Points, width: float, colour: Colour) -> None:
    """Draw a border, `width` [px] wide, along the edges of the polygon `points` (n, 2) [px]."""
    line(canvas, np.vstack([points, points[:2]]), width, colour)


def dashes(
    canvas: pygame.Surface, points: Points, width: float, colour: Colour, period: float
) -> None:
    """Draw a dashed line through points (n, 2) [px].

    `period` [px] is the length of a dash plus a gap. The period is adjusted so that the line ends
    with a dash.
    """
    reached = distances(points)
    gaps = max(1, round(reached[-1] / period))
    starts = np.arange(gaps + 1.0)
    ends = np.stack([starts, starts + _DASH], axis=-1) * (reached[-1] / (gaps + _DASH))
    at = np.stack([np.interp(ends, reached, points[:, i]) for i in (0, 1)], axis=-1)
    pieces = [
        np.vstack([first, points[(reached > start) & (reached < end)], last])
        for (start, end), (first, last) in zip(ends, at, strict=True)
    ]
    for k in range(0, len(pieces), _DASHES_AT_ONCE):
        lines(canvas, pieces[k : k + _DASHES_AT_ONCE], width, colour)


def arrow(canvas: pygame.Surface, tail: Points, tip: Points, width: float, colour: Colour) -> None:
    """Draw an arrow of a width [px]. Its head is four widths long, but shorter in a short arrow."""
    length = math.hypot(*(tip - tail))
    if length == 0.0:
        return
    along = (tip - tail) / length
    across = np.array([-along[1], along[0]])
    head = min(4.0 * width, 0.7 * length)
    neck = tip - head * along
    shaft, barb = 0.5 * min(width, 0.5 * head) * across, 0.5 * head * across
    corners = [tail + shaft, neck + shaft, neck + barb, tip, neck - barb, neck - shaft]
    polygon(canvas, np.array([*corners, tail - shaft]), colour)


def hatching(
    canvas: pygame.Surface, area: pygame.Rect, spacing: float, width: float, colour: Colour,
    opacity: float,
) -> None:  # fmt: skip
    """Fill a rectangle with lines at 45 degrees; `spacing` and `width` are in [px]."""
    layer = _Layer(
        canvas, np.array([area.topleft, area.bottomright], dtype=np.float64), 0.0, colour
    )
    feet = np.arange(area.left - area.height, area.right, spacing * math.sqrt(2.0))
    low = np.stack([feet, np.full_like(feet, area.bottom)], axis=-1)
    high = low + np.array([area.height, -area.height])
    layer.lines(list(np.stack([low, high], axis=1)), width)
    layer.press(opacity)


def distances(points: Points) -> NDArray[np.float64]:
    """Compute the length (points,) [px] of the polyline from the first point to each point."""
    steps = np.diff(points, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])


def thinned(points: Points, step: float) -> Points:
    """Select points of a line at distances of about `step` [px], including both ends."""
    kept = np.unique(np.floor(distances(points) / step), return_index=True)[1]
    return points[np.union1d(kept, [len(points) - 1])]


def stroke(canvas: pygame.Surface, points: Points, width: int, colour: Colour) -> None:
    """Quickly draw a line through points (n, 2) [px]. `width` is a whole number of pixels."""
    ends = (points - 0.5).tolist()  # pygame's origin is the middle of the first pixel
    for start, end in pairwise(ends):
        pygame.draw.aaline(canvas, colour, start, end, width)


def border(canvas: pygame.Surface, corners: Points, width: int, colour: Colour) -> None:
    """Draw the border of a polygon by the fast function `stroke`. `corners` (n, 2) are in [px]."""
    stroke(canvas, np.vstack([corners, corners[:1]]), width, colour)


def dashed_border(
    canvas: pygame.Surface, corners: Points, width: int, colour: Colour, period: float
) -> None:
    """Draw a polygon's border quickly, dashed. `period` [px] is the length of a dash plus a gap."""
    closed = np.vstack([corners, corners[:1]])
    reached = distances(closed)
    steps = 2 * max(1, round(reached[-1] / period))
    at = np.linspace(0.0, reached[-1], steps + 1)
    ends = np.stack([np.interp(at, reached, closed[:, i]) for i in (0, 1)], axis=-1)
    places = (ends - 0.5).tolist()
    for start, end in zip(places[0::2], places[1::2], strict=False):
        pygame.draw.aaline(canvas, colour, start, end, width)


def wash(canvas: pygame.Surface, corners: Points, colour: Colour, opacity: float) -> None:
    """Fill the polygon with `corners` (n, 2) [px]. Its edge is ragged; cover the edge later."""
    corner = np.floor(corners.min(axis=0)) - 1.0
    size = np.ceil(corners.max(axis=0)) - corner + 2.0
    patch = pygame.Surface(size.tolist(), pygame.SRCALPHA)
    places = np.rint(corners - corner - 0.5).tolist()
    pygame.draw.polygon(patch, (*colour, round(255 * opacity)), places)
    canvas.blit(patch, corner.tolist())


def inset(corners: Points, depth: float) -> Points:
    """Return the corners (n, 2) [px] of a polygon whose edges are moved inwards by a depth [px]."""
    after = np.concatenate([corners[1:], corners[:1]])
    (x, y), along = (corners - corners[0]).T, after - corners
    turn = np.sign(x @ along[:, 1] - y @ along[:, 0])
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), np.finfo(np.float64).tiny)
    inward = turn * np.stack([-along[:, 1], along[:, 0]], axis=-1) / length[:, np.newaxis]
    before = np.concatenate([inward[-1:], inward[:-1]])
    sharpness = np.maximum(1.0 + (before * inward).sum(axis=1, keepdims=True), 0.3)
    return corners + depth * (before + inward) / sharpness


@lru_cache(maxsize=512)
def _letters(text: str, size: int, colour: Colour, room: int | None) -> pygame.Surface:
    # Cache pictures instead of fonts, since pygame.quit() in other code deletes fonts.
    pygame.font.init()
    font = pygame.font.Font(None, _LETTER_SAMPLES * size)
    shown = text
    while room is not None and text and font.size(shown)[0] > _LETTER_SAMPLES * room:
        text = text[:-1]
        shown = text.rstrip() + "…"
    large = font.render(shown, True, colour)
    width, height = large.get_size()
    return pygame.transform.smoothscale(
        large, (-(-width // _LETTER_SAMPLES), -(-height // _LETTER_SAMPLES))
    )


def text_width(text: str, size: int) -> int:
    """Measure the width [px] of a text."""
    return _letters(text, size, INK, None).get_width()


def write(
    canvas: pygame.Surface, text: str, size: int, colour: Colour = INK, room: int | None = None,
    **place: tuple[int, int],
) -> pygame.Rect:  # fmt: skip
    """Write a text with a font of `size` [px], and return the area of the text.

    `place` is the position [px] of a point of this area, e.g. `midleft=(10, 20)`. Points are named
    as in pygame's class Rect. A text longer than `room` [px] is cut and ends with an ellipsis.
    """
    letters = _letters(text, size, colour, room)
    area = letters.get_rect(**place)
    canvas.blit(letters, area)
    return area


def write_on_plate(
    canvas: pygame.Surface, text: str, size: int, colour: Colour, within: pygame.Rect,
    **place: tuple[int, int],
) -> None:  # fmt: skip
    """Write a text on a bright rectangle. If necessary, move both into the area `within`."""
    plate = _letters(text, size, colour, None).get_rect(**place).inflate(8, 4).clamp(within)
    sheet = pygame.Surface(plate.size, pygame.SRCALPHA)
    pygame.draw.rect(sheet, (*PAPER, 225), sheet.get_rect(), border_radius=3)
    canvas.blit(sheet, plate)
    write(canvas, text, size, colour, center=plate.center)


def draw_badge(
    canvas: pygame.Surface, text: str, size: int, colour: Colour, **place: tuple[int, int]
) -> pygame.Rect:
    """Draw text on a rounded, coloured label; return the label's area. `write` explains `place`."""
    badge = _badge(text, size, colour)
    area = badge.get_rect(**place)
    canvas.blit(badge, area)
    return area


def badge_width(text: str, size: int) -> int:
    """Measure the width [px] of a rounded label."""
    return max(round(0.95 * size), text_width(text, size) + size // 2)


@lru_cache(maxsize=256)
def _badge(text: str, size: int, colour: Colour) -> pygame.Surface:
    height = round(0.95 * size)
    badge = pygame.Surface((badge_width(text, size), height), pygame.SRCALPHA)
    area = badge.get_rect()
    pygame.draw.rect(badge, colour, area, border_radius=height // 2)
    write(badge, text, size, text_on(colour), center=(area.centerx, area.centery + 1))
    return badge
