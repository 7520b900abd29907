"""Mirror symmetry of Sort: a policy that sorts to y > 0 also sorts, mirrored, to y < 0.

The environment mirrors Sort's observation already, so that the goal lies at y > 0; the last of its
features is the asked side. Here actions are mirrored back into the world.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.core.actions import ActionKind
from surface_gym.tasks import Sort
from surface_gym.tasks.sort import FEATURES

from .base import SAME, axes_apart

SIDE = len(FEATURES) - 1  # index of the asked side in the observation


def mirrored_orientations(orientations: tuple[float, ...]) -> NDArray[np.int64]:
    """(choices,) index of each axis angle's mirror image, -angle, among the orientations [rad].

    Raises:
        ValueError: the mirror image of an angle is not among them.
    """
    angles = np.array(orientations)
    apart = axes_apart(-angles[:, np.newaxis], angles)
    nearest = apart.argmin(axis=1)
    if (apart[np.arange(len(angles)), nearest] > SAME).any():
        raise ValueError(f"orientations must hold the mirror image of each, got {orientations}")
    return nearest


class ActionMirror:
    """Mirror for actions that were chosen for y > 0, where the asked side is y < 0.

    Args:
        kind: of the actions.
        orientations: [rad] axis angles to choose from; continuous actions ignore them.
    """

    def __init__(self, kind: ActionKind, orientations: tuple[float, ...]) -> None:
        self._kind = kind
        self._image = None if kind.continuous else mirrored_orientations(orientations)

    def __call__(self, actions: NDArray[Any], side: NDArray[np.float32]) -> NDArray[Any]:
        """Return actions (num_envs, ...) in the world for the asked side (num_envs,) of each."""
        commands = self._kind.commands(actions, len(side))
        flipped = self._kind.flip(commands)
        image = self._kind.encode(-flipped if self._image is None else self._image[flipped])
        # Side 0, straight through, is not mirrored.
        unchanged = (side >= 0.0).reshape(-1, *[1] * (np.ndim(actions) - 1))
        return np.where(unchanged, actions, image)


def action_mirror(settings: EnvConfig) -> ActionMirror | None:
    """Build the mirror for an environment's actions; None where its task is not symmetric."""
    if not isinstance(settings.task, Sort):
        return None
    return ActionMirror(settings.action_kind, settings.chosen_orientations)
