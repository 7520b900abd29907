"""Antialiased shapes of one colour on a pygame Surface, in pixels.

A shape is painted several times larger on a layer around it, which is then scaled down: so its
edges are smooth and it can lie between pixels, as a slowly moving parcel must.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering.palette import Colour

Points = NDArray[np.float64]  # (points, 2) [px]

_FINE, _COARSE = 8, 4  # samples a pixel and direction
_LARGE = 20_000  # [px] in a layer from which the coarse ones do
_DASH = 0.6  # share of a dash in its period
_DASHES_AT_ONCE = 4


class _Layer:
    """A patch of canvas, enlarged, transparent where nothing is painted on it."""

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

    def _placed(self, points: Points) -> Any:
        """Points as nested lists of whole samples."""
        samples = np.rint(self.samples * (points - self.area.topleft) - 0.5)
        return samples.astype(np.int64).tolist()

    def polygon(self, points: Points) -> None:
        pygame.draw.polygon(self.patch, self.colour, self._placed(points))

    def disc(self, centre: Points, radius: float) -> None:
        x, y = self._placed(centre)
        pygame.draw.circle(self.patch, self.colour, (x, y), self.samples * radius)

    def lines(self, pieces: Sequence[Points], width: float) -> None:
        """A quadrilateral for each segment, a disc for each joint."""
        half = 0.5 * (width - 1.0 / self.samples)  # pygame paints a polygon's border too
        start = np.concatenate([piece[:-1] for piece in pieces])
        end = np.concatenate([piece[1:] for piece in pieces])
        along = end - start
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), np.finfo(np.float64).tiny)
        across = half * np.stack([-along[:, 1], along[:, 0]], axis=-1) / length[:, np.newaxis]
        corners = np.stack([start + across, end + across, end - across, start - across], axis=1)
        for quadrilateral in self._placed(corners):
            pygame.draw.polygon(self.patch, self.colour, quadrilateral)
        for x, y in self._placed(np.concatenate([piece[1:-1] for piece in pieces])):
            pygame.draw.circle(self.patch, self.colour, (x, y), self.samples * half)

    def press(self, opacity: float) -> None:
        """Bring the patch onto the canvas."""
        if self.area.width and self.area.height:
            smooth = pygame.transform.smoothscale(self.patch, self.area.size)
            smooth.set_alpha(round(255 * opacity))
            self.canvas.blit(smooth, self.area)


def polygon(canvas: pygame.Surface, points: Points, colour: Colour, opacity: float = 1.0) -> None:
    """Fill a polygon."""
    layer = _Layer(canvas, points, 1.0, colour)
    layer.polygon(points)
    layer.press(opacity)


def disc(
    canvas: pygame.Surface, centre: Points, radius: float, colour: Colour, opacity: float = 1.0
) -> None:
    """Fill a disc."""
    layer = _Layer(canvas, centre[np.newaxis], radius + 1.0, colour)
    layer.disc(centre, radius)
    layer.press(opacity)


def line(
    canvas: pygame.Surface, points: Points, width: float, colour: Colour, opacity: float = 1.0
) -> None:
    """Draw a line through points with round joints and flat ends."""
    lines(canvas, [points], width, colour, opacity)


def lines(
    canvas: pygame.Surface,
    pieces: Sequence[Points],
    width: float,
    colour: Colour,
    opacity: float = 1.0,
) -> None:
    """Draw several lines that lie near each other."""
    layer = _Layer(canvas, np.concatenate(pieces), width, colour)
    layer.lines(pieces, width)
    layer.press(opacity)


def outline(
    canvas: pygame.Surface, points: Points, width: float, colour: Colour, opacity: float = 1.0
) -> None:
    """Draw a polygon's border."""
    line(canvas, np.vstack([points, points[:2]]), width, colour, opacity)


def dashes(
    canvas: pygame.Surface, points: Points, width: float, colour: Colour, period: float
) -> None:
    """Draw a dashed line; the period [px] is stretched so that it ends with a dash."""
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
    """Draw an arrow whose head is four widths long, or most of a short arrow."""
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
    canvas: pygame.Surface,
    area: pygame.Rect,
    spacing: float,
    width: float,
    colour: Colour,
    opacity: float,
) -> None:
    """Fill a rectangle with lines at 45 deg."""
    layer = _Layer(
        canvas, np.array([area.topleft, area.bottomright], dtype=np.float64), 0.0, colour
    )
    feet = np.arange(area.left - area.height, area.right, spacing * math.sqrt(2.0))
    low = np.stack([feet, np.full_like(feet, area.bottom)], axis=-1)
    high = low + np.array([area.height, -area.height])
    layer.lines(list(np.stack([low, high], axis=1)), width)
    layer.press(opacity)


def distances(points: Points) -> NDArray[np.float64]:
    """(points,) [px] along a line from its first point."""
    steps = np.diff(points, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])


def thinned(points: Points, step: float) -> Points:
    """A line's points about `step` pixels apart, its ends among them."""
    kept = np.unique(np.floor(distances(points) / step), return_index=True)[1]
    return points[np.union1d(kept, [len(points) - 1])]
