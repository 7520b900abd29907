"""The parcel: its base, its heading, where it has been, where the sensors see it."""

import math

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering import ink
from surface_gym.rendering.palette import INK, PAPER, PARCEL, SENSED, Colour
from surface_gym.rendering.scene import Scene
from surface_gym.rendering.view import View

Array = NDArray[np.float64]

_TRAIL_STEP = 3.0  # [px] between the trail's points
_TRAIL_PIECE = 8  # points of one opacity


def centroid(outline: Array) -> Array:
    """(2,) [m] centre of the area within an outline."""
    start = outline - outline[0]
    end = np.roll(start, -1, axis=0)
    area = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    return outline[0] + area @ (start + end) / (3.0 * area.sum())


def placed(points: Array, pose: tuple[float, float, float]) -> Array:
    """Points (..., 2) [m] of the base's frame, on the surface."""
    x, y, theta = pose
    cosine, sine = math.cos(theta), math.sin(theta)
    return points @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([x, y])


def draw_parcel(canvas: pygame.Surface, view: View, scene: Scene) -> None:
    """Draw the base, translucent, with an arrow along its own x axis."""
    corners = view.pixels(placed(scene.outline, scene.pose))
    ink.polygon(canvas, corners, PARCEL, 0.45)
    ink.outline(canvas, corners, view.stroke, INK)
    draw_heading(canvas, view, scene.outline, scene.pose, INK)


def draw_heading(
    canvas: pygame.Surface,
    view: View,
    outline: Array,
    pose: tuple[float, float, float],
    colour: Colour,
) -> None:
    """Draw an arrow from the base's centre along its frame's x."""
    centre = centroid(outline)
    nose = centre + np.array([0.72 * (outline[:, 0].max() - centre[0]), 0.0])
    tail, tip = view.pixels(placed(np.array([centre, nose]), pose))
    halo = np.array([tail, tail + 0.9 * (tip - tail)])
    ink.line(canvas, halo, 3.0 * view.stroke, PAPER, 0.6)
    ink.arrow(canvas, tail, tip, 1.3 * view.stroke, colour)
    ink.disc(canvas, tail, 1.7 * view.stroke, colour)


def draw_trail(canvas: pygame.Surface, view: View, trail: Array) -> None:
    """Draw where the centre has been, fading towards the oldest."""
    if len(trail) < 2:
        return
    points = ink.thinned(view.pixels(trail), _TRAIL_STEP)
    for first in range(0, len(points) - 1, _TRAIL_PIECE):
        piece = points[first : first + _TRAIL_PIECE + 1]
        age = 1.0 - first / len(points)
        ink.line(canvas, piece, 2.2 * view.stroke, PAPER, 0.6)
        ink.line(canvas, piece, view.stroke, INK, 1.0 - 0.6 * age)


def draw_sensed(canvas: pygame.Surface, view: View, scene: Scene) -> None:
    """Draw the outline of the base where the sensors see it."""
    if scene.sensed_pose is not None:
        corners = view.pixels(placed(scene.outline, scene.sensed_pose))
        closed = np.vstack([corners, corners[:1]])
        ink.dashes(canvas, closed, 0.8 * view.stroke, SENSED, 3.0 * view.stroke)
