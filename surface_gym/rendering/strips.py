"""The strips above and below a surface: title and readings, legend and scale."""

import math
from collections.abc import Sequence

import numpy as np
import pygame

from surface_gym.rendering import ink
from surface_gym.rendering.lettering import width_of, write, write_reading
from surface_gym.rendering.modules import ANGLES, ModuleSprites
from surface_gym.rendering.palette import FAINT_INK, GOAL, INK, SENSED, ZONE, ZONE_EDGE, Colour
from surface_gym.rendering.scene import Scene
from surface_gym.rendering.view import View

LEGEND = (
    ("0°", 0.0),
    ("45°", math.pi / 4),
    ("\N{MINUS SIGN}45°", -math.pi / 4),
    ("90°", math.pi / 2),
)
_BARS = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01)  # [m] lengths a scale bar may have


class Strips:
    """Writes above and below a surface, in sizes that go with the picture's width."""

    def __init__(self, width: int) -> None:
        unit = width / 960.0
        self.head = round(62 * unit)  # [px] height above the surface
        self.foot = round(48 * unit)  # [px] height below it
        self.margin = round(24 * unit)  # [px] least room beside the surface
        self.small = round(18 * unit)  # [px] font sizes
        self.middle = round(22 * unit)
        self.large = round(27 * unit)
        self._slot = round(104 * unit)  # [px] of a reading, at most
        self._icons = ModuleSprites(round(20 * unit))

    def write_head(self, canvas: pygame.Surface, area: pygame.Rect, scene: Scene) -> None:
        """Write title and readings above an area; each reading has a slot of its own."""
        room, middle = area.width, area.top - self.head // 2
        if scene.readings:
            slots = len(scene.readings)
            title = min(width_of(scene.title, self.large) + self.margin, area.width // 4)
            slot = min(self._slot, (area.width - title) // slots)
            for k, (label, text) in enumerate(scene.readings):
                left = area.right - slot * (slots - k)
                sizes = (self.small, self.middle)
                write_reading(canvas, label, text, sizes, slot - 6, (left, middle))
            room = area.width - slots * slot - self.margin
        write(canvas, scene.title, self.large, INK, room, midleft=(area.left, middle))

    def write_foot(self, canvas: pygame.Surface, view: View, scene: Scene) -> None:
        """Write legend, tilt and scale bar below a surface."""
        self.write_legend(canvas, view.area, [scene])
        self.write_measures(canvas, view.area, view, scene.tilt)

    def write_measures(
        self, canvas: pygame.Surface, area: pygame.Rect, view: View, tilt: float
    ) -> int:
        """Write tilt and scale bar below an area, at its right; the x where they begin."""
        left = self._write_scale(canvas, area, view)
        if tilt == 0.0:
            return left
        return self._write_tilt(canvas, tilt, (left - self.margin, self.middle_below(area)))

    def write_legend(
        self, canvas: pygame.Surface, area: pygame.Rect, scenes: Sequence[Scene]
    ) -> None:
        """Write what the colours in some scenes mean, below an area."""
        x = self.write_axes(canvas, area, any(scene.zone is not None for scene in scenes))
        for name, colour, shown in (
            ("goal", GOAL, any(scene.goal is not None for scene in scenes)),
            ("sensed", SENSED, any(scene.sensed_pose is not None for scene in scenes)),
        ):
            if shown:
                x = self.write_stroke(canvas, area, name, colour, x)

    def write_axes(self, canvas: pygame.Surface, area: pygame.Rect, zone: bool) -> int:
        """Write what the modules' colours mean, below an area, and a zone's; the x at its end."""
        middle, gap = self.middle_below(area), self.gap
        x = write(canvas, "rotor axis", self.small, FAINT_INK, midleft=(area.left, middle)).right
        for name, angle in LEGEND:
            icon = self._icons.sprite(round(math.degrees(angle)) % ANGLES, pale=False)
            place = icon.get_rect(midleft=(x + gap, middle))
            canvas.blit(icon, place)
            after = (place.right + gap // 2, middle)
            x = write(canvas, name, self.small, INK, midleft=after).right
        if zone:
            swatch = pygame.Rect(0, 0, round(1.2 * self._icons.cell), round(0.7 * self._icons.cell))
            swatch.midleft = (x + 2 * gap, middle)
            pygame.draw.rect(canvas, ZONE, swatch)
            pygame.draw.rect(canvas, ZONE_EDGE, swatch, 1)
            after = (swatch.right + gap // 2, middle)
            x = write(canvas, "zone", self.small, INK, midleft=after).right
        return x

    def write_stroke(
        self, canvas: pygame.Surface, area: pygame.Rect, name: str, colour: Colour, x: int
    ) -> int:
        """Write what a dashed stroke means, below an area, after an x; the x at its end."""
        middle, gap = self.middle_below(area), self.gap
        stroke = np.array([[x + 2 * gap, middle], [x + 4 * gap, middle]], dtype=np.float64)
        ink.dashes(canvas, stroke, 0.12 * self.small, colour, 0.5 * self.small)
        after = (x + 4 * gap + gap // 2, middle)
        return write(canvas, name, self.small, INK, midleft=after).right

    @property
    def gap(self) -> int:
        """[px] between a legend's signs and words."""
        return self._icons.cell // 2

    def middle_below(self, area: pygame.Rect) -> int:
        """[px] the height of the legend's middle below an area."""
        return area.bottom + self.foot // 2

    def _write_scale(self, canvas: pygame.Surface, area: pygame.Rect, view: View) -> int:
        """Draw the scale bar; the x where it begins."""
        third = view.columns * view.pitch[0] / 3.0
        metres = next((length for length in _BARS if length <= third), _BARS[-1])
        width, middle, right = round(view.length(metres)), self.middle_below(area), area.right
        bar = pygame.Rect(right - width, middle + self.small // 3, width, max(2, self.small // 6))
        pygame.draw.rect(canvas, INK, bar)
        place = (bar.centerx, bar.top - 2)
        text = write(canvas, f"{metres:g} m", self.small, INK, midbottom=place)
        return min(bar.left, text.left)

    def _write_tilt(self, canvas: pygame.Surface, tilt: float, midright: tuple[int, int]) -> int:
        """Write the tilt with an arrow that points downhill; the x where it begins."""
        text = f"downhill {abs(math.degrees(tilt)):.1f}°"
        arrow_length = 2 * self.small
        area = write(canvas, text, self.small, INK, midright=midright)
        ends = np.array(
            [[area.left - 8 - arrow_length, area.centery], [area.left - 8, area.centery]]
        )
        tail, tip = ends.astype(np.float64) if tilt > 0.0 else ends[::-1].astype(np.float64)
        ink.arrow(canvas, tail, tip, 0.13 * self.small, INK)
        return area.left - 8 - arrow_length
