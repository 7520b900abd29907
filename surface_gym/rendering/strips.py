"""The strips above and below a surface: title and readings, legend, tilt and scale."""

import math
from collections.abc import Sequence

import numpy as np
import pygame

from surface_gym.rendering import ink
from surface_gym.rendering.ink import (
    FAINT_INK,
    GOAL,
    INK,
    SENSED,
    ZONE,
    ZONE_EDGE,
    Colour,
    exit_colour,
)
from surface_gym.rendering.scene import Layout, Scene
from surface_gym.rendering.surface_marks import ANGLES, ModuleSprites

_LEGEND = (
    ("0°", 0.0),
    ("45°", math.pi / 4),
    ("\N{MINUS SIGN}45°", -math.pi / 4),
    ("90°", math.pi / 2),
)
_BARS = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01)  # [m] lengths a scale bar may have
_GAP = 1.4  # [font sizes] between the readings of a stream


class Strips:
    """Writes above and below a surface, in sizes proportional to the picture's width.

    Args:
        width: [px] of the picture.
    """

    def __init__(self, width: int) -> None:
        unit = width / 960.0
        self.width = width
        self.head = round(62 * unit)  # [px] height above the surface
        self.foot = round(48 * unit)  # [px] height below it
        self.margin = round(24 * unit)  # [px] least room beside the surface
        self.small = round(18 * unit)  # [px] font sizes
        self.middle = round(22 * unit)
        self.large = round(27 * unit)
        self._slot = round(104 * unit)  # [px] of a reading, at most
        self._icons = ModuleSprites(round(20 * unit))
        self._gap = self._icons.cell // 2  # [px] between a legend's signs and words

    def write_head(self, canvas: pygame.Surface, area: pygame.Rect, scene: Scene) -> None:
        """Write title and readings above an area; with traffic also the parcels right and wrong."""
        numbers = [(label, text, INK) for label, text in scene.readings]
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
            numbers.append(("right", str(sum(scene.traffic.delivered)), INK))
            numbers.append(("wrong", str(wrong), GOAL if wrong else INK))
            room = min(ink.text_width(title, self.large), area.width // 3)
            starts, rooms = self._fitted_slots(area, numbers, room)
        ink.write(canvas, title, self.large, INK, room, midleft=(area.left, middle))
        for (label, text, colour), x, width in zip(numbers, starts, rooms, strict=True):
            ink.write(canvas, label, self.small, FAINT_INK, width, bottomleft=(x, middle - lift))
            ink.write(canvas, text, size, colour, width, topleft=(x, middle + 2 - lift))

    def write_foot(self, canvas: pygame.Surface, layout: Layout, scene: Scene) -> None:
        """Write legend, tilt and scale bar below a surface."""
        area = layout.area
        end = self._write_scale(canvas, area, layout)
        if scene.tilt != 0.0:
            place = (end - self.margin, self._middle_below(area))
            end = self._write_tilt(canvas, scene.tilt, place)
        self.write_legend(canvas, area, [scene], end - self.margin)

    def write_legend(
        self, canvas: pygame.Surface, area: pygame.Rect, scenes: Sequence[Scene], end: int
    ) -> None:
        """Write the meaning of the colours in some scenes, below an area.

        Args:
            canvas: to write on.
            area: below which to write.
            scenes: whose marks to explain.
            end: [px] x where the room ends; exits beyond are left out.
        """
        x = self._write_axes(canvas, area, any(scene.zone is not None for scene in scenes))
        if any(scene.goal is not None for scene in scenes):
            x = self._write_stroke(canvas, area, "goal", GOAL, x)
        if any(parcel.sensed_pose is not None for scene in scenes for parcel in scene.parcels):
            x = self._write_stroke(canvas, area, "sensed", SENSED, x)
        marks = max((scene.exits for scene in scenes), key=len)
        gap, middle = self._gap, self._middle_below(area)
        if marks:
            after = (x + 3 * gap, middle)
            x = ink.write(canvas, "exit", self.small, FAINT_INK, midleft=after).right + gap // 2
        for index, mark in enumerate(marks):
            if x + gap // 2 + ink.badge_width(mark.name, self.small) > end:
                break
            after, colour = (x + gap // 2, middle), exit_colour(index)
            x = ink.draw_badge(canvas, mark.name, self.small, colour, midleft=after).right

    def _fitted_slots(
        self, area: pygame.Rect, numbers: Sequence[tuple[str, str, Colour]], title: int
    ) -> tuple[list[int], list[int]]:
        """Compute the x of each reading of a stream, and its room [px], at the right of an area."""
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

    def _write_axes(self, canvas: pygame.Surface, area: pygame.Rect, zone: bool) -> int:
        """Write the meaning of the modules' colours and of a zone's; the x at its end."""
        middle, gap, icons = self._middle_below(area), self._gap, self._icons
        place = (area.left, middle)
        x = ink.write(canvas, "rotor axis", self.small, FAINT_INK, midleft=place).right
        for name, angle in _LEGEND:
            icon = icons.sprite(round(math.degrees(angle)) % ANGLES, pale=False)
            drawn = icon.get_rect(midleft=(x + gap, middle))
            canvas.blit(icon, drawn)
            after = (drawn.right + gap // 2, middle)
            x = ink.write(canvas, name, self.small, INK, midleft=after).right
        if zone:
            swatch = pygame.Rect(0, 0, round(1.2 * icons.cell), round(0.7 * icons.cell))
            swatch.midleft = (x + 2 * gap, middle)
            pygame.draw.rect(canvas, ZONE, swatch)
            pygame.draw.rect(canvas, ZONE_EDGE, swatch, 1)
            after = (swatch.right + gap // 2, middle)
            x = ink.write(canvas, "zone", self.small, INK, midleft=after).right
        return x

    def _write_stroke(
        self, canvas: pygame.Surface, area: pygame.Rect, name: str, colour: Colour, x: int
    ) -> int:
        """Write the meaning of a dashed stroke after an x; the x at its end."""
        middle, gap = self._middle_below(area), self._gap
        stroke = np.array([[x + 2 * gap, middle], [x + 4 * gap, middle]], dtype=np.float64)
        ink.dashes(canvas, stroke, 0.12 * self.small, colour, 0.5 * self.small)
        after = (x + 4 * gap + gap // 2, middle)
        return ink.write(canvas, name, self.small, INK, midleft=after).right

    def _write_scale(self, canvas: pygame.Surface, area: pygame.Rect, layout: Layout) -> int:
        """Draw the scale bar; the x where it begins."""
        third = layout.columns * layout.pitch[0] / 3.0
        metres = next((length for length in _BARS if length <= third), _BARS[-1])
        width, middle, right = round(layout.length(metres)), self._middle_below(area), area.right
        bar = pygame.Rect(right - width, middle + self.small // 3, width, max(2, self.small // 6))
        pygame.draw.rect(canvas, INK, bar)
        place = (bar.centerx, bar.top - 2)
        text = ink.write(canvas, f"{metres:g} m", self.small, INK, midbottom=place)
        return min(bar.left, text.left)

    def _write_tilt(self, canvas: pygame.Surface, tilt: float, midright: tuple[int, int]) -> int:
        """Write the tilt with an arrow that points downhill; the x where it begins."""
        text = f"downhill {abs(math.degrees(tilt)):.1f}°"
        area = ink.write(canvas, text, self.small, INK, midright=midright)
        tip, begin = area.left - 8, area.left - 8 - 2 * self.small
        ends = np.array([[begin, area.centery], [tip, area.centery]], dtype=np.float64)
        tail, head = ends if tilt > 0.0 else ends[::-1]
        ink.arrow(canvas, tail, head, 0.13 * self.small, INK)
        return begin

    def _middle_below(self, area: pygame.Rect) -> int:
        """Compute the height [px] of the legend's middle below an area."""
        return area.bottom + self.foot // 2
