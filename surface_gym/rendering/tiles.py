"""Pictures of many scenes at once, as tiles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering.canvas import canvas_pixels, even_width, new_canvas
from surface_gym.rendering.field import Field
from surface_gym.rendering.lettering import write
from surface_gym.rendering.modules import ModuleSprites
from surface_gym.rendering.scene import Scene
from surface_gym.rendering.strips import Strips
from surface_gym.rendering.view import View, height_of

_ASPECT = 1.6  # width / height aimed at
_LEAST_CELL = 2  # [px] of an element, for its colour to be seen
_GAP = 14  # [px] between tiles


@dataclass(frozen=True)
class _Plan:
    """How tiles fill a picture."""

    across: int  # tiles in a row
    down: int  # rows of tiles
    cell: int  # [px] width of an element
    caption: int  # [px] font size of a tile's title
    tile_width: int  # [px] of the surface in a tile
    tile_height: int  # [px] of caption and surface

    @property
    def width(self) -> int:
        """[px] of all tiles and the gaps between them."""
        return self.across * (self.tile_width + _GAP) - _GAP

    @property
    def height(self) -> int:
        """[px] of all tiles and the gaps between them."""
        return self.down * (self.tile_height + _GAP) - _GAP

    def corner(self, k: int) -> tuple[int, int]:
        """[px] of a tile's upper left corner, from the first's."""
        row, column = divmod(k, self.across)
        return (column * (self.tile_width + _GAP), row * (self.tile_height + _GAP))


class TilePainter:
    """Draws the lanes of a vector environment side by side, under their titles.

    Args:
        width: [px] of the pictures; even, as video codecs want it.

    Raises:
        ValueError: the width is odd or too small.
    """

    def __init__(self, width: int = 1280) -> None:
        self.width = even_width(width)
        self._strips = Strips(self.width)
        self._fields: list[Field] = []

    def draw(self, scenes: Sequence[Scene]) -> NDArray[np.uint8]:
        """The picture of some scenes, (height, width, 3), the first at the upper left.

        The height is even and follows from the number of scenes and the shape of the surface.

        Raises:
            ValueError: there is no scene, the surfaces differ in size, or have too many columns
                for the width.
        """
        plan = self._plan(scenes)
        self._prepare(scenes, plan)
        margin = self._strips.margin
        canvas = new_canvas(self.width, margin + plan.height + self._strips.foot)
        tiles = pygame.Rect((self.width - plan.width) // 2, margin, plan.width, plan.height)
        for field, scene in zip(self._fields, scenes, strict=True):
            area = field.view.area
            place = (area.left, area.top - plan.caption // 4)
            write(canvas, scene.title, plan.caption, room=area.width, bottomleft=place)
            canvas.set_clip(area)
            field.draw(canvas, scene)
            canvas.set_clip(None)
        self._strips.write_legend(canvas, tiles, scenes)
        return canvas_pixels(canvas)

    def _plan(self, scenes: Sequence[Scene]) -> _Plan:
        if len(scenes) == 0:
            raise ValueError("scenes must be at least one, got none")
        grids = {(scene.rows, scene.columns, scene.pitches, scene.origin) for scene in scenes}
        if len(grids) > 1:
            raise ValueError(f"scenes must be of surfaces of one size, got {sorted(grids)}")
        plans = [self._plan_across(scenes, across) for across in range(1, len(scenes) + 1)]
        legible = [plan for plan in plans if plan.cell >= _LEAST_CELL]
        if not legible:
            columns = scenes[0].columns
            least = 2 * self._strips.margin + _LEAST_CELL * columns
            raise ValueError(
                f"width must be at least {least} for {columns} columns, got {self.width}"
            )
        return min(legible, key=lambda plan: abs(math.log(self.width / plan.height / _ASPECT)))

    def _plan_across(self, scenes: Sequence[Scene], across: int) -> _Plan:
        rows, columns = scenes[0].rows, scenes[0].columns
        room = (self.width - 2 * self._strips.margin + _GAP) // across - _GAP
        cell = room // columns
        caption = min(max(14, cell * columns // 14), self._strips.middle)
        width, height = cell * columns, height_of(scenes[0], cell) * rows + caption
        return _Plan(across, -(-len(scenes) // across), cell, caption, width, height)

    def _prepare(self, scenes: Sequence[Scene], plan: _Plan) -> None:
        """Keep the fields whose views stay; lanes have fields of their own."""
        left, top = (self.width - plan.width) // 2, self._strips.margin + plan.caption
        views = [
            View.of(scene, plan.cell, left + x, top + y)
            for scene, (x, y) in ((scene, plan.corner(k)) for k, scene in enumerate(scenes))
        ]
        if [field.view for field in self._fields] != views:
            sprites = ModuleSprites(views[0].cell)
            self._fields = [Field(view, sprites) for view in views]


def draw_tiles(scenes: Sequence[Scene], width: int = 1280) -> NDArray[np.uint8]:
    """The picture of some scenes as tiles, (height, width, 3); for many keep a `TilePainter`.

    Raises:
        ValueError: as `TilePainter` and its `draw` do.
    """
    return TilePainter(width).draw(scenes)
