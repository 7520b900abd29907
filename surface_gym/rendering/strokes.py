"""Antialiased lines straight onto the canvas: quicker than `ink`, and whole pixels wide.

They are for what moves in great number.
"""

from itertools import pairwise

import numpy as np
import pygame

from surface_gym.rendering.ink import Points, distances
from surface_gym.rendering.palette import Colour


def stroke(canvas: pygame.Surface, points: Points, width: int, colour: Colour) -> None:
    """Draw a line through points."""
    places = (points - 0.5).tolist()  # pygame counts from the first pixel's middle
    for start, end in pairwise(places):
        pygame.draw.aaline(canvas, colour, start, end, width)


def border(canvas: pygame.Surface, corners: Points, width: int, colour: Colour) -> None:
    """Draw a polygon's border."""
    stroke(canvas, np.vstack([corners, corners[:1]]), width, colour)


def dashed_border(
    canvas: pygame.Surface, corners: Points, width: int, colour: Colour, period: float
) -> None:
    """Draw a polygon's border in dashes and gaps of equal length; the period is in pixels."""
    closed = np.vstack([corners, corners[:1]])
    reached = distances(closed)
    steps = 2 * max(1, round(reached[-1] / period))
    at = np.linspace(0.0, reached[-1], steps + 1)
    ends = np.stack([np.interp(at, reached, closed[:, i]) for i in (0, 1)], axis=-1)
    places = (ends - 0.5).tolist()
    for start, end in zip(places[0::2], places[1::2], strict=False):
        pygame.draw.aaline(canvas, colour, start, end, width)


def wash(canvas: pygame.Surface, corners: Points, colour: Colour, opacity: float) -> None:
    """Fill a polygon whose ragged edge a border is to cover."""
    corner = np.floor(corners.min(axis=0)) - 1.0
    size = np.ceil(corners.max(axis=0)) - corner + 2.0
    patch = pygame.Surface(size.tolist(), pygame.SRCALPHA)
    places = np.rint(corners - corner - 0.5).tolist()
    pygame.draw.polygon(patch, (*colour, round(255 * opacity)), places)
    canvas.blit(patch, corner.tolist())


def inset(corners: Points, depth: float) -> Points:
    """A polygon whose edges lie so many pixels further inside."""
    after = np.concatenate([corners[1:], corners[:1]])
    (x, y), along = (corners - corners[0]).T, after - corners
    turn = np.sign(x @ along[:, 1] - y @ along[:, 0])
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), np.finfo(np.float64).tiny)
    inward = turn * np.stack([-along[:, 1], along[:, 0]], axis=-1) / length[:, np.newaxis]
    before = np.concatenate([inward[-1:], inward[:-1]])
    sharpness = np.maximum(1.0 + (before * inward).sum(axis=1, keepdims=True), 0.3)
    return corners + depth * (before + inward) / sharpness
