"""Scenes to draw: a parcel that is sorted, and a line with traffic."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.rendering import ExitMark, ExitSide, Scene, SceneParcel, Traffic, draw
from surface_gym.rendering.ink import PLATE_EDGE

SMALL = sg.Rectangle(0.25, 0.25).outline
LONG = sg.Rectangle(0.45, 0.25).outline
HIGHEST, LOWEST = 1.7, 0.3  # [m] shown of a line's surface: 0.5 m beside the rotor rows
EXITS = (ExitMark("A", 1, 1.0, 2.0), ExitMark("B", -1, 3.0, 4.0), ExitMark("on", 0, 6.0, 6.6))


@dataclass(frozen=True)
class Sorting:
    """The paper's S-box sorted to y < 0, as scenes."""

    trajectory: sg.Trajectory
    surface: sg.Surface
    outline: np.ndarray

    def scene(self, step: int, trail=None, sensed_pose=None, **fields: object) -> Scene:
        pose = self.trajectory.pose
        trail = pose[: step + 1, :2] if trail is None else trail
        parcel = SceneParcel(self.outline, tuple(pose[step]), trail=trail, sensed_pose=sensed_pose)
        time = (("time", f"{self.trajectory.time[step]:.2f} s"),)
        given = {"zone": (9, 2, 3, 16), "goal": ExitSide(-1), "title": "Sort", "readings": time}
        return Scene(self.surface.axis, self.surface.rotor, (parcel,), **(given | fields))


@pytest.fixture(scope="session")
def sorting():
    surface, parcel = sg.layouts.sorting("S"), sg.layouts.box("S")
    trajectory = sg.simulate(surface, parcel, sg.layouts.start("S"), (1.5, 0.0, 0.0))
    return Sorting(trajectory, surface, parcel.base.outline)


@pytest.fixture
def bare(sorting):
    """A parcel on supports, and nothing else."""
    rotor = np.zeros((20, 40), bool)
    return Scene(np.zeros((20, 40)), rotor, (SceneParcel(sorting.outline, (2.0, 1.0, 0.0)),))


@pytest.fixture
def empty():
    """A line of 60 columns and 6 of supports with exits, on which nothing moves."""
    rotor = np.zeros((20, 66), bool)
    rotor[8:12, :60] = True
    return Scene(np.full((20, 66), math.pi / 2), rotor, traffic=Traffic(EXITS, (0, 0, 0)))


@pytest.fixture
def busy(empty):
    """Four parcels, of which two touch, and all that a scene with traffic may have."""
    trail = np.stack([np.linspace(2.4, 3.0, 30), np.full(30, 1.05)], axis=-1)
    parcels = (
        SceneParcel(SMALL, (0.4, 1.0, 0.1), 0),
        SceneParcel(LONG, (1.5, 1.3, 0.7), 0, sensed_pose=(1.52, 1.28, 0.75)),
        SceneParcel(LONG, (3.0, 1.05, -0.2), 2, trail=trail, label="7"),
        SceneParcel(SMALL, (3.37, 1.0, 0.0), 1),
    )
    return replace(
        empty,
        parcels=parcels,
        touching=((2, 3),),
        traffic=Traffic(EXITS, (3, 1, 12), missorted=2, waiting=4),
        title="Sort a stream",
        readings=(("time", "12.3 s"), ("parcels an hour", "3 600")),
    )


class Plate:
    """Where a scene's surface lies in its pictures, by the border around what is shown of it."""

    def __init__(self, scene: Scene, width: int | None = None) -> None:
        self.stream = scene.traffic is not None
        ground = replace(scene, parcels=(), touching=(), goal=None)
        if self.stream:
            ground = replace(ground, traffic=Traffic((), ()))
        border = (draw(ground, width) == PLATE_EDGE).all(axis=2)
        rows = np.flatnonzero(border.mean(axis=1) > 0.7)
        columns = np.flatnonzero(border.mean(axis=0) > 0.4)
        self.top, self.bottom = rows[0], rows[-1] + 1  # [px]
        self.left, self.right = columns[0], columns[-1] + 1
        self.low, self.high = (LOWEST, HIGHEST) if self.stream else (0.0, 0.1 * scene.rows)  # [m]
        self.length = 0.1 * scene.columns
        self.cell = 0.1 * (self.right - self.left) / self.length  # [px] of an element

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Fractions of a pixel (column, row) of a point [m] of the surface."""
        column = self.left + (self.right - self.left) * x / self.length
        height = self.bottom - self.top
        return column, self.top + height * (self.high - y) / (self.high - self.low)


def differing(picture: np.ndarray, other: np.ndarray) -> tuple[int, int, int, int]:
    """(left, right, top, bottom) [px] of where two pictures differ."""
    rows, columns = np.nonzero((picture != other).any(axis=2))
    return columns.min(), columns.max() + 1, rows.min(), rows.max() + 1


def middle(box: tuple[int, int, int, int]) -> tuple[float, float]:
    left, right, top, bottom = box
    return 0.5 * (left + right), 0.5 * (top + bottom)
