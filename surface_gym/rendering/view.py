"""From metres to pixels, y upwards."""

from dataclasses import dataclass

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from surface_gym.rendering.elements import Elements


@dataclass(frozen=True)
class View:
    """A surface's place in a picture; an element takes a whole number of pixels each way."""

    rows: int
    columns: int
    pitch: tuple[float, float]  # [m] between elements, in x and in y
    origin: tuple[float, float]  # [m] centre of element [0, 0]
    width: int  # [px] between elements, in x
    height: int  # [px] in y
    left: int  # [px] of the surface's corner in the picture
    top: int  # [px]

    @classmethod
    def of(cls, scene: Elements, width: int, left: int, top: int) -> "View":
        """The view of a scene's surface, whose elements are `width` pixels wide."""
        height = height_of(scene, width)
        return cls(scene.rows, scene.columns, scene.pitches, scene.origin, width, height, left, top)

    @property
    def cell(self) -> int:
        """[px] the largest square that an element has room for."""
        return min(self.width, self.height)

    @property
    def area(self) -> pygame.Rect:
        """Of the whole surface."""
        return self.cells(0, self.rows, 0, self.columns)

    def cells(self, first_row: int, rows: int, first_column: int, columns: int) -> pygame.Rect:
        """The area of a block of elements."""
        return pygame.Rect(
            self.left + first_column * self.width,
            self.top + (self.rows - first_row - rows) * self.height,
            columns * self.width,
            rows * self.height,
        )

    def length(self, metres: float) -> float:
        """[px] of a length along x."""
        return metres / self.pitch[0] * self.width

    def pixels(self, points: ArrayLike) -> NDArray[np.float64]:
        """(..., 2) [px] of points (..., 2) [m]."""
        steps = (np.asarray(points, dtype=np.float64) - self.origin) / self.pitch + 0.5
        x = self.left + self.width * steps[..., 0]
        y = self.top + self.height * (self.rows - steps[..., 1])
        return np.stack([x, y], axis=-1)

    def metres(self, pixel: tuple[float, float]) -> tuple[float, float]:
        """[m] of a place in the picture: the way back from `pixels`."""
        right = (pixel[0] - self.left) / self.width - 0.5
        up = self.rows - (pixel[1] - self.top) / self.height - 0.5
        return (self.origin[0] + self.pitch[0] * right, self.origin[1] + self.pitch[1] * up)

    @property
    def stroke(self) -> float:
        """[px] width of a line."""
        return 1.0 + min(self.cell, 60) / 30.0


def height_of(scene: Elements, width: int) -> int:
    """[px] of an element that is `width` pixels wide."""
    pitch_x, pitch_y = scene.pitches
    return max(1, round(width * pitch_y / pitch_x))
