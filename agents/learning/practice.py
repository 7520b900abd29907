"""What is practised on: lanes seen exactly beside lanes seen by a camera on varied friction."""

import math

import gymnasium as gym
from stable_baselines3.common.vec_env import VecEnv

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Camera, Exact, Sensor
from surface_gym.tasks import Sort, Task, Track

from ..mirror import ActionMirror, MirrorVecEnv
from ..tasks import find_task
from ..vec_env import SurfaceVecEnv
from .config import TrainConfig, card_of
from .side_by_side import SideBySide

# Below 10 deg of tilt holding a heading costs more speed than the slope gives.
PRACTISED: dict[str, Task] = {"track": Track(tilts=(math.radians(10.0), math.radians(15.0)))}


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
