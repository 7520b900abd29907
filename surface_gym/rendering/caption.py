"""A caption over a picture."""

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.rendering.lettering import write
from surface_gym.rendering.palette import INK, PAPER

HEIGHT = 40  # [px]
SIZE = 28  # [px] of the font
MARGIN = 30  # [px] on the left, as the pictures have it


def with_caption(picture: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """A picture (height, width, 3) under a line of text, which is cut where it has no room."""
    width = picture.shape[1]
    canvas = pygame.Surface((width, HEIGHT))
    canvas.fill(PAPER)
    write(canvas, text, SIZE, INK, width - 2 * MARGIN, midleft=(MARGIN, HEIGHT // 2 + 4))
    line = np.swapaxes(pygame.surfarray.array3d(canvas), 0, 1)
    return np.concatenate([line, picture])
