"""Several VecEnvs as one."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import (
    VecEnvIndices,
    VecEnvObs,
    VecEnvStepReturn,
)


class SideBySide(VecEnv):
    """Several VecEnvs of one observation and one action space as one: their lanes in a row."""

    def __init__(self, parts: Sequence[VecEnv]) -> None:
        self._parts = parts
        first = parts[0]
        lanes = [part.num_envs for part in parts]
        self._cuts = np.cumsum(lanes)[:-1]
        super().__init__(sum(lanes), first.observation_space, first.action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed lane i with `seed` + i at the next reset, whatever part it is in."""
        seeds = list(super().seed(seed))
        for part, first in zip(self._parts, [0, *self._cuts], strict=True):
            part.seed(seeds[first])
        return seeds

    def reset(self) -> VecEnvObs:
        return np.concatenate([part.reset() for part in self._parts])

    def step_async(self, actions: NDArray[np.int64]) -> None:
        for part, some in zip(self._parts, np.split(actions, self._cuts), strict=True):
            part.step_async(some)

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, dones, infos = zip(
            *(part.step_wait() for part in self._parts), strict=True
        )
        return (
            np.concatenate(observations),
            np.concatenate(rewards),
            np.concatenate(dones),
            [info for part in infos for info in part],
        )

    def close(self) -> None:
        for part in self._parts:
            part.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        values = [value for part in self._parts for value in part.get_attr(attr_name)]
        return [values[lane] for lane in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of every part; `indices` must be all lanes, as each part says."""
        for part in self._parts:
            part.set_attr(attr_name, value, indices)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of every part; its answer stands for every lane asked for."""
        answers = [
            answer
            for part in self._parts
            for answer in part.env_method(method_name, *method_args, **method_kwargs)
        ]
        return [answers[lane] for lane in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        del wrapper_class  # lanes of one batch have no wrappers
        return [False for _ in self._get_indices(indices)]
