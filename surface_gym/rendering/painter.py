"""Pictures of scenes with text above and below, and a window that shows them."""

import math
import os
import warnings
from collections.abc import Sequence

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.rendering import ink, marks
from surface_gym.rendering.scene import Heading, PixelLayout, Scene

_LEGEND = (
    ("0°", 0.0),
    ("45°", math.pi / 4),
    ("\N{MINUS SIGN}45°", -math.pi / 4),
    ("90°", math.pi / 2),
)
_BARS = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01)  # [m] lengths a scale bar may have
_GAP = 1.4  # [font sizes] between the readings of a stream


class Strips:
    """Text above and below a surface, in sizes proportional to the picture's width."""

    def __init__(self, width: int, text: float = 1.0) -> None:
        unit = text * width / 960.0
        self.width = width
        self.head = round(62 * unit)  # [px] height above the surface
        self.foot = round(48 * unit)  # [px] height below it
        self.margin = round(24 * unit)  # [px] minimum margin beside the surface
        self.small = round(18 * unit)  # [px] font sizes
        self.middle = round(22 * unit)
        self.large = round(27 * unit)
        self._slot = round(104 * unit)  # [px] maximum width of a reading
        self._icons = marks.ModuleSprites(round(20 * unit))
        self._gap = self._icons.cell // 2  # [px] between a legend's signs and words

    def write_head(self, canvas: pygame.Surface, area: pygame.Rect, scene: Scene) -> None:
        """Write title and readings above an area. For a stream, add the numbers of departures."""
        numbers = [(label, text, ink.INK) for label, text in scene.readings]
        middle, title, slots = self.head // 2, scene.title, len(numbers)
        if scene.traffic is None:  # equal slots
            size, lift, room = self.middle, 1, area.width
            starts, rooms = [], []
            if numbers:
                title_width = min(ink.text_width(title, self.large) + self.margin, area.width // 4)
                slot = min(self._slot, (area.width - title_width) // slots)
                starts = [area.right - slot * (slots - k) for k in range(slots)]
                rooms = [slot - 6] * slots
                room = area.width - slots * slot - self.margin
        else:  # slots as wide as their texts
            size, lift = self.large, 3
            wrong = scene.traffic.missorted
            numbers.append(("delivered", str(sum(scene.traffic.delivered)), ink.INK))
            numbers.append(("wrong", str(wrong), ink.GOAL if wrong else ink.INK))
            room = min(ink.text_width(title, self.large), area.width // 3)
            starts, rooms = self._fitted_slots(area, numbers, room)
        ink.write(canvas, title, self.large, ink.INK, room, midleft=(area.left, middle))
        for (label, text, colour), x, width in zip(numbers, starts, rooms, strict=True):
            ink.write(
                canvas, label, self.small, ink.FAINT_INK, width, bottomleft=(x, middle - lift)
            )
            ink.write(canvas, text, size, colour, width, topleft=(x, middle + 2 - lift))

    def write_foot(self, canvas: pygame.Surface, layout: PixelLayout, scene: Scene) -> None:
        """Write legend, tilt and scale bar below a surface."""
        area = layout.area
        end = self._write_scale(canvas, area, layout)
        if scene.tilt != 0.0:
            place = (end - self.margin, self._middle_below(area))
            end = self._write_tilt(canvas, scene.tilt, scene.tilt_direction, place)
        end -= self.margin
        x = self._write_axes(canvas, area, scene)
        if scene.goal is not None:
            x = self._write_stroke(canvas, area, "goal", ink.GOAL, x)
        if any(parcel.sensed_pose is not None for parcel in scene.parcels):
            x = self._write_stroke(canvas, area, "sensed", ink.SENSED, x)
        gap, middle = self._gap, self._middle_below(area)
        if scene.exits:
            after = (x + 3 * gap, middle)
            x = ink.write(canvas, "exit", self.small, ink.FAINT_INK, midleft=after).right + gap // 2
        for index, mark in enumerate(scene.exits):
            if x + gap // 2 + ink.badge_width(mark.name, self.small) > end:
                break
            after, colour = (x + gap // 2, middle), marks.exit_colour(scene, index)
            x = ink.draw_badge(canvas, mark.name, self.small, colour, midleft=after).right

    def _fitted_slots(
        self, area: pygame.Rect, numbers: Sequence[tuple[str, str, ink.Colour]], title: int
    ) -> tuple[list[int], list[int]]:
        """Place `numbers` to the right of the title. Return their x [px] and widths [px]."""
        widths = [
            max(
                ink.text_width(label, self.small),
                ink.text_width("0" * max(3, len(text)), self.large),
            )
            for label, text, _ in numbers
        ]
        gap = round(_GAP * self.small)
        excess = sum(widths) + gap * len(widths) - (area.width - title - gap)
        slots = [width - max(0, -(-excess // len(widths))) for width in widths]
        first = area.right - sum(slots) - gap * (len(slots) - 1)
        starts = [first + sum(slots[:k]) + gap * k for k in range(len(slots))]
        return starts, [max(1, slot) for slot in slots]

    def _write_axes(self, canvas: pygame.Surface, area: pygame.Rect, scene: Scene) -> int:
        """Write the legend of modules and of the zone; return the x [px] of the legend's end."""
        write = self._write_angles if scene.drive is None else self._write_drives
        x = write(canvas, area)
        return x if scene.zone is None else self._write_zone(canvas, area, x)

    def _write_drives(self, canvas: pygame.Surface, area: pygame.Rect) -> int:
        """Write the legend of driven modules; return the x [px] of the legend's end."""
        middle, gap, icons = self._middle_below(area), self._gap, self._icons
        x = area.left
        for name, level in (("surface moves", marks.SPEED_LEVELS), ("stands", 0)):
            drawn = icons.arrow(0, level, pale=False).get_rect(midleft=(x, middle))
            canvas.blit(icons.arrow(0, level, pale=False), drawn)
            after = (drawn.right + gap // 2, middle)
            x = ink.write(canvas, name, self.small, ink.INK, midleft=after).right + gap
        return x - gap

    def _write_angles(self, canvas: pygame.Surface, area: pygame.Rect) -> int:
        """Write the legend of axis colours; return the x [px] of the legend's end."""
        middle, gap, icons = self._middle_below(area), self._gap, self._icons
        place = (area.left, middle)
        x = ink.write(canvas, "rotor axis", self.small, ink.FAINT_INK, midleft=place).right
        for name, angle in _LEGEND:
            icon = icons.sprite(round(math.degrees(angle)) % marks.ANGLES, pale=False)
            drawn = icon.get_rect(midleft=(x + gap, middle))
            canvas.blit(icon, drawn)
            after = (drawn.right + gap // 2, middle)
            x = ink.write(canvas, name, self.small, ink.INK, midleft=after).right
        return x

    def _write_zone(self, canvas: pygame.Surface, area: pygame.Rect, x: int) -> int:
        """Write the zone's legend to the right of `x` [px]; return x [px] of the legend's end."""
        middle, gap, icons = self._middle_below(area), self._gap, self._icons
        swatch = pygame.Rect(0, 0, round(1.2 * icons.cell), round(0.7 * icons.cell))
        swatch.midleft = (x + 2 * gap, middle)
        pygame.draw.rect(canvas, ink.ZONE, swatch)
        pygame.draw.rect(canvas, ink.ZONE_EDGE, swatch, 1)
        after = (swatch.right + gap // 2, middle)
        return ink.write(canvas, "zone", self.small, ink.INK, midleft=after).right

    def _write_stroke(
        self, canvas: pygame.Surface, area: pygame.Rect, name: str, colour: ink.Colour, x: int
    ) -> int:
        """Write the legend of a dashed stroke to the right of `x` [px]; return the end's x [px]."""
        middle, gap = self._middle_below(area), self._gap
        stroke = np.array([[x + 2 * gap, middle], [x + 4 * gap, middle]], dtype=np.float64)
        ink.dashes(canvas, stroke, 0.12 * self.small, colour, 0.5 * self.small)
        after = (x + 4 * gap + gap // 2, middle)
        return ink.write(canvas, name, self.small, ink.INK, midleft=after).right

    def _write_scale(self, canvas: pygame.Surface, area: pygame.Rect, layout: PixelLayout) -> int:
        """Draw the scale bar; return the x [px] of the bar's start."""
        third = layout.columns * layout.pitch[0] / 3.0
        metres = next((length for length in _BARS if length <= third), _BARS[-1])
        width, middle, right = round(layout.length(metres)), self._middle_below(area), area.right
        bar = pygame.Rect(right - width, middle + self.small // 3, width, max(2, self.small // 6))
        pygame.draw.rect(canvas, ink.INK, bar)
        place = (bar.centerx, bar.top - 2)
        text = ink.write(canvas, f"{metres:g} m", self.small, ink.INK, midbottom=place)
        return min(bar.left, text.left)

    def _write_tilt(
        self, canvas: pygame.Surface, tilt: float, direction: float, midright: tuple[int, int]
    ) -> int:
        """Write the tilt [rad] to the right of a downhill arrow. Return the arrow's left x [px].

        `midright` [px] is the middle of the text's right edge. If `tilt` is positive, `direction`
        [rad] points downhill.
        """
        text = f"downhill {abs(math.degrees(tilt)):.1f}°"
        area = ink.write(canvas, text, self.small, ink.INK, midright=midright)
        tip, begin = area.left - 8, area.left - 8 - 2 * self.small
        middle = np.array([0.5 * (begin + tip), area.centery])
        half = math.copysign(0.5 * (tip - begin), tilt)  # pixels count downwards, y upwards
        way = half * np.array([math.cos(direction), -math.sin(direction)])
        ink.arrow(canvas, middle - way, middle + way, 0.13 * self.small, ink.INK)
        return begin

    def _middle_below(self, area: pygame.Rect) -> int:
        """Compute the y [px] of the middle of the strip below an area."""
        return area.bottom + self.foot // 2


Picture = NDArray[np.uint8]  # (height, width, 3)

WIDTH, WIDE = 960, 1280  # [px] default width of a picture, and with traffic or many scenes
_NARROWEST = 640  # [px] minimum width for readable text
_LEAST_CELL = 6  # [px] minimum size of an element for a visible axis
_ASPECT = 1.6  # target of width / height with tiles
_CAPTION = (40, 28, 30)  # [px] height, font size and left margin


class Painter:
    """Painter of successive scenes, with a cache of the parts that do not change.

    Args:
        width: [px] width of the pictures, an even number for video codecs. The default is 960, or
            1280 for a scene of a stream (with `traffic`).
        text: size of the text above and below the surface, relative to the default.
    """

    def __init__(self, width: int | None = None, text: float = 1.0) -> None:
        self._width = None if width is None else _even_width(width)
        self._text = checks.positive("text", text)
        self._strips: Strips | None = None
        self._layout: PixelLayout | None = None
        self._sprites = marks.ModuleSprites(_LEAST_CELL)
        self._ground: pygame.Surface | None = None  # of a surface, as `_ground_key` describes it
        self._ground_key: tuple[object, ...] = ()
        self._canvas: pygame.Surface | None = None

    def draw(self, scene: Scene) -> Picture:
        """Draw a scene as a picture (height, width, 3).

        The picture's height is even, and depends on the number of visible rows. With one parcel,
        all rows are visible. With a stream, only rotor rows and some rows beside them are visible.
        """
        layout, strips = self._prepare(scene)
        area = layout.area
        canvas = self._clean_canvas(strips.width, strips.head + area.height + strips.foot)
        strips.write_head(canvas, area, scene)
        strips.write_foot(canvas, layout, scene)
        canvas.set_clip(area.inflate(2 * strips.margin, 0))
        self._draw_field(canvas, layout, scene)
        marks.label_goal(canvas, layout, scene, strips.small)
        return _pixels(canvas)

    def _prepare(self, scene: Scene) -> tuple[PixelLayout, Strips]:
        """Return layout and strips for a scene. Drop cached parts that do not fit this scene."""
        width = self._width or (WIDTH if scene.traffic is None else WIDE)
        if self._strips is None or self._strips.width != width:
            self._strips = Strips(width, self._text)
        margin, across = self._strips.margin, PixelLayout.cells_across(scene)
        cell = (width - 2 * margin) // across
        if cell < _LEAST_CELL:
            least = 2 * margin + _LEAST_CELL * across
            raise ValueError(
                f"width must be at least {least} for {scene.columns} columns, got {width}"
            )
        left = (width - PixelLayout.extent(scene, cell)[0]) // 2
        layout = PixelLayout.of(scene, cell, left, self._strips.head)
        if self._layout != layout:
            self._layout, self._ground = layout, None
            self._sprites = marks.ModuleSprites(layout.cell)
        return layout, self._strips

    def _draw_field(self, canvas: pygame.Surface, layout: PixelLayout, scene: Scene) -> None:
        """Draw surface, goal, exits, queue and parcels."""
        clip = canvas.get_clip()
        canvas.blit(self._painted_ground(layout, scene), layout.area)
        canvas.set_clip(layout.plate.clip(clip))
        marks.draw_modules(canvas, layout, self._sprites, scene)
        canvas.set_clip(clip)
        marks.draw_counts(canvas, layout, scene)
        if scene.traffic is not None:
            canvas.set_clip(layout.passable.clip(clip))
        marks.draw_goal(canvas, layout, scene)
        for parcel in scene.parcels:
            marks.draw_trail(canvas, layout, parcel)
        for parcel in scene.parcels:
            marks.draw_parcel(canvas, layout, scene, parcel)
            marks.draw_sensed(canvas, layout, parcel)
            if isinstance(scene.goal, Heading):
                marks.draw_asked_heading(canvas, layout, scene.goal, parcel)
        for first, second in scene.touching:
            marks.draw_touch(canvas, layout, scene.parcels[first], scene.parcels[second])
        canvas.set_clip(clip)

    def _painted_ground(self, layout: PixelLayout, scene: Scene) -> pygame.Surface:
        traffic = scene.traffic and (scene.traffic.inlets, scene.traffic.runs)
        key = (scene.rotor.tobytes(), scene.zone, scene.exits, traffic)
        if self._ground is None or key != self._ground_key:
            self._ground, self._ground_key = marks.paint_ground(layout, scene), key
        return self._ground

    def _clean_canvas(self, width: int, height: int) -> pygame.Surface:
        """Return a cleared canvas. To save time, reuse the last canvas of the same size."""
        size = (width, height + height % 2)
        if self._canvas is None or self._canvas.get_size() != size:
            self._canvas = pygame.Surface(size, depth=32)
        self._canvas.set_clip(None)
        self._canvas.fill(ink.PAPER)
        return self._canvas


def draw(scene: Scene, width: int | None = None) -> Picture:
    """Draw a scene as a picture (height, width, 3). For many scenes, use one `Painter`."""
    return Painter(width).draw(scene)


def with_caption(picture: Picture, text: str) -> Picture:
    """Put a line of text above a picture. A text that is too long is cut."""
    height, size, margin = _CAPTION
    width = picture.shape[1]
    canvas = pygame.Surface((width, height))
    canvas.fill(ink.PAPER)
    ink.write(canvas, text, size, ink.INK, width - 2 * margin, midleft=(margin, height // 2 + 4))
    return np.concatenate([np.swapaxes(pygame.surfarray.array3d(canvas), 0, 1), picture])


def side_by_side(pictures: Sequence[Picture], width: int = WIDE) -> Picture:
    """Shrink pictures of equal shape (height, width, 3), and put them in rows of a large picture.

    The large picture has about the proportions of a screen, and an even height.
    """
    high, wide, _ = pictures[0].shape
    across = max(1, round(math.sqrt(_ASPECT * len(pictures) * high / wide)))
    tile = (width // across, round(high * (width // across) / wide))
    height = -(-len(pictures) // across) * tile[1]
    canvas = pygame.Surface((width, height + height % 2), depth=32)
    canvas.fill(ink.PAPER)
    for k, picture in enumerate(pictures):
        row, column = divmod(k, across)
        small = pygame.surfarray.make_surface(picture.swapaxes(0, 1))
        canvas.blit(pygame.transform.smoothscale(small, tile), (column * tile[0], row * tile[1]))
    return _pixels(canvas)


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
    for channel in range(3):  # four times faster than all three at once
        pixels[..., channel] = held[..., channel]
    return pixels


# drivers of SDL without a display, which SDL selects as a last resort
UNSEEN = ("dummy", "offscreen")


class Window:
    """Window that shows pictures at a frame rate, until the user or `close` closes it.

    The first picture opens the window. pygame has one window per process. If there is no display,
    pictures are drawn off screen as in Gymnasium, and a warning says that there is no display.

    Args:
        frame_rate: [1/s] maximum frame rate. `show` waits until the next picture is due.
    """

    def __init__(self, title: str = "Smart surface", frame_rate: float = 25.0) -> None:
        self._title = title
        self._frame_rate = checks.positive("frame_rate", frame_rate)
        self._clock = pygame.time.Clock()
        self._screen: pygame.Surface | None = None
        self.closed = False  # closed by the user or `close`; does not reopen

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3) until the next frame. A closed window shows nothing."""
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
        """Close the window; a second call has no effect."""
        self.closed = True
        if self._screen is not None:
            self._screen = None
            pygame.display.quit()

    def _opened(self, size: tuple[int, int]) -> pygame.Surface:
        try:
            pygame.display.init()
            if pygame.display.get_driver() in UNSEEN and "SDL_VIDEODRIVER" not in os.environ:
                warnings.warn("there is no display: the window is drawn off screen", stacklevel=2)
            screen = pygame.display.set_mode(size)
        except pygame.error as error:
            raise RuntimeError(f"a window needs a display: {error}") from error
        pygame.display.set_caption(self._title)
        return screen
