"""Training environments: some with exact sensors, some with a camera, some with other zones."""

import gymnasium as gym
import numpy as np
import pytest

from surface_gym.agents.learning.config import DQNConfig, PPOConfig
from surface_gym.agents.learning.sb3 import make_mirrored_envs, training_task
from surface_gym.randomisation import Randomisation
from surface_gym.registration import env_id
from surface_gym.sensors import Exact
from surface_gym.tasks import TASKS


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("task", TASKS)
def test_a_share_has_a_camera(task: str, share: float) -> None:
    config = PPOConfig(task=task, num_envs=8, batch_size=64, camera_share=share)
    envs = make_mirrored_envs(config)
    assert envs.num_envs == 8
    config_of_each = envs.get_attr("config")
    exact = [settings.sensors == Exact() for settings in config_of_each]
    assert exact == [True] * round(8 * (1 - share)) + [False] * round(8 * share)
    for settings, is_exact in zip(config_of_each, exact, strict=True):
        assert settings.randomisation == (Randomisation() if is_exact else Randomisation(0.2))
        assert settings.task == training_task(task)
    assert envs.observation_space == gym.make(env_id(task), actions="halves").observation_space


def test_half_of_the_environments_with_exact_sensors_have_zones_of_other_lengths() -> None:
    config = PPOConfig(task="slow", num_envs=32, batch_size=64, camera_share=0.5, zones=(8, 24))
    config_of_each = make_mirrored_envs(config).get_attr("config")
    columns = [settings.chosen_line.zone_columns for settings in config_of_each]
    assert columns == [16] * 8 + [8] * 4 + [24] * 4 + [16] * 16
    behind = {each.chosen_line.columns - each.chosen_line.zone_columns for each in config_of_each}
    assert len(behind) == 1


def test_sort_is_trained_in_a_mirror() -> None:
    """The same actions sort to either side."""
    envs = make_mirrored_envs(DQNConfig(num_envs=64, camera_share=0.0))
    envs.seed(0)
    envs.reset()
    sides = set()
    for _ in range(60):
        _, _, dones, infos = envs.step(np.full(64, 10))  # all axes at -45 deg
        for i in np.nonzero(dones)[0]:
            if infos[i]["is_success"]:
                sides.add(float(infos[i]["terminal_observation"][-1]))
            assert infos[i]["outcome"] != "wrong side"
    assert sides == {-1.0, 1.0}
