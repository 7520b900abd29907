"""Training environments: some with exact sensors, some with a camera and varied friction."""

import math
from dataclasses import replace

import gymnasium as gym
from stable_baselines3.common.vec_env import VecEnv

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.layouts import box
from surface_gym.lines import Line
from surface_gym.parcel import Parcel, Rectangle, assortment
from surface_gym.presets import PRESETS, Preset
from surface_gym.randomisation import Randomisation
from surface_gym.tasks import Task, Track

from ..base import time_for, with_zone
from ..symmetry import action_mirror
from ..tasks import find_task
from ..vec_env import ConcatVecEnv, MirrorVecEnv, SurfaceVecEnv
from .config import TrainConfig, make_card

# Below 10 deg of tilt keeping a heading costs more speed than the slope gives.
_TASKS: dict[str, Task] = {"track": Track(tilts=(math.radians(10.0), math.radians(15.0)))}

# For the lab: other parcels than in its evaluation, of the same distribution and a little beyond.
_PARCELS, _PARCELS_SEED, _PARCEL_SIZES = 256, 14, (0.18, 0.47)  # [m]
# With exact sensors beside it: squares of all sizes, and as often the study's boxes.
_SQUARES = tuple(Parcel(Rectangle(0.01 * side, 0.01 * side)) for side in range(15, 51))
_EXACT_PARCELS = (*_SQUARES, *(box("S"), box("B")) * (len(_SQUARES) // 2))


def training_task(name: str) -> Task:
    """Return the task to train on, which may be narrower than the task of a name."""
    return _TASKS.get(name) or find_task(name)


def make_mirrored_envs(config: TrainConfig) -> VecEnv:
    """Make the environments of a configuration, with actions mirrored where the task is."""
    envs = make_training_envs(config)
    mirror = action_mirror(make_card(config).env_config(find_task(config.task)))
    return envs if mirror is None else MirrorVecEnv(envs, mirror)


def make_training_envs(config: TrainConfig) -> ConcatVecEnv:
    """Make the environments of a configuration, with actions in the world."""
    by_camera = round(config.camera_share * config.num_envs)
    exact, other = _conditions(config)
    with_exact = config.num_envs - by_camera
    each_zone = with_exact // (2 * len(config.zones)) if config.zones else 0
    shares = [
        (with_exact - each_zone * len(config.zones), exact, None),
        *((each_zone, exact, columns) for columns in config.zones),
        (by_camera, other, None),
    ]
    return ConcatVecEnv([_make_envs(config, *share) for share in shares if share[0]])


def _conditions(config: TrainConfig) -> tuple[Preset, Preset]:
    """Return the conditions of the environments with exact sensors, and of the others."""
    exact = PRESETS["exact"]
    if config.preset == "lab":
        lab = PRESETS["lab"]
        parcels = assortment(_PARCELS, _PARCELS_SEED, _PARCEL_SIZES)
        return replace(exact, parcels=_EXACT_PARCELS), replace(lab, parcels=parcels)
    camera = PRESETS["camera"]
    return exact, replace(camera, randomisation=Randomisation(friction=config.friction))


def _make_envs(
    config: TrainConfig, num_envs: int, condition: Preset, columns: int | None
) -> SurfaceVecEnv:
    """Make environments under a condition, with a zone of so many columns or the task's own."""
    task = training_task(config.task)
    plant, periods = task.plant, task.periods
    if columns is not None:
        assert isinstance(plant, Line)
        periods = round(periods * time_for(plant, columns))
        plant = with_zone(plant, columns)
    return SurfaceVecEnv(
        SmartSurfaceVectorEnv(
            num_envs=num_envs,
            max_episode_steps=periods,
            task=task,
            plant=plant,
            actions=config.actions,
            control_period=config.control_period,
            observe=config.observe,
            condition=condition,
            autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
        )
    )
