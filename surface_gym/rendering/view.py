"""From metres to pixels, y upwards."""

from dataclasses import dataclass

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from surface_gym.rendering.scene import Scene


@dataclass(frozen=True)
class View:
    """A surface's place in a picture; an element takes a whole number of pixels."""

    rows: int
    columns: int
    pitch: float  # [m] between elements
    origin: tuple[float, float]  # [m] centre of element [0, 0]
    cell: int  # [px] between elements
    left: int  # [px] of the surface's corner in the picture
    top: int  # [px]

    @classmethod
    def of(cls, scene: Scene, cell: int, left: int, top: int) -> "View":
        """The view of a scene's surface."""
        return cls(scene.rows, scene.columns, scene.pitch, scene.origin, cell, left, top)

    @property
    def area(self) -> pygame.Rect:
        """Of the whole surface."""
        return pygame.Rect(self.left, self.top, self.columns * self.cell, self.rows * self.cell)

    def cells(self, first_row: int, rows: int, first_column: int, columns: int) -> pygame.Rect:
        """The area of a block of elements."""
        return pygame.Rect(
            self.left + first_column * self.cell,
            self.top + (self.rows - first_row - rows) * self.cell,
            columns * self.cell,
            rows * self.cell,
        )

    def length(self, metres: float) -> float:
        """[px] of a length."""
        return metres / self.pitch * self.cell

    def pixels(self, points: ArrayLike) -> NDArray[np.float64]:
        """(..., 2) [px] of points (..., 2) [m]."""
        steps = (np.asarray(points, dtype=np.float64) - self.origin) / self.pitch + 0.5
        x = self.left + self.cell * steps[..., 0]
        y = self.top + self.cell * (self.rows - steps[..., 1])
        return np.stack([x, y], axis=-1)

    def metres(self, pixel: tuple[float, float]) -> tuple[float, float]:
        """[m] of a place in the picture: the way back from `pixels`."""
        right = (pixel[0] - self.left) / self.cell - 0.5
        up = self.rows - (pixel[1] - self.top) / self.cell - 0.5
        return (self.origin[0] + self.pitch * right, self.origin[1] + self.pitch * up)

    @property
    def stroke(self) -> float:
        """[px] width of a line."""
        return 1.0 + min(self.cell, 60) / 30.0
