"""Stable-Baselines3's VecEnv for the native vector env: adapter, concatenation and mirror."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.config import REWARD

from .base import SIDE, ActionMirror

Infos = list[dict[str, Any]]


class EpisodeRecorder:
    """Returns, lengths and reward terms of the running episodes."""

    def __init__(self, num_envs: int, terms: tuple[str, ...]) -> None:
        self._names = terms
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, dtype=np.int64)
        self._terms = np.zeros((num_envs, len(terms)))

    def reset(self) -> None:
        for sums in (self._returns, self._lengths, self._terms):
            sums[:] = 0

    def add(
        self, rewards: NDArray[np.float64], terms: NDArray[np.float64], running: Any = True
    ) -> None:
        """Add a step: rewards (num_envs,), terms (num_envs, terms), and which episodes run."""
        self._returns += rewards
        self._terms += terms
        self._lengths += running

    def finish(
        self,
        ended: NDArray[np.bool_],
        observations: Any,
        truncated: NDArray[np.bool_],
        success: Any,
        outcome: Any,
        time: Any,
    ) -> Infos:
        """Build the infos of a step, and forget its ended episodes.

        Returns:
            Per environment: an empty dictionary, or for an ended episode `terminal_observation`,
                `TimeLimit.truncated`, `is_success`, `outcome`, `reward_terms` (sums over the
                episode) and `episode` (return, length and time, as in `Monitor`).
        """
        infos: Infos = [{} for _ in range(len(ended))]
        for i in np.nonzero(ended)[0].tolist():
            infos[i] = {
                "terminal_observation": observations[i],
                "TimeLimit.truncated": bool(truncated[i]),
                "is_success": bool(success[i]),
                "outcome": str(outcome[i]),
                "reward_terms": dict(zip(self._names, self._terms[i].tolist(), strict=True)),
                "episode": {
                    "r": float(self._returns[i]),
                    "l": int(self._lengths[i]),
                    "t": float(time[i]),
                },
            }
        for sums in (self._returns, self._lengths, self._terms):
            sums[ended] = 0
        return infos


class BatchVecEnv(VecEnv):
    """A VecEnv of batches, whose environments share attributes and methods."""

    @property
    @abstractmethod
    def batches(self) -> list[tuple[Any, int]]:
        """The batches, and the number of environments of each."""

    def _each(self, read: Callable[[Any], Any], indices: VecEnvIndices) -> list[Any]:
        every = [value for b, n in self.batches for value in [read(b)] * n]
        return [every[i] for i in self._get_indices(indices)]

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return self._each(lambda batch: getattr(batch, attr_name), indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise ValueError(
                f"indices must be all environments, which share {attr_name}, got {indices}"
            )
        for batch, _ in self.batches:
            setattr(batch, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of each batch once; all its environments get the result."""
        return self._each(lambda batch: getattr(batch, method_name)(*args, **kwargs), indices)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        del wrapper_class  # environments of a batch have no wrappers
        return [False for _ in self._get_indices(indices)]


class SurfaceVecEnv(BatchVecEnv):
    """A `SmartSurfaceVectorEnv` in SAME_STEP mode behind Stable-Baselines3's interface.

    Infos come from `EpisodeRecorder.finish`. `seed` and `set_options` act at the next `reset`.
    """

    def __init__(self, env: SmartSurfaceVectorEnv) -> None:
        if env.autoreset_mode != gym.vector.AutoresetMode.SAME_STEP:
            raise ValueError(f"env must be in SAME_STEP mode, got {env.autoreset_mode}")
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: NDArray[np.int64] | None = None
        self._terms = env.config.task.terms
        self._recorder = EpisodeRecorder(env.num_envs, self._terms)

    @property
    def batches(self) -> list[tuple[Any, int]]:
        return [(self.env, self.num_envs)]

    def reset(self) -> VecEnvObs:
        observations, _ = self.env.reset(seed=self._seeds, options=self._options)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        self._recorder.reset()
        return observations

    def step_async(self, actions: NDArray[np.int64]) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, terminated, truncated, infos = self.env.step(self._actions)
        dones = terminated | truncated
        final = infos["final_info"] if dones.any() else infos
        terms = [
            np.where(dones, final[REWARD + name], infos[REWARD + name]) for name in self._terms
        ]
        self._recorder.add(rewards, np.stack(terms, axis=1))
        step_infos = self._recorder.finish(
            dones,
            infos.get("final_obs"),
            truncated & ~terminated,
            final["is_success"],
            final["outcome"],
            final["time"],
        )
        return observations, rewards.astype(np.float32), dones, step_infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        return list(self.env.render() or [])


class ConcatVecEnv(BatchVecEnv):
    """Several VecEnvs with the same spaces, concatenated."""

    def __init__(self, parts: Sequence[BatchVecEnv]) -> None:
        self._parts = parts
        first = parts[0]
        counts = [part.num_envs for part in parts]
        self._cuts = np.cumsum(counts)[:-1]
        super().__init__(sum(counts), first.observation_space, first.action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed environment i with `seed` + i at the next reset."""
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

    @property
    def batches(self) -> list[tuple[Any, int]]:
        return [batch for part in self._parts for batch in part.batches]


class MirrorVecEnv(VecEnvWrapper):
    """A VecEnv of Sort that takes actions chosen for y > 0 in every environment."""

    def __init__(self, venv: VecEnv, mirror: ActionMirror) -> None:
        super().__init__(venv)
        self._mirror = mirror
        self._side = np.ones(venv.num_envs, dtype=np.float32)

    def reset(self) -> VecEnvObs:
        observations = np.asarray(self.venv.reset())
        self._side = observations[:, SIDE].copy()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        self.venv.step_async(self._mirror(actions, self._side))

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, dones, infos = self.venv.step_wait()
        self._side = np.asarray(observations)[:, SIDE].copy()
        return observations, rewards, dones, infos
