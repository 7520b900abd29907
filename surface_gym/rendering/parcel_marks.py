"""Parcels: base, front or heading, trail, the pose that the sensors see, and touches.

A parcel without an exit is drawn in grey with an arrow along its heading. A parcel of a stream is
drawn in the colour of its exit, quickly, as there are many.
"""

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering import ink
from surface_gym.rendering.ink import (
    GOAL,
    INK,
    PAPER,
    PARCEL,
    SENSED,
    Colour,
    exit_colour,
    mixed,
    text_on,
)
from surface_gym.rendering.scene import Layout, Pose, Scene, SceneParcel

Array = NDArray[np.float64]

_FINE_STEP, _COARSE_STEP = 3.0, 7.0  # [px] between the points of a trail: faded, coloured
_TRAIL_PIECE = 8  # points of one opacity
_OPACITY = 0.55  # of a coloured base: the modules under it are seen
_NEAR = 0.01  # [m] beyond the least distance, within which two parcels count as touching
_SPIKES = 8
_FRONT = 0.32  # length of the triangle at a base's front, over the distance from its centre
_ROOM = 1.2  # a label's width, at most, over the least distance from the centre to a corner


def centroid(outline: Array) -> Array:
    """Compute the centre (2,) [m] of the area within an outline."""
    start = outline - outline[0]
    end = np.roll(start, -1, axis=0)
    area = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    return outline[0] + area @ (start + end) / (3.0 * area.sum())


def placed(points: Array, pose: Pose) -> Array:
    """Transform points (..., 2) [m] from the base's frame to the surface."""
    x, y, theta = pose
    cosine, sine = math.cos(theta), math.sin(theta)
    return points @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([x, y])


def draw_trail(canvas: pygame.Surface, layout: Layout, parcel: SceneParcel) -> None:
    """Draw the recent path of the centre: fading, or coloured and thinner towards the oldest."""
    if len(parcel.trail) < 2:
        return
    if parcel.exit is None:
        points = ink.thinned(layout.pixels(parcel.trail), _FINE_STEP)
        for first in range(0, len(points) - 1, _TRAIL_PIECE):
            piece = points[first : first + _TRAIL_PIECE + 1]
            age = 1.0 - first / len(points)
            ink.line(canvas, piece, 2.2 * layout.stroke, PAPER, 0.6)
            ink.line(canvas, piece, layout.stroke, INK, 1.0 - 0.6 * age)
        return
    points = ink.thinned(layout.pixels(parcel.trail), _COARSE_STEP)
    colour = exit_colour(parcel.exit)
    wide = max(2, round(0.25 * layout.cell))
    ends = np.linspace(0, len(points) - 1, wide + 1).astype(np.int64).tolist()
    for width, (first, last) in enumerate(pairwise(ends), start=1):
        piece = points[first : last + 1]
        ink.stroke(canvas, piece, width + 2, mixed(colour, INK, 0.75))
        ink.stroke(canvas, piece, width, colour)


def draw_parcel(canvas: pygame.Surface, layout: Layout, scene: Scene, parcel: SceneParcel) -> None:
    """Draw the base: translucent with an arrow, or in its exit's colour with front and label."""
    corners = layout.pixels(placed(parcel.outline, parcel.pose))
    if parcel.exit is None:
        ink.polygon(canvas, corners, PARCEL, 0.45)
        ink.outline(canvas, corners, layout.stroke, INK)
        draw_heading(canvas, layout, parcel.outline, parcel.pose, INK)
        return
    colour = exit_colour(parcel.exit)
    rim = max(1, round(0.22 * layout.cell))
    inside = ink.inset(corners, 0.5 * rim + 0.5)
    ink.wash(canvas, inside, colour, _OPACITY)
    ink.border(canvas, inside, rim + 1, colour)
    ink.border(canvas, corners, max(1, round(0.13 * layout.cell)), INK)
    _draw_front(canvas, layout, parcel, text_on(colour))
    _draw_label(canvas, layout, parcel, parcel.label or scene.exits[parcel.exit].name, colour)


def draw_heading(
    canvas: pygame.Surface, layout: Layout, outline: Array, pose: Pose, colour: Colour
) -> None:
    """Draw an arrow from the base's centre along its frame's x."""
    centre = centroid(outline)
    nose = centre + np.array([0.72 * (outline[:, 0].max() - centre[0]), 0.0])
    tail, tip = layout.pixels(placed(np.array([centre, nose]), pose))
    halo = np.array([tail, tail + 0.9 * (tip - tail)])
    ink.line(canvas, halo, 3.0 * layout.stroke, PAPER, 0.6)
    ink.arrow(canvas, tail, tip, 1.3 * layout.stroke, colour)
    ink.disc(canvas, tail, 1.7 * layout.stroke, colour)


def draw_sensed(canvas: pygame.Surface, layout: Layout, parcel: SceneParcel) -> None:
    """Draw the outline of the base where the sensors see it."""
    if parcel.sensed_pose is not None:
        corners = layout.pixels(placed(parcel.outline, parcel.sensed_pose))
        width = max(1, round(0.1 * layout.cell))
        ink.dashed_border(canvas, corners, width, SENSED, max(6.0, 0.6 * layout.cell))


def draw_touch(
    canvas: pygame.Surface, layout: Layout, first: SceneParcel, second: SceneParcel
) -> None:
    """Draw a flash where two parcels touch."""
    x, y = layout.pixels(contact_point(first, second)).tolist()
    flash = _flash(max(9, round(0.85 * layout.cell)))
    canvas.blit(flash, flash.get_rect(center=(round(x), round(y))))


def contact_point(first: SceneParcel, second: SceneParcel) -> Array:
    """Compute the middle (2,) [m] of the region where two bases are nearest to each other."""
    one, other = placed(first.outline, first.pose), placed(second.outline, second.pose)
    distances, middles = [], []
    for points, corners in ((one, other), (other, one)):
        along = np.roll(corners, -1, axis=0) - corners
        away = points[:, np.newaxis] - corners  # (points, edges, 2)
        length = np.maximum((along**2).sum(axis=-1), np.finfo(np.float64).tiny)
        share = np.clip((away * along).sum(axis=-1) / length, 0.0, 1.0)
        foot = corners + share[..., np.newaxis] * along
        nearest = points[:, np.newaxis] - foot
        distances.append(np.hypot(nearest[..., 0], nearest[..., 1]).ravel())
        middles.append((foot + 0.5 * nearest).reshape(-1, 2))
    distance, middle = np.concatenate(distances), np.concatenate(middles)
    near = middle[distance <= distance.min() + _NEAR]
    return 0.5 * (near.min(axis=0) + near.max(axis=0))


def _draw_front(
    canvas: pygame.Surface, layout: Layout, parcel: SceneParcel, colour: Colour
) -> None:
    """Draw a triangle that points along the base's own x, at its front."""
    centre, front = centroid(parcel.outline), parcel.outline[:, 0].max()
    reach = front - centre[0]
    tip = np.array([centre[0] + 0.88 * reach, centre[1]])
    corners = tip + _FRONT * reach * np.array([[-1.0, 0.7], [0.0, 0.0], [-1.0, -0.7]])
    ink.polygon(canvas, layout.pixels(placed(corners, parcel.pose)), colour)


def _draw_label(
    canvas: pygame.Surface, layout: Layout, parcel: SceneParcel, text: str, colour: Colour
) -> None:
    """Draw a label in the middle of a base that has room for it."""
    size, centre = layout.label_size, centroid(parcel.outline)
    clear = float(np.hypot(*(parcel.outline - centre).T).min())
    if text and ink.badge_width(text, size) <= _ROOM * layout.length(clear):
        x, y = layout.pixels(placed(centre, parcel.pose)).tolist()
        ink.draw_badge(canvas, text, size, colour, center=(round(x), round(y)))


@lru_cache(maxsize=16)
def _flash(radius: int) -> pygame.Surface:
    """Paint a star of a radius [px]."""
    picture = pygame.Surface((2 * radius + 2, 2 * radius + 2), pygame.SRCALPHA)
    picture.fill((*PAPER, 0))
    angles = np.pi * np.arange(2 * _SPIKES) / _SPIKES
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for share, colour in ((1.0, PAPER), (0.8, GOAL), (0.4, PAPER)):
        reach = share * radius * np.where(np.arange(2 * _SPIKES) % 2, 0.5, 1.0)
        ink.polygon(picture, radius + 1.0 + reach[:, np.newaxis] * rays, colour)
    return picture
