"""What is practised on: lanes seen exactly beside lanes seen by a camera on varied friction."""

import math
from dataclasses import replace

import gymnasium as gym
from stable_baselines3.common.vec_env import VecEnv

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.conditions import CONDITIONS, Condition
from surface_gym.layouts import box
from surface_gym.lines import Line
from surface_gym.parcel import Parcel, Rectangle, assortment
from surface_gym.randomisation import Randomisation
from surface_gym.tasks import Sort, Task, Track

from ..mirror import ActionMirror, MirrorVecEnv
from ..tasks import find_task
from ..vec_env import SurfaceVecEnv
from ..zones import time_for, with_zone
from .config import TrainConfig, card_of
from .side_by_side import SideBySide

# Below 10 deg of tilt holding a heading costs more speed than the slope gives.
PRACTISED: dict[str, Task] = {"track": Track(tilts=(math.radians(10.0), math.radians(15.0)))}

# For the lab: other parcels than it is tried with, of the same law and a little beyond.
PARCELS, PARCELS_SEED, PARCEL_SIZES = 256, 14, (0.18, 0.47)  # [m]
# Beside it, exact: squares of all sizes, and as often the study's boxes.
_SQUARES = tuple(Parcel(Rectangle(0.01 * side, 0.01 * side)) for side in range(15, 51))
EXACT_PARCELS = (*_SQUARES, *(box("S"), box("B")) * (len(_SQUARES) // 2))


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
    exact, other = _practised(config)
    seen_exactly = config.lanes - by_camera
    of_a_zone = seen_exactly // (2 * len(config.zones)) if config.zones else 0
    shares = [
        (seen_exactly - of_a_zone * len(config.zones), exact, None),
        *((of_a_zone, exact, columns) for columns in config.zones),
        (by_camera, other, None),
    ]
    return SideBySide([_lanes(config, *share) for share in shares if share[0]])


def _practised(config: TrainConfig) -> tuple[Condition, Condition]:
    """What the lanes seen exactly meet, and the others."""
    exact = CONDITIONS["exact"]
    if config.condition == "lab":
        lab = CONDITIONS["lab"]
        parcels = assortment(PARCELS, PARCELS_SEED, PARCEL_SIZES)
        return replace(exact, parcels=EXACT_PARCELS), replace(lab, parcels=parcels)
    camera = CONDITIONS["camera"]
    return exact, replace(camera, randomisation=Randomisation(friction=config.friction))


def _lanes(
    config: TrainConfig, lanes: int, condition: Condition, columns: int | None
) -> SurfaceVecEnv:
    """Lanes of a condition, on a zone of so many columns or the task's own."""
    task = PRACTISED.get(config.task) or find_task(config.task)
    plant, periods = task.plant, task.periods
    if columns is not None:
        assert isinstance(plant, Line)
        periods = round(periods * time_for(plant, columns))
        plant = with_zone(plant, columns)
    return SurfaceVecEnv(
        SmartSurfaceVectorEnv(
            num_envs=lanes,
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
