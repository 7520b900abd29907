"""What is practised on: lanes seen exactly beside lanes seen by a camera on varied friction."""

import math
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

from agents.learning.config import TrainConfig, card_of
from agents.mirror import ActionMirror, MirrorVecEnv
from agents.tasks import find_task
from agents.vec_env import SurfaceVecEnv
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Camera, Exact, Sensor
from surface_gym.tasks import Sort, Task, Track

# Below 10 deg of tilt holding a heading costs more speed than the slope gives.
PRACTISED: dict[str, Task] = {"track": Track(tilts=(math.radians(10.0), math.radians(15.0)))}


class SideBySide(VecEnv):
    """Several VecEnvs of one observation and one action space as one: their lanes in a row."""

    def __init__(self, parts: Sequence[SurfaceVecEnv]) -> None:
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


def make_practice(config: TrainConfig) -> VecEnv:
    """The lanes a configuration asks for, mirrored where the task's observation is."""
    env = make_lanes(config)
    settings = card_of(config).settings(find_task(config.task))
    if not isinstance(settings.task, Sort):
        return env
    return MirrorVecEnv(env, ActionMirror(settings.action_kind, settings.chosen_orientations))


def make_lanes(config: TrainConfig) -> SideBySide:
    """The lanes a configuration asks for, as they are."""
    by_camera = round(config.camera_share * config.lanes)
    parts = [
        _lanes(config, lanes, sensors, randomisation)
        for lanes, sensors, randomisation in (
            (config.lanes - by_camera, Exact(), Randomisation()),
            (by_camera, Camera(), Randomisation(friction=config.friction)),
        )
        if lanes
    ]
    return SideBySide(parts)


def _lanes(
    config: TrainConfig, lanes: int, sensors: Sensor, randomisation: Randomisation
) -> SurfaceVecEnv:
    task = PRACTISED.get(config.task) or find_task(config.task)
    return SurfaceVecEnv(
        SmartSurfaceVectorEnv(
            num_envs=lanes,
            max_episode_steps=task.periods,
            task=task,
            actions=config.actions,
            control_period=config.control_period,
            sensors=sensors,
            randomisation=randomisation,
            autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
        )
    )
