"""Track for those who may know the whole path: it stands in the observation."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from surface_gym.physics.jit import kernel_function
from surface_gym.physics.types import X, Y
from surface_gym.settings import Settings
from surface_gym.state import PATH_POINTS, EnvState
from surface_gym.tasks import track
from surface_gym.tasks.base import Feature, Start
from surface_gym.tasks.track import Track

from ..sight import path_sight
from .start import nearest_parcel

OWN = len(track.FEATURES)  # place of the first feature that Track does not show
FARTHEST = 1000.0  # [m] that anything can be from the origin

FEATURES = (
    *track.FEATURES,
    Feature("x", -FARTHEST, FARTHEST, "of the base's centre / 1 m"),
    Feature("y", -FARTHEST, FARTHEST, ""),
    Feature("path's first x", -FARTHEST, FARTHEST, "/ 1 m"),
    Feature("path's step", 0.0, FARTHEST, "in x, from point to point / 1 m"),
    *(Feature(f"path {k}", -FARTHEST, FARTHEST, "y / 1 m") for k in range(PATH_POINTS)),
)

_observe_track = Track.observe  # compiled code knows no classes


class ShownPath(Track):
    """Track whose observation shows where the parcel is and the whole path; else the same."""

    features = FEATURES

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        """Show what Track does, and the path."""
        _observe_track(state)
        see = state.observation
        see[OWN] = state.sensed[X]
        see[OWN + 1] = state.sensed[Y]
        see[OWN + 2] = state.goal[track.FIRST_X]
        see[OWN + 3] = state.goal[track.STEP_X]
        for k in range(PATH_POINTS):
            see[OWN + 4 + k] = state.path[k]


def with_path_shown(task: Track) -> ShownPath:
    """The same task with its whole path shown."""
    return ShownPath(**{each.name: getattr(task, each.name) for each in dataclasses.fields(task)})


def shown_start(settings: Settings, observation: NDArray[np.float32]) -> Start:
    """The start that an observation (features,) of a `ShownPath` shows, the parcel one of
    those the task draws.
    """
    see = path_sight(settings, observation[np.newaxis])
    x, y, first_x, step, *path = observation[OWN:].astype(np.float64).tolist()
    vx, vy = see.velocity
    return Start(
        nearest_parcel(settings, float(see.half_length[0])),
        (x, y, float(see.theta[0])),
        (float(vx[0]), float(vy[0]), float(see.omega[0])),
        (float(see.asked_speed[0]), first_x, step),
        float(see.tilt[0]),
        np.array(path),
    )
