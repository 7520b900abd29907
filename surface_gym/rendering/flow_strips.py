"""The strips above and below a stream's line: title and readings, legend and scale."""

from collections.abc import Sequence

import pygame

from surface_gym.rendering.exit_marks import badge_width, draw_badge
from surface_gym.rendering.flow_layout import FlowLayout
from surface_gym.rendering.flow_scene import FlowScene
from surface_gym.rendering.lettering import width_of, write
from surface_gym.rendering.palette import FAINT_INK, GOAL, INK, SENSED, exit_colour
from surface_gym.rendering.strips import Strips

_GAP = 1.4  # [font sizes] between readings


def write_head(canvas: pygame.Surface, strips: Strips, area: pygame.Rect, scene: FlowScene) -> None:
    """Write title and readings above an area, those right and wrong at the right end."""
    numbers = [(label, text, INK) for label, text in scene.readings]
    numbers.append(("right", str(sum(scene.delivered)), INK))
    numbers.append(("wrong", str(scene.missorted), GOAL if scene.missorted else INK))
    widths = [
        max(width_of(label, strips.small), width_of("0" * max(3, len(text)), strips.large))
        for label, text, _ in numbers
    ]
    gap, middle = round(_GAP * strips.small), strips.head // 2
    title = min(width_of(scene.title, strips.large), area.width // 3)
    excess = sum(widths) + gap * len(widths) - (area.width - title - gap)
    slots = [width - max(0, -(-excess // len(widths))) for width in widths]
    x = area.right - sum(slots) - gap * (len(slots) - 1)
    write(canvas, scene.title, strips.large, INK, title, midleft=(area.left, middle))
    for (label, text, colour), slot in zip(numbers, slots, strict=True):
        room = max(1, slot)
        write(canvas, label, strips.small, FAINT_INK, room, bottomleft=(x, middle - 3))
        write(canvas, text, strips.large, colour, room, topleft=(x, middle - 1))
        x += slot + gap


def write_foot(
    canvas: pygame.Surface, strips: Strips, layout: FlowLayout, scene: FlowScene
) -> None:
    """Write legend, tilt and scale bar below a line."""
    area = pygame.Rect(layout.area)
    end = strips.write_measures(canvas, area, layout.view, scene.tilt)
    write_legend(canvas, strips, area, [scene], end - strips.margin)


def write_legend(
    canvas: pygame.Surface,
    strips: Strips,
    area: pygame.Rect,
    scenes: Sequence[FlowScene],
    end: int | None = None,
) -> None:
    """Write what the colours in some scenes mean, below an area; exits as far as there is room.

    Args:
        canvas: what to write on.
        strips: whose sizes and signs to use.
        area: below which to write.
        scenes: whose marks to explain.
        end: [px] x where the room ends; by default at the area's right.
    """
    end = area.right if end is None else end
    gap, middle = strips.gap, strips.middle_below(area)
    x = strips.write_axes(canvas, area, any(scene.zone is not None for scene in scenes))
    if any(parcel.sensed_pose is not None for scene in scenes for parcel in scene.parcels):
        x = strips.write_stroke(canvas, area, "sensed", SENSED, x)
    marks = max((scene.exits for scene in scenes), key=len)
    if marks:
        after = (x + 3 * gap, middle)
        x = write(canvas, "exit", strips.small, FAINT_INK, midleft=after).right + gap // 2
    for place, mark in enumerate(marks):
        if x + gap // 2 + badge_width(mark.name, strips.small) > end:
            break
        after = (x + gap // 2, middle)
        x = draw_badge(canvas, mark.name, strips.small, exit_colour(place), midleft=after).right
