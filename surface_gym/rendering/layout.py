"""Positions in a picture: from metres to pixels, y upwards."""

from dataclasses import dataclass

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from surface_gym.rendering.scene import ExitMark, Scene

_BESIDE = 0.5  # [m] shown on either side of the rotor rows, where there is traffic
_ENTRY = 4.0  # [cells] room for the queue, before the surface
_STRAIGHT = 6.0  # [cells] room for the way straight on, after it
_LABEL = 2.0  # [cells] height of the chutes' labels


@dataclass(frozen=True)
class Layout:
    """Positions of a surface and of the marks beside it in a picture.

    An element takes a whole number of pixels each way. With traffic, only the rotor rows and half
    a metre on either side are shown, between the labels of the exits.
    """

    rows: int
    columns: int
    pitch: tuple[float, float]  # [m] between elements, in x and in y
    origin: tuple[float, float]  # [m] centre of element [0, 0]
    width: int  # [px] between elements, in x
    height: int  # [px] in y
    left: int  # [px] of the corner of the whole surface, which may lie outside the picture
    top: int  # [px]
    line: tuple[int, int]  # first rotor row, and the number of rows to the last
    band: tuple[int, int]  # first row shown, and their number
    box: tuple[int, int, int, int]  # [px] left, top, width and height of all that is drawn

    @classmethod
    def of(cls, scene: Scene, cell: int, left: int, top: int) -> "Layout":
        """Place a scene's surface at a corner, with elements `cell` pixels wide."""
        line, band = _shown_rows(scene)
        height = _element_height(scene, cell)
        box = (left, top, *cls.extent(scene, cell))
        if scene.traffic is not None:
            hidden = scene.rows - sum(band)  # rows above the picture
            left += round(_ENTRY * cell)
            top += round(_LABEL * cell) - hidden * height
        rows, columns, pitch, origin = scene.rows, scene.columns, scene.pitches, scene.origin
        return cls(rows, columns, pitch, origin, cell, height, left, top, line, band, box)

    @staticmethod
    def extent(scene: Scene, cell: int) -> tuple[int, int]:
        """Compute the width and height [px] of a scene's drawing."""
        across, down = scene.columns * cell, _shown_rows(scene)[1][1] * _element_height(scene, cell)
        if scene.traffic is None:
            return (across, down)
        across = round(_ENTRY * cell) + across + round(_STRAIGHT * cell)
        return (across, down + 2 * round(_LABEL * cell))

    @staticmethod
    def cells_across(scene: Scene) -> int:
        """Count the elements that would take the same width."""
        return scene.columns if scene.traffic is None else round(_ENTRY + scene.columns + _STRAIGHT)

    @property
    def cell(self) -> int:
        """Side [px] of the largest square that an element has room for."""
        return min(self.width, self.height)

    @property
    def stroke(self) -> float:
        """Width [px] of a line."""
        return 1.0 + min(self.cell, 60) / 30.0

    @property
    def label_size(self) -> int:
        """Font size [px] of labels on exits and parcels."""
        return max(12, round(1.35 * self.cell))

    @property
    def area(self) -> pygame.Rect:
        """The area of all that is drawn."""
        return pygame.Rect(self.box)

    @property
    def surface(self) -> pygame.Rect:
        """The area of the whole surface."""
        return self.cells(0, self.rows, 0, self.columns)

    @property
    def plate(self) -> pygame.Rect:
        """The area of the rows shown."""
        return self.cells(*self.band, 0, self.columns)

    @property
    def rotors(self) -> pygame.Rect:
        """The area of the rotor rows."""
        return self.cells(*self.line, 0, self.columns)

    @property
    def passable(self) -> pygame.Rect:
        """The area from the entry to the line's end, in which the parcels of a stream are drawn."""
        plate, left = self.plate, self.box[0]
        return pygame.Rect(left, plate.top, plate.right - left, plate.height)

    def cells(self, first_row: int, rows: int, first_column: int, columns: int) -> pygame.Rect:
        """Compute the area of a block of elements."""
        return pygame.Rect(
            self.left + first_column * self.width,
            self.top + (self.rows - first_row - rows) * self.height,
            columns * self.width,
            rows * self.height,
        )

    def mouth(self, mark: ExitMark) -> pygame.Rect:
        """Compute the area of an exit: from the rotor rows outwards, or across them."""
        ends = self.pixels(np.array([[mark.first, 0.0], [mark.last, 0.0]]))[:, 0]
        left, right = (round(float(x)) for x in ends)
        plate, rotors = self.plate, self.rotors
        top, bottom = rotors.top, rotors.bottom
        if mark.side > 0:
            top, bottom = plate.top, rotors.top
        elif mark.side < 0:
            top, bottom = rotors.bottom, plate.bottom
        return pygame.Rect(left, top, right - left, bottom - top)

    def label(self, mark: ExitMark) -> pygame.Rect:
        """Compute the area of an exit's name and count."""
        mouth, plate, area = self.mouth(mark), self.plate, self.area
        if mark.side == 0:
            return pygame.Rect(plate.right, mouth.top, area.right - plate.right, mouth.height)
        if mark.side > 0:
            return pygame.Rect(mouth.left, area.top, mouth.width, plate.top - area.top)
        return pygame.Rect(mouth.left, plate.bottom, mouth.width, area.bottom - plate.bottom)

    def length(self, metres: float) -> float:
        """Convert a length along x to pixels."""
        return metres / self.pitch[0] * self.width

    def pixels(self, points: ArrayLike) -> NDArray[np.float64]:
        """Convert points (..., 2) [m] to pixels (..., 2)."""
        steps = (np.asarray(points, dtype=np.float64) - self.origin) / self.pitch + 0.5
        x = self.left + self.width * steps[..., 0]
        y = self.top + self.height * (self.rows - steps[..., 1])
        return np.stack([x, y], axis=-1)

    def metres(self, pixel: tuple[float, float]) -> tuple[float, float]:
        """Convert a position in the picture to metres: the inverse of `pixels`."""
        right = (pixel[0] - self.left) / self.width - 0.5
        up = self.rows - (pixel[1] - self.top) / self.height - 0.5
        return (self.origin[0] + self.pitch[0] * right, self.origin[1] + self.pitch[1] * up)


def _element_height(scene: Scene, width: int) -> int:
    """Compute the height [px] of an element that is `width` pixels wide."""
    pitch_x, pitch_y = scene.pitches
    return max(1, round(width * pitch_y / pitch_x))


def _shown_rows(scene: Scene) -> tuple[tuple[int, int], tuple[int, int]]:
    """Find the rotor rows and the rows shown, each as the first and their number."""
    everything = (0, scene.rows)
    rotors = np.flatnonzero(scene.rotor.any(axis=1))
    if len(rotors) == 0:
        return everything, everything
    first, last = int(rotors[0]), int(rotors[-1])
    line = (first, last - first + 1)
    if scene.traffic is None:
        return line, everything
    beside = round(_BESIDE / scene.pitches[1])
    low, high = max(0, first - beside), min(scene.rows - 1, last + beside)
    return line, (low, high - low + 1)
