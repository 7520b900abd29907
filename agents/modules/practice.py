"""The lanes to learn from: some seen exactly, some by a camera on varied friction."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from agents.modules.config import ModulesConfig
from agents.modules.view import Integers, Numbers, Singles
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.randomisation import Randomisation
from surface_gym.registration import env_id
from surface_gym.sensors import Camera, Exact, Sensors
from surface_gym.settings import Settings

Booleans = NDArray[np.bool_]


class Moved(NamedTuple):
    """What a control period brought."""

    observations: Singles  # (lanes, features) of the next start where an episode ended
    rewards: Numbers  # (lanes,)
    terminated: Booleans  # (lanes,) ended by success or failure
    ended: Booleans  # (lanes,) or ran out of time
    success: Booleans  # (lanes,) ended by success
    last: Singles  # (lanes, features) seen at the period's end, of the episode that ended too


class Practice:
    """Lanes of Sort in a row, each of which starts anew when its episode ends.

    Args:
        config: of the run.
    """

    def __init__(self, config: ModulesConfig) -> None:
        by_camera = round(config.camera_share * config.lanes)
        self._haste = config.haste
        self._parts = [
            _lanes(config, lanes, sensors, randomisation)
            for lanes, sensors, randomisation in (
                (config.lanes - by_camera, Exact(), Randomisation()),
                (by_camera, Camera(), Randomisation(friction=config.friction)),
            )
            if lanes
        ]
        self._cuts = np.cumsum([part.num_envs for part in self._parts])[:-1]
        self.settings: Settings = self._parts[0].settings

    def reset(self, rng: np.random.Generator) -> Singles:
        """Start all lanes, seeded from `rng`; observations (lanes, features)."""
        starts = []
        for part in self._parts:
            seeds = rng.integers(2**31, size=part.num_envs).tolist()
            starts.append(part.reset(seed=seeds)[0])
        return np.concatenate(starts)

    def step(self, actions: Integers) -> Moved:
        """Move all lanes by one control period."""
        moved = [
            self._move(part, some)
            for part, some in zip(self._parts, np.split(actions, self._cuts), strict=True)
        ]
        return Moved(*(np.concatenate(each) for each in zip(*moved, strict=True)))

    def _move(self, part: SmartSurfaceVectorEnv, actions: Integers) -> tuple[NDArray[Any], ...]:
        observations, rewards, terminated, truncated, info = part.step(actions)
        last, ended = observations, terminated | truncated
        success = np.zeros(part.num_envs, dtype=np.bool_)
        if ended.any():
            last = observations.copy()
            last[ended] = np.stack(info["final_obs"][ended].tolist())
            final = info["final_info"]
            success = ended & final["is_success"]
            rewards[success] += self._haste / final["time"][success]
        return observations, rewards, terminated, ended, success, last


def _lanes(
    config: ModulesConfig, lanes: int, sensors: Sensors, randomisation: Randomisation
) -> SmartSurfaceVectorEnv:
    env = gym.make_vec(
        env_id("sort"),
        num_envs=lanes,
        actions="modules",
        control_period=config.control_period,
        sensors=sensors,
        randomisation=randomisation,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
    )
    assert isinstance(env, SmartSurfaceVectorEnv)
    return env
