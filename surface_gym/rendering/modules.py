"""Modules: discs with a bar along the rotor's axis, painted once for each degree."""

import math

import numpy as np
import pygame

from surface_gym.rendering import ink
from surface_gym.rendering.palette import PAPER, PLATE, axis_colour, mixed

ANGLES = 180  # sprites in half a turn
_PALE = 0.62  # share of the plate's colour in a module that does not obey


class ModuleSprites:
    """Pictures of a module, `cell` pixels in square, by axis angle; made when first asked for."""

    def __init__(self, cell: int) -> None:
        self.cell = cell
        self._sprites: dict[tuple[int, bool], pygame.Surface] = {}

    def sprite(self, step: int, pale: bool) -> pygame.Surface:
        """The module whose axis is at `step` of `ANGLES` in half a turn."""
        key = (step, pale)
        if key not in self._sprites:
            self._sprites[key] = self._painted(math.pi * step / ANGLES, pale)
        return self._sprites[key]

    def _painted(self, angle: float, pale: bool) -> pygame.Surface:
        colour, bar = axis_colour(angle), PAPER
        if pale:
            colour, bar = mixed(colour, PLATE, _PALE), mixed(bar, PLATE, _PALE)
        picture = pygame.Surface((self.cell, self.cell), pygame.SRCALPHA)
        picture.fill((*colour, 0))
        half = 0.5 * self.cell
        centre = np.array([half, half])
        along = 0.60 * half * np.array([math.cos(angle), -math.sin(angle)])
        ink.disc(picture, centre, 0.86 * half, colour)
        ink.line(picture, np.array([centre - along, centre + along]), max(0.26 * half, 1.0), bar)
        return picture
