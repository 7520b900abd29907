"""Marks of the exits of a stream: chutes, the way straight on, and the queue at the entry."""

from functools import lru_cache

import numpy as np
import pygame

from surface_gym.rendering import ink
from surface_gym.rendering.flow_layout import FlowLayout
from surface_gym.rendering.flow_scene import ExitMark, FlowScene
from surface_gym.rendering.lettering import width_of, write
from surface_gym.rendering.palette import (
    FAINT_INK,
    INK,
    PARCEL,
    PLATE,
    Colour,
    exit_colour,
    mixed,
    text_on,
)

_QUEUE_SHOWN = 3  # parcels drawn at the entry, at most
_PALEST, _DARKEST = 0.86, 0.45  # shares of the plate in a mouth, inside and outside


def label_size(cell: int) -> int:
    """[px] of the font beside a line whose elements are `cell` pixels wide."""
    return max(12, round(1.35 * cell))


def paint_exit(canvas: pygame.Surface, layout: FlowLayout, mark: ExitMark, colour: Colour) -> None:
    """Paint what of an exit never changes: its mouth, and the ground of its label."""
    mouth, label, cell = layout.mouth(mark), layout.label(mark), layout.cell
    outward = (1, 0) if mark.side == 0 else (0, -mark.side)
    _paint_fading(canvas, mouth, outward, colour)
    rail = max(2, cell // 6)
    if mark.side == 0:
        pygame.draw.rect(canvas, colour, (mouth.left, mouth.top - rail, mouth.width, rail))
        pygame.draw.rect(canvas, colour, (mouth.left, mouth.bottom, mouth.width, rail))
        _paint_pointed(canvas, label.inflate(0, 2 * rail), colour)
        return
    pygame.draw.rect(canvas, colour, (mouth.left, mouth.top, rail, mouth.height))
    pygame.draw.rect(canvas, colour, (mouth.right - rail, mouth.top, rail, mouth.height))
    _paint_chevron(canvas, mouth, mark.side, cell, colour)
    rounded = round(0.4 * cell)
    top, bottom = (rounded, 0) if mark.side > 0 else (0, rounded)
    pygame.draw.rect(
        canvas,
        colour,
        label,
        border_top_left_radius=top,
        border_top_right_radius=top,
        border_bottom_left_radius=bottom,
        border_bottom_right_radius=bottom,
    )


def write_label(
    canvas: pygame.Surface, layout: FlowLayout, mark: ExitMark, colour: Colour, count: int
) -> None:
    """Write an exit's name and how many parcels it has got; what has no room is cut."""
    label, size, text = layout.label(mark), label_size(layout.cell), text_on(colour)
    if mark.side == 0:
        room = round(0.75 * label.width)
        x, middle = label.left + label.width * 3 // 7, label.centery
        write(canvas, mark.name, size, text, room, midbottom=(x, middle + size // 10))
        write(canvas, str(count), round(1.25 * size), text, room, midtop=(x, middle + size // 10))
        return
    number, large = str(count), round(1.25 * size)
    gap, taken = size // 2, width_of(number, large)
    room = max(1, label.width - taken - 2 * gap)
    name = min(width_of(mark.name, size), room)
    left = label.centerx - (name + gap + taken) // 2
    middle = label.centery + 1
    write(canvas, mark.name, size, text, room, midleft=(left, middle))
    write(canvas, number, large, text, midleft=(left + name + gap, middle))


def draw_exits(canvas: pygame.Surface, layout: FlowLayout, scene: FlowScene) -> None:
    """Write on all exits of a scene what they have got."""
    for place, (mark, count) in enumerate(zip(scene.exits, scene.delivered, strict=True)):
        write_label(canvas, layout, mark, exit_colour(place), count)


def draw_queue(canvas: pygame.Surface, layout: FlowLayout, waiting: int) -> None:
    """Draw how many parcels wait at the entry."""
    cell, rotors = layout.cell, layout.rotors
    left, right = layout.area[0], rotors.left
    size, side, step = label_size(cell), round(0.8 * cell), round(1.05 * cell)
    shown, rounded = min(waiting, _QUEUE_SHOWN), max(1, cell // 8)
    middle, x = (left + right) // 2, (left + right - (shown - 1) * step) // 2
    for k in range(shown):
        box = pygame.Rect(0, 0, side, side)
        box.midtop = (x + k * step, rotors.bottom + cell // 2)
        pygame.draw.rect(canvas, mixed(PARCEL, PLATE, 0.3), box, border_radius=rounded)
        pygame.draw.rect(canvas, INK, box, max(1, cell // 10), border_radius=rounded)
    colour, room = INK if waiting else FAINT_INK, right - left
    place = (middle, rotors.bottom + round(1.6 * cell))
    number = write(canvas, str(waiting), round(1.5 * size), colour, room, midtop=place)
    if width_of("waiting", size) <= room:
        write(canvas, "waiting", size, colour, midtop=(middle, number.bottom))


def draw_badge(
    canvas: pygame.Surface, text: str, size: int, colour: Colour, **place: tuple[int, int]
) -> pygame.Rect:
    """Draw a label in an exit's colour, as `write` does a text; the area taken."""
    badge = _badge(text, size, colour)
    area = badge.get_rect(**place)
    canvas.blit(badge, area)
    return area


def badge_width(text: str, size: int) -> int:
    """[px] a label takes."""
    return max(round(0.95 * size), width_of(text, size) + size // 2)


@lru_cache(maxsize=256)
def _badge(text: str, size: int, colour: Colour) -> pygame.Surface:
    height = round(0.95 * size)
    badge = pygame.Surface((badge_width(text, size), height), pygame.SRCALPHA)
    area = badge.get_rect()
    pygame.draw.rect(badge, colour, area, border_radius=height // 2)
    write(badge, text, size, text_on(colour), center=(area.centerx, area.centery + 1))
    return badge


def _paint_fading(
    canvas: pygame.Surface, area: pygame.Rect, outward: tuple[int, int], colour: Colour
) -> None:
    """Fill a mouth with a colour that grows outwards."""
    length = area.width if outward[0] else area.height
    for k in range(length):
        share = _PALEST + (_DARKEST - _PALEST) * (k + 0.5) / length
        shade = mixed(colour, PLATE, share)
        if outward[0]:
            stripe = pygame.Rect(area.left + k, area.top, 1, area.height)
        else:
            y = area.bottom - 1 - k if outward[1] < 0 else area.top + k
            stripe = pygame.Rect(area.left, y, area.width, 1)
        canvas.fill(shade, stripe)


def _paint_chevron(
    canvas: pygame.Surface, mouth: pygame.Rect, side: int, cell: int, colour: Colour
) -> None:
    """Paint an outward angle in a chute that has room for it."""
    if mouth.height < 2 * cell:
        return
    width = min(2.4 * cell, 0.4 * mouth.width)
    middle = np.array([mouth.centerx, mouth.centery], dtype=np.float64)
    for step in (-0.5, 0.5):
        tip = middle - [0.0, side * (step + 0.5) * cell]
        arm = np.array([0.5 * width, side * 0.3 * width])
        points = np.array([tip + arm * [-1.0, 1.0], tip, tip + arm])
        ink.line(canvas, points, 0.3 * cell, colour, 0.8)


def _paint_pointed(canvas: pygame.Surface, area: pygame.Rect, colour: Colour) -> None:
    """Paint a block that points along x."""
    neck = area.right - 0.25 * area.width
    corners = [
        area.topleft,
        (neck, area.top),
        (area.right, area.centery),
        (neck, area.bottom),
        area.bottomleft,
    ]
    ink.polygon(canvas, np.array(corners, dtype=np.float64), colour)
