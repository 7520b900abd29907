"""Where a stream's line, its entry and its exits lie in a picture."""

from dataclasses import dataclass

import numpy as np
import pygame

from surface_gym.rendering.flow_scene import ExitMark, FlowScene
from surface_gym.rendering.view import View, height_of

_BESIDE = 0.5  # [m] shown on either side of the rotor rows
_ENTRY = 4.0  # [cells] room for the queue, before the surface
_STRAIGHT = 6.0  # [cells] room for the way straight on, after it
_LABEL = 2.0  # [cells] height of the chutes' labels


@dataclass(frozen=True)
class FlowLayout:
    """The rotor rows and what lies beside them, to scale, amid the labels of the exits."""

    view: View  # of the whole surface, most of which lies outside the picture
    line: tuple[int, int]  # first rotor row, and how many rows to the last
    band: tuple[int, int]  # first row shown, and how many
    area: tuple[int, int, int, int]  # [px] left, top, width and height of all that is drawn

    @classmethod
    def of(cls, scene: FlowScene, cell: int, left: int, top: int) -> "FlowLayout":
        """The layout at a corner, of elements that are `cell` pixels wide."""
        line, band = _rows(scene)
        hidden = scene.rows - sum(band)  # rows above the picture
        label, height = round(_LABEL * cell), height_of(scene, cell)
        view = View.of(scene, cell, left + round(_ENTRY * cell), top + label - hidden * height)
        return cls(view, line, band, (left, top, *cls.extent(scene, cell)))

    @staticmethod
    def extent(scene: FlowScene, cell: int) -> tuple[int, int]:
        """[px] width and height of what is drawn."""
        across = round(_ENTRY * cell) + scene.columns * cell + round(_STRAIGHT * cell)
        rows = FlowLayout.rows_shown(scene)
        return (across, rows * height_of(scene, cell) + 2 * round(_LABEL * cell))

    @staticmethod
    def cells_across(scene: FlowScene) -> int:
        """How many elements would take the same width."""
        return round(_ENTRY + scene.columns + _STRAIGHT)

    @staticmethod
    def rows_shown(scene: FlowScene) -> int:
        """How many rows are drawn."""
        return _rows(scene)[1][1]

    @property
    def cell(self) -> int:
        """[px] the largest square that an element has room for."""
        return self.view.cell

    @property
    def plate(self) -> pygame.Rect:
        """[px] the part of the surface that is shown."""
        return self.view.cells(*self.band, 0, self.view.columns)

    @property
    def rotors(self) -> pygame.Rect:
        """[px] the rotor rows."""
        return self.view.cells(*self.line, 0, self.view.columns)

    @property
    def passable(self) -> pygame.Rect:
        """[px] where parcels are drawn: from the entry to the line's end."""
        plate, left = self.plate, self.area[0]
        return pygame.Rect(left, plate.top, plate.right - left, plate.height)

    def mouth(self, mark: ExitMark) -> pygame.Rect:
        """[px] where parcels leave: from the rotor rows outwards, or across them."""
        ends = self.view.pixels(np.array([[mark.first, 0.0], [mark.last, 0.0]]))[:, 0]
        left, right = (round(float(x)) for x in ends)
        plate, rotors = self.plate, self.rotors
        top, bottom = rotors.top, rotors.bottom
        if mark.side > 0:
            top, bottom = plate.top, rotors.top
        elif mark.side < 0:
            top, bottom = rotors.bottom, plate.bottom
        return pygame.Rect(left, top, right - left, bottom - top)

    def label(self, mark: ExitMark) -> pygame.Rect:
        """[px] where an exit's name and count stand."""
        mouth, plate = self.mouth(mark), self.plate
        left, top, width, height = self.area
        if mark.side == 0:
            return pygame.Rect(plate.right, mouth.top, left + width - plate.right, mouth.height)
        if mark.side > 0:
            return pygame.Rect(mouth.left, top, mouth.width, plate.top - top)
        return pygame.Rect(mouth.left, plate.bottom, mouth.width, top + height - plate.bottom)


def _rows(scene: FlowScene) -> tuple[tuple[int, int], tuple[int, int]]:
    """The line's rows and the rows shown, each as the first and how many; without rotors all."""
    rotors = np.flatnonzero(scene.rotor.any(axis=1))
    if len(rotors) == 0:
        return (0, scene.rows), (0, scene.rows)
    first, last = int(rotors[0]), int(rotors[-1])
    beside = round(_BESIDE / scene.pitches[1])
    low, high = max(0, first - beside), min(scene.rows - 1, last + beside)
    return (first, last - first + 1), (low, high - low + 1)
