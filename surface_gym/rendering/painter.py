"""Pictures of scenes, as arrays."""

import numpy as np
from numpy.typing import NDArray

from surface_gym.rendering.canvas import canvas_pixels, even_width, new_canvas
from surface_gym.rendering.field import Field
from surface_gym.rendering.goal_marks import label_goal
from surface_gym.rendering.modules import ModuleSprites
from surface_gym.rendering.scene import Scene
from surface_gym.rendering.strips import Strips
from surface_gym.rendering.view import View

_LEAST_CELL = 6  # [px] of an element, for its axis to be seen


class Painter:
    """Draws scenes, one after another, and keeps what stays the same.

    Args:
        width: [px] of the pictures; even, as video codecs want it.

    Raises:
        ValueError: the width is odd or too small.
    """

    def __init__(self, width: int = 960) -> None:
        self.width = even_width(width)
        self._strips = Strips(self.width)
        self._field: Field | None = None

    def draw(self, scene: Scene) -> NDArray[np.uint8]:
        """The picture of a scene, (height, width, 3).

        The height is even and follows from the shape of the surface alone.

        Raises:
            ValueError: the surface has too many columns for the width.
        """
        field = self._field_of(scene)
        area, strips = field.area, self._strips
        height = strips.head + area.height + strips.foot
        canvas = new_canvas(self.width, height)
        strips.write_head(canvas, area, scene)
        strips.write_foot(canvas, field.layout, scene)
        canvas.set_clip(area.inflate(2 * strips.margin, 0))
        field.draw(canvas, scene)
        label_goal(canvas, field.layout, scene, strips.small)
        return canvas_pixels(canvas)

    def metres(self, pixel: tuple[float, float], scene: Scene) -> tuple[float, float]:
        """[m] (x, y) on the surface of a place [px] in the picture of a scene."""
        return self._field_of(scene).layout.metres(pixel)

    def _field_of(self, scene: Scene) -> Field:
        margin = self._strips.margin
        cell = (self.width - 2 * margin) // scene.columns
        if cell < _LEAST_CELL:
            least = 2 * margin + _LEAST_CELL * scene.columns
            raise ValueError(
                f"width must be at least {least} for {scene.columns} columns, got {self.width}"
            )
        left = (self.width - cell * scene.columns) // 2
        view = View.of(scene, cell, left, self._strips.head)
        if self._field is None or self._field.layout != view:
            self._field = Field(view, ModuleSprites(view.cell))
        return self._field


def draw(scene: Scene, width: int = 960) -> NDArray[np.uint8]:
    """The picture of a scene, (height, width, 3); for many of them keep a `Painter`.

    Raises:
        ValueError: the width is odd, or too small for the surface.
    """
    return Painter(width).draw(scene)
