"""Pictures of streams of parcels, as arrays."""

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering.canvas import canvas_pixels, even_width, new_canvas
from surface_gym.rendering.flow_field import FlowField
from surface_gym.rendering.flow_layout import FlowLayout
from surface_gym.rendering.flow_scene import FlowScene
from surface_gym.rendering.flow_strips import write_foot, write_head
from surface_gym.rendering.modules import ModuleSprites
from surface_gym.rendering.palette import PAPER
from surface_gym.rendering.strips import Strips

_LEAST_CELL = 6  # [px] of an element, for its axis to be seen


class FlowPainter:
    """Draws streams of parcels, one scene after another, and keeps what stays the same.

    Of the surface the rotor rows are drawn and half a metre on either side of them, to scale.

    Args:
        width: [px] of the pictures; even, as video codecs want it.

    Raises:
        ValueError: the width is odd or too small.
    """

    def __init__(self, width: int = 1280) -> None:
        self.width = even_width(width)
        self._strips = Strips(self.width)
        self._field: FlowField | None = None
        self._canvas: pygame.Surface | None = None

    def draw(self, scene: FlowScene) -> NDArray[np.uint8]:
        """The picture of a scene, (height, width, 3).

        The height is even and follows from the shape of the surface and its rotor rows alone.

        Raises:
            ValueError: the surface has too many columns for the width.
        """
        field, strips = self._field_of(scene), self._strips
        area = field.area
        canvas = self._clean_canvas(area.bottom + strips.foot)
        write_head(canvas, strips, area, scene)
        write_foot(canvas, strips, field.layout, scene)
        field.draw(canvas, scene)
        return canvas_pixels(canvas)

    def metres(self, pixel: tuple[float, float], scene: FlowScene) -> tuple[float, float]:
        """[m] (x, y) on the surface of a place [px] in the picture of a scene."""
        return self._field_of(scene).layout.view.metres(pixel)

    def _clean_canvas(self, height: int) -> pygame.Surface:
        """The canvas of the last picture, which is dearer to make than to clean."""
        if self._canvas is None or self._canvas.get_height() != height + height % 2:
            self._canvas = new_canvas(self.width, height)
        self._canvas.fill(PAPER)
        return self._canvas

    def _field_of(self, scene: FlowScene) -> FlowField:
        margin, across = self._strips.margin, FlowLayout.cells_across(scene)
        cell = (self.width - 2 * margin) // across
        if cell < _LEAST_CELL:
            least = 2 * margin + _LEAST_CELL * across
            raise ValueError(
                f"width must be at least {least} for {scene.columns} columns, got {self.width}"
            )
        left = (self.width - FlowLayout.extent(scene, cell)[0]) // 2
        layout = FlowLayout.of(scene, cell, left, self._strips.head)
        if self._field is None or self._field.layout != layout:
            self._field = FlowField(layout, ModuleSprites(layout.view.cell))
        return self._field


def draw_flow(scene: FlowScene, width: int = 1280) -> NDArray[np.uint8]:
    """The picture of a stream, (height, width, 3); for many of them keep a `FlowPainter`.

    Raises:
        ValueError: the width is odd, or too small for the surface.
    """
    return FlowPainter(width).draw(scene)
