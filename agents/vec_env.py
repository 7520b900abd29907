"""The native vector env as Stable-Baselines3's VecEnv."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import (
    VecEnv,
    VecEnvIndices,
    VecEnvObs,
    VecEnvStepReturn,
)

from surface_gym import SmartSurfaceVectorEnv


class SharedVecEnv(VecEnv):
    """A VecEnv whose lanes are all of one object, which has their attributes and methods."""

    @property
    @abstractmethod
    def _shared(self) -> Any:
        """That object."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        value = getattr(self._shared, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute, which the lanes share.

        Raises:
            ValueError: `indices` leaves out a lane.
        """
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise ValueError(f"indices must be all lanes, which share {attr_name}, got {indices}")
        setattr(self._shared, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method once; its answer stands for every lane asked for."""
        answer = getattr(self._shared, method_name)(*method_args, **method_kwargs)
        return [answer for _ in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        del wrapper_class  # lanes of one batch have no wrappers
        return [False for _ in self._get_indices(indices)]


class SurfaceVecEnv(SharedVecEnv):
    """A `SmartSurfaceVectorEnv` in SAME_STEP mode behind Stable-Baselines3's interface.

    Infos of a finished lane carry `terminal_observation`, `TimeLimit.truncated`, `is_success`,
    `outcome`, `reward_terms` (their sums over the episode) and `episode` (return, length), as
    `Monitor` gives them; those of others are empty.
    `seed` and `set_options` act at the next `reset`.

    Raises:
        ValueError: the vector env is not in SAME_STEP mode.
    """

    def __init__(self, env: SmartSurfaceVectorEnv) -> None:
        if env.autoreset_mode != gym.vector.AutoresetMode.SAME_STEP:
            raise ValueError(f"env must be in SAME_STEP mode, got {env.autoreset_mode}")
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: NDArray[np.int64] | None = None
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        self._terms = np.zeros((len(env.settings.chosen_task.terms), env.num_envs))

    @property
    def _shared(self) -> SmartSurfaceVectorEnv:
        return self.env

    def reset(self) -> VecEnvObs:
        observations, _ = self.env.reset(seed=self._seeds, options=self._options)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self._terms[:] = 0.0
        return observations

    def step_async(self, actions: NDArray[np.int64]) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, terminated, truncated, infos = self.env.step(self._actions)
        dones = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        names = self.env.settings.chosen_task.terms
        reset_terms = infos["reward_terms"]
        paid = infos["final_info"]["reward_terms"] if dones.any() else reset_terms
        for sums, name in zip(self._terms, names, strict=True):
            sums += np.where(dones, paid[name], reset_terms[name])
        lane_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for lane in np.nonzero(dones)[0]:
            final = infos["final_info"]
            lane_infos[lane] = {
                "terminal_observation": infos["final_obs"][lane],
                "TimeLimit.truncated": bool(truncated[lane] and not terminated[lane]),
                "is_success": bool(final["is_success"][lane]),
                "outcome": final["outcome"][lane],
                "reward_terms": dict(zip(names, self._terms[:, lane].tolist(), strict=True)),
                "episode": {
                    "r": float(self._returns[lane]),
                    "l": int(self._lengths[lane]),
                    "t": float(final["time"][lane]),
                },
            }
        self._returns[dones] = 0.0
        self._lengths[dones] = 0
        self._terms[:, dones] = 0.0
        return observations, rewards.astype(np.float32), dones, lane_infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        return list(self.env.render() or [])
