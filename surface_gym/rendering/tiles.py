"""Pictures of many scenes at once, as tiles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering.canvas import canvas_pixels, even_width, new_canvas
from surface_gym.rendering.field import Field
from surface_gym.rendering.flow_field import FlowField
from surface_gym.rendering.flow_scene import FlowScene
from surface_gym.rendering.lettering import write
from surface_gym.rendering.modules import ModuleSprites
from surface_gym.rendering.scene import Scene
from surface_gym.rendering.strips import Strips

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
        self._fields: list[Any] = []  # of the kind that draws the scenes

    def draw(self, scenes: Sequence[Scene | FlowScene]) -> NDArray[np.uint8]:
        """The picture of some scenes, (height, width, 3), the first at the upper left.

        The height is even and follows from the number of scenes and the shape of the surface.

        Raises:
            ValueError: there is no scene, they are of both kinds, the surfaces differ in size, or
                have too many columns for the width.
        """
        kind = _kind_of(scenes)
        plan = self._plan(scenes, kind)
        self._prepare(scenes, kind, plan)
        margin = self._strips.margin
        canvas = new_canvas(self.width, margin + plan.height + self._strips.foot)
        tiles = pygame.Rect((self.width - plan.width) // 2, margin, plan.width, plan.height)
        for field, scene in zip(self._fields, scenes, strict=True):
            area = field.area
            place = (area.left, area.top - plan.caption // 4)
            write(canvas, scene.title, plan.caption, room=area.width, bottomleft=place)
            canvas.set_clip(area)
            field.draw(canvas, scene)
            canvas.set_clip(None)
        kind.write_legend(canvas, self._strips, tiles, scenes)
        return canvas_pixels(canvas)

    def _plan(self, scenes: Sequence[Scene | FlowScene], kind: Any) -> _Plan:
        grids = {(scene.rows, scene.columns, scene.pitches, scene.origin) for scene in scenes}
        if len(grids) > 1:
            raise ValueError(f"scenes must be of surfaces of one size, got {sorted(grids)}")
        shown = {kind.rows_shown(scene) for scene in scenes}
        if len(shown) > 1:
            raise ValueError(f"scenes must show as many rows as each other, got {sorted(shown)}")
        plans = [self._plan_across(scenes, kind, across) for across in range(1, len(scenes) + 1)]
        legible = [plan for plan in plans if plan.cell >= _LEAST_CELL]
        if not legible:
            least = 2 * self._strips.margin + _LEAST_CELL * kind.cells_across(scenes[0])
            raise ValueError(
                f"width must be at least {least} for {scenes[0].columns} columns, got {self.width}"
            )
        return min(legible, key=lambda plan: abs(math.log(self.width / plan.height / _ASPECT)))

    def _plan_across(self, scenes: Sequence[Scene | FlowScene], kind: Any, across: int) -> _Plan:
        room = (self.width - 2 * self._strips.margin + _GAP) // across - _GAP
        cell = room // kind.cells_across(scenes[0])
        width, height = kind.extent(scenes[0], cell)
        caption = min(max(14, width // 14), self._strips.middle)
        return _Plan(across, -(-len(scenes) // across), cell, caption, width, height + caption)

    def _prepare(self, scenes: Sequence[Scene | FlowScene], kind: Any, plan: _Plan) -> None:
        """Keep the fields whose places stay; lanes have fields of their own."""
        left, top = (self.width - plan.width) // 2, self._strips.margin + plan.caption
        places = [
            kind.place(scene, plan.cell, left + x, top + y)
            for scene, (x, y) in ((scene, plan.corner(k)) for k, scene in enumerate(scenes))
        ]
        if [field.layout for field in self._fields] != places:
            sprites = ModuleSprites(places[0].cell)
            self._fields = [kind(place, sprites) for place in places]


def _kind_of(scenes: Sequence[Scene | FlowScene]) -> Any:
    """The class that draws the scenes: `Field` or `FlowField`."""
    if len(scenes) == 0:
        raise ValueError("scenes must be at least one, got none")
    kinds = {FlowField if isinstance(scene, FlowScene) else Field for scene in scenes}
    if len(kinds) > 1:
        raise ValueError("scenes must be all Scene or all FlowScene, got both")
    return kinds.pop()


def draw_tiles(scenes: Sequence[Scene | FlowScene], width: int = 1280) -> NDArray[np.uint8]:
    """The picture of some scenes as tiles, (height, width, 3); for many keep a `TilePainter`.

    Raises:
        ValueError: as `TilePainter` and its `draw` do.
    """
    return TilePainter(width).draw(scenes)
