"""The surface with everything on it."""

import math

import numpy as np
import pygame

from surface_gym.rendering import ink, palette
from surface_gym.rendering.goal_marks import draw_asked_heading, draw_goal
from surface_gym.rendering.modules import ANGLES, ModuleSprites
from surface_gym.rendering.parcel_marks import draw_parcel, draw_sensed, draw_trail
from surface_gym.rendering.scene import Scene
from surface_gym.rendering.view import View


class Field:
    """Draws one surface at one place of a picture, and keeps what stays from scene to scene."""

    def __init__(self, view: View, sprites: ModuleSprites) -> None:
        self.view = view
        self._sprites = sprites
        self._ground: pygame.Surface | None = None
        self._ground_key: tuple[object, ...] = ()

    def draw(self, canvas: pygame.Surface, scene: Scene) -> None:
        """Draw the scene's surface, goal and parcel."""
        canvas.blit(self._ground_of(scene), self.view.area)
        self._draw_modules(canvas, scene)
        draw_goal(canvas, self.view, scene)
        draw_trail(canvas, self.view, scene.trail)
        draw_sensed(canvas, self.view, scene)
        draw_parcel(canvas, self.view, scene)
        draw_asked_heading(canvas, self.view, scene)

    def _ground_of(self, scene: Scene) -> pygame.Surface:
        key = (scene.rotor.tobytes(), scene.zone)
        if self._ground is None or key != self._ground_key:
            self._ground, self._ground_key = self._painted_ground(scene), key
        return self._ground

    def _painted_ground(self, scene: Scene) -> pygame.Surface:
        """The supports' plate and the zone."""
        view = self.view
        ground = pygame.Surface(view.area.size, depth=32)
        ground.fill(palette.PLATE)
        zone = None
        if scene.zone is not None:
            zone = view.cells(*scene.zone).move(-view.left, -view.top)
            ground.fill(palette.ZONE, zone)
        radius = max(0.07 * view.cell, 0.6)
        for row, column in np.argwhere(~scene.rotor).tolist():
            place = view.cells(row, 1, column, 1).move(-view.left, -view.top)
            centre = np.array([place.x + 0.5 * place.width, place.y + 0.5 * place.height])
            ink.disc(ground, centre, radius, palette.SUPPORT)
        pygame.draw.rect(ground, palette.PLATE_EDGE, ground.get_rect(), 1)
        if zone is not None:
            pygame.draw.rect(ground, palette.ZONE_EDGE, zone, max(1, round(0.75 * view.stroke)))
        return ground

    def _draw_modules(self, canvas: pygame.Surface, scene: Scene) -> None:
        view = self.view
        row, column = np.nonzero(scene.rotor)
        steps = np.rint(scene.axis[row, column] * (ANGLES / math.pi)).astype(np.int64) % ANGLES
        pale = ~scene.obeys[row, column]
        left = view.left + view.width * column + (view.width - view.cell) // 2
        top = view.top + view.height * (view.rows - 1 - row) + (view.height - view.cell) // 2
        looks = zip(steps.tolist(), pale.tolist(), strict=True)
        pictures = [self._sprites.sprite(step, is_pale) for step, is_pale in looks]
        places = zip(left.tolist(), top.tolist(), strict=True)
        canvas.fblits(list(zip(pictures, places, strict=True)))
