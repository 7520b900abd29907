"""The surface itself: supports, zone and modules."""

import math

import numpy as np
import pygame

from surface_gym.rendering import ink, palette
from surface_gym.rendering.elements import Elements
from surface_gym.rendering.modules import ANGLES, ModuleSprites
from surface_gym.rendering.view import View


def painted_ground(view: View, scene: Elements) -> pygame.Surface:
    """A picture of the supports' plate and the zone, of the size of the view's area."""
    ground = pygame.Surface(view.area.size, depth=32)
    ground.fill(palette.PLATE)
    zone = None
    if scene.zone is not None:
        zone = view.cells(*scene.zone).move(-view.left, -view.top)
        ground.fill(palette.ZONE, zone)
    radius = max(0.07 * view.cell, 0.6)
    for row, column in np.argwhere(~scene.rotor).tolist():
        place = view.cells(row, 1, column, 1).move(-view.left, -view.top)
        centre = np.array([place.x + 0.5 * place.width, place.y + 0.5 * place.height])
        ink.disc(ground, centre, radius, palette.SUPPORT)
    pygame.draw.rect(ground, palette.PLATE_EDGE, ground.get_rect(), 1)
    if zone is not None:
        pygame.draw.rect(ground, palette.ZONE_EDGE, zone, max(1, round(0.75 * view.stroke)))
    return ground


def draw_modules(
    canvas: pygame.Surface, view: View, sprites: ModuleSprites, scene: Elements
) -> None:
    """Draw each rotor's module, pale where it does not obey."""
    row, column = np.nonzero(scene.rotor)
    steps = np.rint(scene.axis[row, column] * (ANGLES / math.pi)).astype(np.int64) % ANGLES
    pale = ~scene.obeys[row, column]
    left = view.left + view.width * column + (view.width - view.cell) // 2
    top = view.top + view.height * (view.rows - 1 - row) + (view.height - view.cell) // 2
    looks = zip(steps.tolist(), pale.tolist(), strict=True)
    pictures = [sprites.sprite(step, is_pale) for step, is_pale in looks]
    places = zip(left.tolist(), top.tolist(), strict=True)
    canvas.fblits(list(zip(pictures, places, strict=True)))
