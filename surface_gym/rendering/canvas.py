"""The sheet a picture is drawn on: even in width and height, as video codecs want it."""

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.rendering.palette import PAPER

_NARROWEST = 640  # [px] for the texts to be read


def even_width(width: int) -> int:
    """The width of a picture, or an error where it is odd or too small."""
    checks.integer("width", width, least=_NARROWEST)
    if width % 2:
        raise ValueError(f"width must be even, got {width!r}")
    return int(width)


def new_canvas(width: int, height: int) -> pygame.Surface:
    """An empty sheet, a pixel higher where the height is odd."""
    canvas = pygame.Surface((width, height + height % 2), depth=32)
    canvas.fill(PAPER)
    return canvas


def canvas_pixels(canvas: pygame.Surface) -> NDArray[np.uint8]:
    """(height, width, 3) red, green and blue."""
    width, height = canvas.get_size()
    held = pygame.surfarray.pixels3d(canvas).swapaxes(0, 1)
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    for channel in range(3):  # four times as fast as all three at once
        pixels[..., channel] = held[..., channel]
    return pixels
