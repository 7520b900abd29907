"""Sorting to y < 0 is sorting to y > 0 seen in a mirror: what is learned for one does for both.

The environment's Sort observation is mirrored already, so that the goal is y > 0; the last of its
features is the asked side. The actions here are turned back into the world's.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from surface_gym.core.actions import ActionKind
from surface_gym.tasks.sort import FEATURES

from .angles import SAME, axes_apart

SIDE = len(FEATURES) - 1  # place of the asked side in the observation


def mirrored_orientations(orientations: tuple[float, ...]) -> NDArray[np.int64]:
    """(choices,) index of each axis angle's mirror image, -angle, among the orientations [rad].

    Raises:
        ValueError: the mirror image of an angle is not on offer.
    """
    angles = np.array(orientations)
    apart = axes_apart(-angles[:, np.newaxis], angles)
    nearest = apart.argmin(axis=1)
    if (apart[np.arange(len(angles)), nearest] > SAME).any():
        raise ValueError(f"orientations must hold the mirror image of each, got {orientations}")
    return nearest


class ActionMirror:
    """Turns actions chosen for y > 0 into those for y < 0.

    Args:
        kind: of the actions.
        orientations: [rad] axis angles on offer; where any angle is, they do not count.
    """

    def __init__(self, kind: ActionKind, orientations: tuple[float, ...]) -> None:
        self._kind = kind
        self._image = None if kind.continuous else mirrored_orientations(orientations)

    def __call__(self, actions: NDArray[Any], side: NDArray[np.float32]) -> NDArray[Any]:
        """Actions (lanes, ...) in the world, for the asked side (lanes,) of each lane."""
        commands = self._kind.commands(actions, len(side))
        flipped = self._kind.flip(commands)
        image = self._kind.encode(-flipped if self._image is None else self._image[flipped])
        # Straight through, side 0, is seen as it is.
        towards = (side >= 0.0).reshape(-1, *[1] * (np.ndim(actions) - 1))
        return np.where(towards, actions, image)


class MirrorVecEnv(VecEnvWrapper):
    """A VecEnv of Sort whose actions are those for y > 0 in every lane."""

    def __init__(self, venv: VecEnv, mirror: ActionMirror) -> None:
        super().__init__(venv)
        self._mirror = mirror
        self._side = np.ones(venv.num_envs, dtype=np.float32)

    def reset(self) -> VecEnvObs:
        observations = self.venv.reset()
        self._side = observations[:, SIDE].copy()  # type: ignore[call-overload,index]
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        self.venv.step_async(self._mirror(actions, self._side))

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, dones, infos = self.venv.step_wait()
        self._side = observations[:, SIDE].copy()  # type: ignore[call-overload,index]
        return observations, rewards, dones, infos
