"""Pictures of scenes, and the window that shows them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.rendering import ink
from surface_gym.rendering.ink import INK, PAPER
from surface_gym.rendering.parcel_marks import draw_parcel, draw_sensed, draw_touch, draw_trail
from surface_gym.rendering.scene import Heading, Layout, Scene
from surface_gym.rendering.strips import Strips
from surface_gym.rendering.surface_marks import (
    ModuleSprites,
    draw_asked_heading,
    draw_counts,
    draw_goal,
    draw_modules,
    label_goal,
    paint_ground,
)

Picture = NDArray[np.uint8]  # (height, width, 3)

WIDTH, WIDE = 960, 1280  # [px] of a picture: usual, and with traffic or of many scenes
_NARROWEST = 640  # [px] for the texts to be read
_LEAST_CELL = 6  # [px] of an element, for its axis to be seen
_LEAST_TILE_CELL = 2  # [px] of an element in a tile, for its colour to be seen
_ASPECT = 1.6  # width / height aimed at with tiles
_BETWEEN = 14  # [px] between tiles
_CAPTION = (40, 28, 30)  # [px] height, font size and margin on the left


class Painter:
    """Draws scenes, one after another, and keeps what stays the same.

    Args:
        width: [px] of the pictures, even, as video codecs want it; None: 960, 1280 with traffic.

    Raises:
        ValueError: the width is odd or too small.
    """

    def __init__(self, width: int | None = None) -> None:
        self._width = None if width is None else _even_width(width)
        self._strips: Strips | None = None
        self._field: _Field | None = None
        self._canvas: pygame.Surface | None = None

    def draw(self, scene: Scene) -> Picture:
        """Draw a scene as a picture (height, width, 3).

        The height is even and follows from the shape of the surface, with traffic also from its
        rotor rows.

        Raises:
            ValueError: the surface has too many columns for the width.
        """
        field, strips = self._prepare(scene)
        layout, area = field.layout, field.layout.area
        canvas = self._clean_canvas(strips.width, strips.head + area.height + strips.foot)
        strips.write_head(canvas, area, scene)
        strips.write_foot(canvas, layout, scene)
        canvas.set_clip(area.inflate(2 * strips.margin, 0))
        field.draw(canvas, scene)
        label_goal(canvas, layout, scene, strips.small)
        return _pixels(canvas)

    def metres(self, pixel: tuple[float, float], scene: Scene) -> tuple[float, float]:
        """Convert a position [px] in the picture of a scene to (x, y) [m] on its surface."""
        return self._prepare(scene)[0].layout.metres(pixel)

    def _prepare(self, scene: Scene) -> tuple["_Field", Strips]:
        """Return field and strips for a scene, those of the last picture if they fit."""
        width = self._width or (WIDTH if scene.traffic is None else WIDE)
        if self._strips is None or self._strips.width != width:
            self._strips = Strips(width)
        margin, across = self._strips.margin, Layout.cells_across(scene)
        cell = (width - 2 * margin) // across
        if cell < _LEAST_CELL:
            least = 2 * margin + _LEAST_CELL * across
            raise ValueError(
                f"width must be at least {least} for {scene.columns} columns, got {width}"
            )
        left = (width - Layout.extent(scene, cell)[0]) // 2
        layout = Layout.of(scene, cell, left, self._strips.head)
        if self._field is None or self._field.layout != layout:
            self._field = _Field(layout, ModuleSprites(layout.cell))
        return self._field, self._strips

    def _clean_canvas(self, width: int, height: int) -> pygame.Surface:
        """Return the canvas of the last picture, as cleaning is cheaper than making one."""
        size = (width, height + height % 2)
        if self._canvas is None or self._canvas.get_size() != size:
            self._canvas = pygame.Surface(size, depth=32)
        self._canvas.set_clip(None)
        self._canvas.fill(PAPER)
        return self._canvas


class TilePainter:
    """Draws scenes side by side, under their titles.

    Args:
        width: [px] of the pictures; even, as video codecs want it.

    Raises:
        ValueError: the width is odd or too small.
    """

    def __init__(self, width: int = WIDE) -> None:
        self.width = _even_width(width)
        self._strips = Strips(self.width)
        self._fields: list[_Field] = []

    def draw(self, scenes: Sequence[Scene]) -> Picture:
        """Draw scenes as one picture (height, width, 3), the first at the upper left.

        The height is even and follows from the number of scenes and the shape of the surface.

        Raises:
            ValueError: there is no scene, some have traffic and some not, the surfaces differ in
                size, or have too many columns for the width.
        """
        plan = self._plan(scenes)
        self._prepare(scenes, plan)
        margin = self._strips.margin
        height = margin + plan.height + self._strips.foot
        canvas = pygame.Surface((self.width, height + height % 2), depth=32)
        canvas.fill(PAPER)
        tiles = pygame.Rect((self.width - plan.width) // 2, margin, plan.width, plan.height)
        for field, scene in zip(self._fields, scenes, strict=True):
            area = field.layout.area
            place = (area.left, area.top - plan.caption // 4)
            ink.write(canvas, scene.title, plan.caption, room=area.width, bottomleft=place)
            canvas.set_clip(area)
            field.draw(canvas, scene)
            canvas.set_clip(None)
        self._strips.write_legend(canvas, tiles, scenes, tiles.right)
        return _pixels(canvas)

    def _plan(self, scenes: Sequence[Scene]) -> "_Plan":
        if len(scenes) == 0:
            raise ValueError("scenes must be at least one, got none")
        if len({scene.traffic is None for scene in scenes}) > 1:
            raise ValueError("scenes must all have traffic or none of them, got both")
        grids = {(scene.rows, scene.columns, scene.pitches, scene.origin) for scene in scenes}
        if len(grids) > 1:
            raise ValueError(f"scenes must be of surfaces of one size, got {sorted(grids)}")
        shown = {Layout.of(scene, 1, 0, 0).band[1] for scene in scenes}
        if len(shown) > 1:
            raise ValueError(f"scenes must show as many rows as each other, got {sorted(shown)}")
        plans = [self._plan_across(scenes, across) for across in range(1, len(scenes) + 1)]
        legible = [plan for plan in plans if plan.cell >= _LEAST_TILE_CELL]
        if not legible:
            across = Layout.cells_across(scenes[0])
            least = 2 * self._strips.margin + _LEAST_TILE_CELL * across
            raise ValueError(
                f"width must be at least {least} for {scenes[0].columns} columns, got {self.width}"
            )
        return min(legible, key=lambda plan: abs(math.log(self.width / plan.height / _ASPECT)))

    def _plan_across(self, scenes: Sequence[Scene], across: int) -> "_Plan":
        room = (self.width - 2 * self._strips.margin + _BETWEEN) // across - _BETWEEN
        cell = room // Layout.cells_across(scenes[0])
        width, height = Layout.extent(scenes[0], cell)
        caption = min(max(14, width // 14), self._strips.middle)
        return _Plan(across, -(-len(scenes) // across), cell, caption, width, height + caption)

    def _prepare(self, scenes: Sequence[Scene], plan: "_Plan") -> None:
        """Keep the fields of the last picture where their layouts stay."""
        left, top = (self.width - plan.width) // 2, self._strips.margin + plan.caption
        corners = [plan.corner(k) for k in range(len(scenes))]
        layouts = [
            Layout.of(scene, plan.cell, left + x, top + y)
            for scene, (x, y) in zip(scenes, corners, strict=True)
        ]
        if [field.layout for field in self._fields] != layouts:
            sprites = ModuleSprites(layouts[0].cell)
            self._fields = [_Field(layout, sprites) for layout in layouts]


def draw(scene: Scene, width: int | None = None) -> Picture:
    """Draw a scene as a picture (height, width, 3); for many of them keep a `Painter`.

    Raises:
        ValueError: the width is odd, or too small for the surface.
    """
    return Painter(width).draw(scene)


def with_caption(picture: Picture, text: str) -> Picture:
    """Put a picture under a line of text, which is cut where it has no room."""
    height, size, margin = _CAPTION
    width = picture.shape[1]
    canvas = pygame.Surface((width, height))
    canvas.fill(PAPER)
    ink.write(canvas, text, size, INK, width - 2 * margin, midleft=(margin, height // 2 + 4))
    return np.concatenate([np.swapaxes(pygame.surfarray.array3d(canvas), 0, 1), picture])


class _Field:
    """Draws a scene at one layout, and keeps what stays from scene to scene."""

    def __init__(self, layout: Layout, sprites: ModuleSprites) -> None:
        self.layout = layout
        self._sprites = sprites
        self._ground: pygame.Surface | None = None
        self._ground_key: tuple[object, ...] = ()

    def draw(self, canvas: pygame.Surface, scene: Scene) -> None:
        """Draw surface, goal, exits, queue and parcels within the canvas's clip."""
        layout, clip = self.layout, canvas.get_clip()
        canvas.blit(self._painted_ground(scene), layout.area)
        canvas.set_clip(layout.plate.clip(clip))
        draw_modules(canvas, layout, self._sprites, scene)
        canvas.set_clip(clip)
        draw_counts(canvas, layout, scene)
        if scene.traffic is not None:
            canvas.set_clip(layout.passable.clip(clip))
        draw_goal(canvas, layout, scene)
        for parcel in scene.parcels:
            draw_trail(canvas, layout, parcel)
        for parcel in scene.parcels:
            draw_parcel(canvas, layout, scene, parcel)
            draw_sensed(canvas, layout, parcel)
            if isinstance(scene.goal, Heading):
                draw_asked_heading(canvas, layout, scene.goal, parcel)
        for first, second in scene.touching:
            draw_touch(canvas, layout, scene.parcels[first], scene.parcels[second])
        canvas.set_clip(clip)

    def _painted_ground(self, scene: Scene) -> pygame.Surface:
        key = (scene.rotor.tobytes(), scene.zone, scene.exits)
        if self._ground is None or key != self._ground_key:
            self._ground, self._ground_key = paint_ground(self.layout, scene), key
        return self._ground


@dataclass(frozen=True)
class _Plan:
    """Division of a picture into tiles."""

    across: int  # tiles in a row
    down: int  # rows of tiles
    cell: int  # [px] width of an element
    caption: int  # [px] font size of a tile's title
    tile_width: int  # [px] of the surface in a tile
    tile_height: int  # [px] of caption and surface

    @property
    def width(self) -> int:
        """Width [px] of all tiles and the gaps between them."""
        return self.across * (self.tile_width + _BETWEEN) - _BETWEEN

    @property
    def height(self) -> int:
        """Height [px] of all tiles and the gaps between them."""
        return self.down * (self.tile_height + _BETWEEN) - _BETWEEN

    def corner(self, k: int) -> tuple[int, int]:
        """Compute the upper left corner [px] of a tile, from the first's."""
        row, column = divmod(k, self.across)
        return (column * (self.tile_width + _BETWEEN), row * (self.tile_height + _BETWEEN))


def _even_width(width: int) -> int:
    checks.integer("width", width, least=_NARROWEST)
    if width % 2:
        raise ValueError(f"width must be even, got {width!r}")
    return int(width)


def _pixels(canvas: pygame.Surface) -> Picture:
    """Copy the red, green and blue (height, width, 3) of a canvas."""
    width, height = canvas.get_size()
    held = pygame.surfarray.pixels3d(canvas).swapaxes(0, 1)
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    for channel in range(3):  # four times as fast as all three at once
        pixels[..., channel] = held[..., channel]
    return pixels


class Window:
    """Shows pictures at a frame rate, until the user or `close` closes it.

    The first picture opens it. pygame has one window per process.

    Args:
        title: of the window.
        frame_rate: [1/s] at most; `show` waits for it.

    Raises:
        ValueError: the frame rate is not positive.
    """

    def __init__(self, title: str = "Smart surface", frame_rate: float = 25.0) -> None:
        self._title = title
        self._frame_rate = checks.positive("frame_rate", frame_rate)
        self._clock = pygame.time.Clock()
        self._screen: pygame.Surface | None = None
        self.closed = False  # by the user or by `close`; it does not open again

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3) and wait until the next is due; nothing if closed.

        Raises:
            ValueError: the array is not a picture.
            RuntimeError: there is no display.
        """
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise ValueError(
                "picture must be an array of uint8 of the shape (height, width, 3), "
                f"got one of {picture.dtype} of the shape {picture.shape}"
            )
        if self.closed:
            return
        size = (picture.shape[1], picture.shape[0])
        if self._screen is None or self._screen.get_size() != size:
            self._screen = self._opened(size)
        pygame.surfarray.blit_array(self._screen, picture.swapaxes(0, 1))
        pygame.display.flip()
        self._clock.tick(self._frame_rate)
        if pygame.event.get(pygame.QUIT):
            self.close()

    def close(self) -> None:
        """Close the window; a second call does nothing."""
        self.closed = True
        if self._screen is not None:
            self._screen = None
            pygame.display.quit()

    def _opened(self, size: tuple[int, int]) -> pygame.Surface:
        try:
            pygame.display.init()
            screen = pygame.display.set_mode(size)
        except pygame.error as error:
            raise RuntimeError(f"a window needs a display: {error}") from error
        pygame.display.set_caption(self._title)
        return screen
