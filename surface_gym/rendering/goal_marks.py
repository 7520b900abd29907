"""Marks of what is asked: one drawing and one label for each kind of goal."""

import math

import numpy as np
import pygame

from surface_gym.rendering import ink
from surface_gym.rendering.lettering import write_on_plate
from surface_gym.rendering.palette import GOAL, PAPER
from surface_gym.rendering.parcel_marks import centroid, draw_heading, placed
from surface_gym.rendering.scene import ExitSide, ExitSpeed, Heading, Path, Scene, StopLine
from surface_gym.rendering.view import View

_BAND = 1.0  # [cells] thickness of a hatched exit
_ARROW = 2.4  # [cells] length of the arrow through it
_PATH_STEP = 2.0  # [px] between a path's points


def _line_area(view: View, scene: Scene) -> pygame.Rect:
    """Where the goal is asked: the line's rows, over the zone's columns."""
    rows = np.flatnonzero(scene.rotor.any(axis=1))
    columns = np.flatnonzero(scene.rotor.any(axis=0))
    if len(rows) == 0:
        return view.area
    first_column, count = int(columns[0]), int(np.ptp(columns)) + 1
    if scene.zone is not None:
        first_column, count = scene.zone[2:]
    return view.cells(int(rows[0]), int(np.ptp(rows)) + 1, first_column, count)


def _exit_gate(view: View, scene: Scene, side: int) -> tuple[pygame.Rect, tuple[float, float]]:
    """The hatched band beyond the line's edge, and its outward direction [px]."""
    line, depth = _line_area(view, scene), round(_BAND * view.cell)
    if side == 0:
        band = pygame.Rect(line.right, line.top, depth, line.height)
    elif side > 0:
        band = pygame.Rect(line.left, line.top - depth, line.width, depth)
    else:
        band = pygame.Rect(line.left, line.bottom, line.width, depth)
    return band.clamp(view.area), (0.0, -float(side)) if side else (1.0, 0.0)


def draw_goal(canvas: pygame.Surface, view: View, scene: Scene) -> None:
    """Draw the goal, unlabelled."""
    goal = scene.goal
    if isinstance(goal, ExitSide):
        _draw_gate(canvas, view, scene, goal.side)
    elif isinstance(goal, ExitSpeed):
        _draw_gate(canvas, view, scene, 0)
    elif isinstance(goal, StopLine):
        ink.dashes(canvas, _stop_line(view, scene, goal), view.stroke, GOAL, 4.0 * view.stroke)
    elif isinstance(goal, Path):
        points = ink.thinned(view.pixels(goal.points), _PATH_STEP)
        ink.line(canvas, points, 2.6 * view.stroke, PAPER, 0.7)
        ink.dashes(canvas, points, view.stroke, GOAL, 7.0 * view.stroke)
        ink.disc(canvas, points[-1], 2.5 * view.stroke, GOAL)


def label_goal(canvas: pygame.Surface, view: View, scene: Scene, size: int) -> None:
    """Write beside the goal what it asks."""
    goal = scene.goal
    if isinstance(goal, StopLine):
        top = _stop_line(view, scene, goal)[1]
        place = (round(top[0]), round(top[1]) - 5)
        text = f"stop at x = {goal.x:.2f} m"
        write_on_plate(canvas, text, size, GOAL, view.area, midbottom=place)
    elif isinstance(goal, ExitSpeed):
        band, _ = _exit_gate(view, scene, 0)
        text = f"leave at {goal.speed:.2f} m/s ({goal.ratio:.2f} of entry)"
        place = (band.right, band.top - 7)
        write_on_plate(canvas, text, size, GOAL, view.area, bottomright=place)


def _draw_gate(canvas: pygame.Surface, view: View, scene: Scene, side: int) -> None:
    band, outward = _exit_gate(view, scene, side)
    ink.hatching(canvas, band, 0.28 * view.cell, 0.6 * view.stroke, GOAL, 0.55)
    ink.line(canvas, _inner_edge(band, side), view.stroke, GOAL)
    middle = _inner_edge(band, side).mean(axis=0)
    reach = _ARROW * view.cell * np.array(outward)
    tip = np.clip(middle + reach, view.area.topleft, view.area.bottomright)
    ink.arrow(canvas, tip - reach, tip, 2.0 * view.stroke, GOAL)


def _inner_edge(band: pygame.Rect, side: int) -> np.ndarray:
    if side == 0:
        return np.array([band.topleft, band.bottomleft], dtype=np.float64)
    if side > 0:
        return np.array([band.bottomleft, band.bottomright], dtype=np.float64)
    return np.array([band.topleft, band.topright], dtype=np.float64)


def _stop_line(view: View, scene: Scene, goal: StopLine) -> np.ndarray:
    """(2, 2) [px] across the line, and a little beyond it, from below to above."""
    line = _line_area(view, scene).inflate(0, 3 * view.cell).clip(view.area)
    x = float(view.pixels((goal.x, 0.0))[0])
    return np.array([[x, line.bottom], [x, line.top]])


def draw_asked_heading(canvas: pygame.Surface, view: View, scene: Scene) -> None:
    """Draw the base turned to the asked angle about its own centre, and the turn that is left."""
    if not isinstance(scene.goal, Heading):
        return
    angle = scene.goal.angle
    local = centroid(scene.outline)
    centre = placed(local, scene.pose)
    cosine, sine = math.cos(angle), math.sin(angle)
    x = centre[0] - cosine * local[0] + sine * local[1]
    y = centre[1] - sine * local[0] - cosine * local[1]
    ghost = (float(x), float(y), angle)
    corners = view.pixels(placed(scene.outline, ghost))
    closed = np.vstack([corners, corners[:1]])
    ink.dashes(canvas, closed, view.stroke, GOAL, 4.0 * view.stroke)
    draw_heading(canvas, view, scene.outline, ghost, GOAL)
    turn = math.remainder(angle - scene.pose[2], 2.0 * math.pi)
    radius = 0.4 * (scene.outline[:, 0].max() - local[0])
    headings = scene.pose[2] + np.linspace(0.0, turn, 24)
    arc = centre + radius * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    ink.line(canvas, view.pixels(arc), view.stroke, GOAL)
