"""Scenes to draw: a parcel that is sorted, and a line with traffic."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.rendering import ExitMark, ExitSide, Scene, SceneParcel, Traffic

SMALL = sg.Rectangle(0.25, 0.25).outline
LONG = sg.Rectangle(0.45, 0.25).outline
EXITS = (ExitMark("A", 1, 1.0, 2.0), ExitMark("B", -1, 3.0, 4.0), ExitMark("on", 0, 6.0, 6.6))


@dataclass(frozen=True)
class Sorting:
    """The paper's S-box sorted to y < 0, as scenes."""

    trajectory: sg.Trajectory
    surface: sg.Surface
    outline: np.ndarray

    def scene(self, step: int, **fields: object) -> Scene:
        pose = self.trajectory.pose
        of_parcel = {"trail": pose[: step + 1, :2]}
        of_parcel |= {name: fields.pop(name) for name in ("trail", "sensed_pose") if name in fields}
        given = {
            "zone": (9, 2, 3, 16),
            "goal": ExitSide(-1),
            "title": "Sort",
            "readings": (("time", f"{self.trajectory.time[step]:.2f} s"),),
        }
        parcel = SceneParcel(self.outline, tuple(pose[step]), **of_parcel)
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
