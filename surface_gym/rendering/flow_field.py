"""A stream's line with everything on it and beside it."""

import pygame

from surface_gym.rendering.exit_marks import draw_exits, draw_queue, paint_exit
from surface_gym.rendering.flow_layout import FlowLayout
from surface_gym.rendering.flow_parcel_marks import (
    draw_parcel,
    draw_sensed,
    draw_touch,
    draw_trail,
)
from surface_gym.rendering.flow_scene import FlowScene
from surface_gym.rendering.flow_strips import write_legend
from surface_gym.rendering.modules import ModuleSprites
from surface_gym.rendering.palette import PAPER, PLATE_EDGE, exit_colour
from surface_gym.rendering.plate import draw_modules, painted_ground


class FlowField:
    """Draws one line at one place of a picture, and keeps what stays from scene to scene."""

    place = staticmethod(FlowLayout.of)
    extent = staticmethod(FlowLayout.extent)
    cells_across = staticmethod(FlowLayout.cells_across)
    rows_shown = staticmethod(FlowLayout.rows_shown)
    write_legend = staticmethod(write_legend)

    def __init__(self, layout: FlowLayout, sprites: ModuleSprites) -> None:
        self.layout = layout
        self._sprites = sprites
        self._ground: pygame.Surface | None = None
        self._ground_key: tuple[object, ...] = ()

    @property
    def area(self) -> pygame.Rect:
        """What it draws on."""
        return pygame.Rect(self.layout.area)

    def draw(self, canvas: pygame.Surface, scene: FlowScene) -> None:
        """Draw the scene's modules, exits, queue and parcels."""
        layout, view, clip = self.layout, self.layout.view, canvas.get_clip()
        canvas.blit(self._ground_of(scene), self.area)
        canvas.set_clip(layout.plate.clip(clip))
        draw_modules(canvas, view, self._sprites, scene)
        canvas.set_clip(clip)
        draw_exits(canvas, layout, scene)
        draw_queue(canvas, layout, scene.waiting)
        canvas.set_clip(layout.passable.clip(clip))
        for parcel in scene.parcels:
            draw_trail(canvas, view, parcel)
        for parcel in scene.parcels:
            draw_parcel(canvas, view, scene, parcel)
            draw_sensed(canvas, view, parcel)
        for first, second in scene.touching:
            draw_touch(canvas, view, scene.parcels[first], scene.parcels[second])
        canvas.set_clip(clip)

    def _ground_of(self, scene: FlowScene) -> pygame.Surface:
        key = (scene.rotor.tobytes(), scene.zone, scene.exits)
        if self._ground is None or key != self._ground_key:
            self._ground, self._ground_key = self._painted_ground(scene), key
        return self._ground

    def _painted_ground(self, scene: FlowScene) -> pygame.Surface:
        """The plate, the chutes and the grounds of their labels."""
        area, plate, view = self.area, self.layout.plate, self.layout.view
        sheet = pygame.Surface(area.bottomright, depth=32)
        sheet.fill(PAPER)
        sheet.set_clip(plate)
        sheet.blit(painted_ground(view, scene), view.area)
        sheet.set_clip(None)
        pygame.draw.rect(sheet, PLATE_EDGE, plate, 1)
        for place, mark in enumerate(scene.exits):
            paint_exit(sheet, self.layout, mark, exit_colour(place))
        return sheet.subsurface(area).copy()
