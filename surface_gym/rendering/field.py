"""The surface with everything on it."""

from collections.abc import Sequence

import pygame

from surface_gym.rendering.goal_marks import draw_asked_heading, draw_goal
from surface_gym.rendering.modules import ModuleSprites
from surface_gym.rendering.parcel_marks import draw_parcel, draw_sensed, draw_trail
from surface_gym.rendering.plate import draw_modules, painted_ground
from surface_gym.rendering.scene import Scene
from surface_gym.rendering.strips import Strips
from surface_gym.rendering.view import View, height_of


class Field:
    """Draws one surface at one place of a picture, and keeps what stays from scene to scene."""

    def __init__(self, layout: View, sprites: ModuleSprites) -> None:
        self.layout = layout
        self._sprites = sprites
        self._ground: pygame.Surface | None = None
        self._ground_key: tuple[object, ...] = ()

    @staticmethod
    def place(scene: Scene, cell: int, left: int, top: int) -> View:
        """The layout at a corner, of elements that are `cell` pixels wide."""
        return View.of(scene, cell, left, top)

    @staticmethod
    def extent(scene: Scene, cell: int) -> tuple[int, int]:
        """[px] width and height of what is drawn."""
        return (scene.columns * cell, scene.rows * height_of(scene, cell))

    @staticmethod
    def cells_across(scene: Scene) -> int:
        """How many elements take its width."""
        return scene.columns

    @staticmethod
    def rows_shown(scene: Scene) -> int:
        """How many rows are drawn."""
        return scene.rows

    @staticmethod
    def write_legend(
        canvas: pygame.Surface, strips: Strips, area: pygame.Rect, scenes: Sequence[Scene]
    ) -> None:
        """Write what the colours in some scenes mean, below an area."""
        strips.write_legend(canvas, area, scenes)

    @property
    def area(self) -> pygame.Rect:
        """What it draws on."""
        return self.layout.area

    def draw(self, canvas: pygame.Surface, scene: Scene) -> None:
        """Draw the scene's surface, goal and parcel."""
        canvas.blit(self._ground_of(scene), self.layout.area)
        draw_modules(canvas, self.layout, self._sprites, scene)
        draw_goal(canvas, self.layout, scene)
        draw_trail(canvas, self.layout, scene.trail)
        draw_sensed(canvas, self.layout, scene)
        draw_parcel(canvas, self.layout, scene)
        draw_asked_heading(canvas, self.layout, scene)

    def _ground_of(self, scene: Scene) -> pygame.Surface:
        key = (scene.rotor.tobytes(), scene.zone)
        if self._ground is None or key != self._ground_key:
            self._ground, self._ground_key = painted_ground(self.layout, scene), key
        return self._ground
