"""The package's own vector env with Stable-Baselines3's interface."""

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.config import REWARD

from .base import SIDE, ActionMirror

Infos = list[dict[str, Any]]


class SurfaceVecEnv(VecEnv):
    """A VecEnv of one or several `SmartSurfaceVectorEnv` with the same spaces.

    `seed` and `set_options` act at the next `reset`. The environments of one vector env share
    attributes and methods.

    Args:
        mirror: mirrors actions, so that the learner can act as if each goal were at y > 0.

    Raises:
        ValueError: a vector env is not in SAME_STEP mode.
    """

    def __init__(self, *envs: SmartSurfaceVectorEnv, mirror: ActionMirror | None = None) -> None:
        for env in envs:
            if env.autoreset_mode != gym.vector.AutoresetMode.SAME_STEP:
                raise ValueError(f"env must be in SAME_STEP mode, got {env.autoreset_mode}")
        self.envs = envs
        first, total = envs[0], sum(env.num_envs for env in envs)
        super().__init__(total, first.single_observation_space, first.single_action_space)
        lasts = np.cumsum([env.num_envs for env in envs]).tolist()
        self._parts = [
            slice(last - env.num_envs, last) for env, last in zip(envs, lasts, strict=True)
        ]
        self._mirror = mirror
        self._side = np.ones(total, dtype=np.float32)
        self._actions: NDArray[Any] | None = None
        self._terms = first.config.task.terms
        # returns, lengths and sums of reward terms of the running episodes
        self._returns, self._lengths = np.zeros(total), np.zeros(total, dtype=np.int64)
        self._sums = np.zeros((total, len(self._terms)))

    def reset(self) -> VecEnvObs:
        observations = [
            env.reset(seed=self._seeds[part], options=self._options[part])[0]
            for env, part in zip(self.envs, self._parts, strict=True)
        ]
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        for sums in (self._returns, self._lengths, self._sums):
            sums[:] = 0
        return self._seen(observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions if self._mirror is None else self._mirror(actions, self._side)

    def step_wait(self) -> VecEnvStepReturn:
        assert self._actions is not None
        found = [
            self._step(env, self._actions[part], part)
            for env, part in zip(self.envs, self._parts, strict=True)
        ]
        observations, rewards, dones, infos = zip(*found, strict=True)
        return (
            self._seen(observations),
            np.concatenate(rewards).astype(np.float32),
            np.concatenate(dones),
            [info for part in infos for info in part],
        )

    def _seen(self, observations: Sequence[Any]) -> NDArray[Any]:
        seen = np.concatenate(observations)
        if self._mirror is not None:
            self._side = seen[:, SIDE].copy()
        return seen

    def _step(
        self, env: SmartSurfaceVectorEnv, actions: NDArray[Any], part: slice
    ) -> tuple[Any, Any, Any, Infos]:
        """Step a vector env. Its environments have the indices `part` in this VecEnv.

        Returns:
            Observations, rewards, whether episodes ended, and a dictionary for each environment.
                The dictionary is empty while the episode runs. After the episode's end,
                the dictionary has `terminal_observation`, `TimeLimit.truncated`, `is_success`,
                `outcome`, `reward_terms` (sums over the episode) and `episode` (return, length and
                time, as in `Monitor`).
        """
        observations, rewards, terminated, truncated, infos = env.step(actions)
        dones = terminated | truncated
        final = infos["final_info"] if dones.any() else infos
        terms = [
            np.where(dones, final[REWARD + name], infos[REWARD + name]) for name in self._terms
        ]
        returns, lengths, sums = self._returns[part], self._lengths[part], self._sums[part]
        returns += rewards
        lengths += 1
        sums += np.stack(terms, axis=1)
        step_infos: Infos = [{} for _ in range(env.num_envs)]
        for i in np.nonzero(dones)[0].tolist():
            step_infos[i] = {
                "terminal_observation": infos["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "is_success": bool(final["is_success"][i]),
                "outcome": str(final["outcome"][i]),
                "reward_terms": dict(zip(self._terms, sums[i].tolist(), strict=True)),
                "episode": {
                    "r": float(returns[i]),
                    "l": int(lengths[i]),
                    "t": float(final["time"][i]),
                },
            }
        for each in (returns, lengths, sums):
            each[dones] = 0
        return observations, rewards, dones, step_infos

    def close(self) -> None:
        for env in self.envs:
            env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        return [image for env in self.envs for image in env.render() or []]

    def _each(self, read: Callable[[Any], Any], indices: VecEnvIndices) -> list[Any]:
        every = [value for env in self.envs for value in [read(env)] * env.num_envs]
        return [every[i] for i in self._get_indices(indices)]

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return self._each(lambda env: getattr(env, attr_name), indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise ValueError(
                f"indices must be all environments, which share {attr_name}, got {indices}"
            )
        for env in self.envs:
            setattr(env, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of each vector env once; return one result per environment in `indices`."""
        return self._each(lambda env: getattr(env, method_name)(*args, **kwargs), indices)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        del wrapper_class  # these environments have no wrappers
        return [False for _ in self._get_indices(indices)]
