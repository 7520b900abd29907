"""The parcels of a stream: their bases, where they are to leave, where they have been."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering import ink, strokes
from surface_gym.rendering.exit_marks import badge_width, draw_badge, label_size
from surface_gym.rendering.flow_scene import FlowParcel, FlowScene
from surface_gym.rendering.palette import (
    GOAL,
    INK,
    PAPER,
    SENSED,
    exit_colour,
    mixed,
    text_on,
)
from surface_gym.rendering.parcel_marks import centroid, placed
from surface_gym.rendering.view import View

Array = NDArray[np.float64]

_TRAIL_STEP = 7.0  # [px] between the trail's points
_OPACITY = 0.55  # of a base: the modules under it are seen
_NEAR = 0.01  # [m] beyond the least distance, within which two parcels count as touching
_SPIKES = 8
_FRONT = 0.32  # length of the triangle at a base's front, of the way there from its centre
_ROOM = 1.2  # a label's width, at most, over the least distance from the centre to a corner


def draw_trail(canvas: pygame.Surface, view: View, parcel: FlowParcel) -> None:
    """Draw where the centre has been lately, thinner towards the oldest."""
    if len(parcel.trail) < 2:
        return
    points = ink.thinned(view.pixels(parcel.trail), _TRAIL_STEP)
    colour = exit_colour(parcel.exit)
    wide = max(2, round(0.25 * view.cell))
    ends = np.linspace(0, len(points) - 1, wide + 1).astype(np.int64).tolist()
    for width, (first, last) in enumerate(pairwise(ends), start=1):
        piece = points[first : last + 1]
        strokes.stroke(canvas, piece, width + 2, mixed(colour, INK, 0.75))
        strokes.stroke(canvas, piece, width, colour)


def draw_parcel(canvas: pygame.Surface, view: View, scene: FlowScene, parcel: FlowParcel) -> None:
    """Draw the base in its exit's colour, with a triangle at its front and a label."""
    colour = exit_colour(parcel.exit)
    corners = view.pixels(placed(parcel.outline, parcel.pose))
    rim = max(1, round(0.22 * view.cell))
    inside = strokes.inset(corners, 0.5 * rim + 0.5)
    strokes.wash(canvas, inside, colour, _OPACITY)
    strokes.border(canvas, inside, rim + 1, colour)
    strokes.border(canvas, corners, max(1, round(0.13 * view.cell)), INK)
    _draw_front(canvas, view, parcel)
    _draw_label(canvas, view, parcel, parcel.label or scene.exits[parcel.exit].name)


def draw_sensed(canvas: pygame.Surface, view: View, parcel: FlowParcel) -> None:
    """Draw the outline of the base where the sensors see it."""
    if parcel.sensed_pose is not None:
        corners = view.pixels(placed(parcel.outline, parcel.sensed_pose))
        width = max(1, round(0.1 * view.cell))
        strokes.dashed_border(canvas, corners, width, SENSED, max(6.0, 0.6 * view.cell))


def draw_touch(canvas: pygame.Surface, view: View, first: FlowParcel, second: FlowParcel) -> None:
    """Draw a flash where two parcels touch."""
    x, y = view.pixels(meeting_point(first, second)).tolist()
    flash = _flash(max(9, round(0.85 * view.cell)))
    canvas.blit(flash, flash.get_rect(center=(round(x), round(y))))


def meeting_point(first: FlowParcel, second: FlowParcel) -> Array:
    """(2,) [m] the middle of where two bases are nearest to each other."""
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


def _draw_front(canvas: pygame.Surface, view: View, parcel: FlowParcel) -> None:
    """Draw a triangle that points along the base's own x, at its front."""
    centre, front = centroid(parcel.outline), parcel.outline[:, 0].max()
    reach = front - centre[0]
    tip = np.array([centre[0] + 0.88 * reach, centre[1]])
    corners = tip + _FRONT * reach * np.array([[-1.0, 0.7], [0.0, 0.0], [-1.0, -0.7]])
    colour = text_on(exit_colour(parcel.exit))
    ink.polygon(canvas, view.pixels(placed(corners, parcel.pose)), colour)


def _draw_label(canvas: pygame.Surface, view: View, parcel: FlowParcel, text: str) -> None:
    """Draw a label in the middle of a base that has room for it."""
    size, centre = label_size(view.cell), centroid(parcel.outline)
    clear = float(np.hypot(*(parcel.outline - centre).T).min())
    if text and badge_width(text, size) <= _ROOM * view.length(clear):
        x, y = view.pixels(placed(centre, parcel.pose)).tolist()
        draw_badge(canvas, text, size, exit_colour(parcel.exit), center=(round(x), round(y)))


@lru_cache(maxsize=16)
def _flash(radius: int) -> pygame.Surface:
    """A star of so many pixels."""
    picture = pygame.Surface((2 * radius + 2, 2 * radius + 2), pygame.SRCALPHA)
    picture.fill((*PAPER, 0))
    angles = np.pi * np.arange(2 * _SPIKES) / _SPIKES
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for share, colour in ((1.0, PAPER), (0.8, GOAL), (0.4, PAPER)):
        reach = share * radius * np.where(np.arange(2 * _SPIKES) % 2, 0.5, 1.0)
        ink.polygon(picture, radius + 1.0 + reach[:, np.newaxis] * rays, colour)
    return picture
