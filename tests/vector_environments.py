"""Vectors of environments for the tests, native and of single ones."""

from functools import partial
from typing import Any

import gymnasium as gym
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from surface_gym.randomisation import Actuators, Randomisation
from tests.environments import IDS, SENSORS, SORT

NUM_ENVS = 3
LIMIT = 14  # control periods of an episode, so that some run out of time
every_mode = pytest.mark.parametrize("mode", AutoresetMode, ids=lambda mode: mode.name)
EVERYTHING_VARIES: dict[str, Any] = {
    "actuators": Actuators(axis_speed=8.0, stuck_share=0.1),
    "randomisation": Randomisation(
        friction=0.2, rolling=0.2, mass=0.2, size=0.05, com_offset=0.2, stiffness=0.3,
        lateral=0.01, heading=0.05,
    ),
}  # fmt: skip

# Each id and each kind of sensor, of which other code is compiled where axes turn: seconds each.
every_varying = pytest.mark.parametrize(
    ("env_id", "sensor"),
    [
        pytest.param(env_id, sensor, id=f"{env_id}-{sensor.__name__}")
        for env_id, sensor in [(name, SENSORS[-1]) for name in IDS]
        + [(SORT, sensor) for sensor in SENSORS[:-1]]
    ],
)


def native(env_id: str = SORT, num_envs: int = NUM_ENVS, **settings: Any) -> VectorEnv:
    return gym.make_vec(env_id, num_envs=num_envs, **settings)


def single_of(env_id: str, limit: int, settings: dict[str, Any]) -> gym.Env:
    return gym.make(env_id, max_episode_steps=limit, disable_env_checker=True, **settings)


def singles(
    env_id: str, mode: AutoresetMode, limit: int = LIMIT, num_envs: int = NUM_ENVS, **settings: Any
) -> SyncVectorEnv:
    make = partial(single_of, env_id, limit, settings)
    return SyncVectorEnv([make] * num_envs, autoreset_mode=mode)
