from dataclasses import dataclass

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.rendering import ExitSide, Scene


@dataclass(frozen=True)
class Sorting:
    """The paper's S-box sorted to y < 0, as scenes."""

    trajectory: sg.Trajectory
    surface: sg.Surface
    outline: np.ndarray

    def scene(self, step: int, **fields: object) -> Scene:
        pose = self.trajectory.pose
        told = {
            "pose": tuple(pose[step]),
            "trail": pose[: step + 1, :2],
            "zone": (9, 2, 3, 16),
            "goal": ExitSide(-1),
            "title": "Sort",
            "readings": (("time", f"{self.trajectory.time[step]:.2f} s"),),
        }
        return Scene(self.surface.axis, self.surface.rotor, self.outline, **(told | fields))


@pytest.fixture(scope="session")
def sorting() -> Sorting:
    surface, parcel = sg.layouts.sorting("S"), sg.layouts.box("S")
    trajectory = sg.simulate(surface, parcel, sg.layouts.start("S"), (1.5, 0.0, 0.0))
    return Sorting(trajectory, surface, parcel.base.outline)


@pytest.fixture
def bare(sorting) -> Scene:
    """A parcel on supports, and nothing else."""
    return Scene(
        axis=np.zeros((20, 40)),
        rotor=np.zeros((20, 40), bool),
        outline=sorting.outline,
        pose=(2.0, 1.0, 0.0),
    )
