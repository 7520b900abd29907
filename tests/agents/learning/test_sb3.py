"""Training environments: some with exact sensors, some with a camera, some with other zones; and
double Q: the target is the slow copy's value of the action that the network chooses.
"""

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.utils import set_random_seed
from torch.nn.functional import smooth_l1_loss

from surface_gym.agents.learning.config import DQNConfig, PPOConfig
from surface_gym.agents.learning.sb3 import (
    DoubleDQN,
    make_mirrored_envs,
    make_model,
    training_task,
    truncate_last,
)
from surface_gym.randomisation import Randomisation
from surface_gym.registration import env_id
from surface_gym.sensors import Exact
from surface_gym.tasks import TASKS

NUM_ENVS = 4


def filled(n_steps: int, steps: int = 40) -> DoubleDQN:
    """A model with some control periods remembered, its two networks apart."""
    config = DQNConfig(
        num_envs=NUM_ENVS,
        buffer_size=NUM_ENVS * 60,
        learning_starts=10**6,
        n_steps=n_steps,
        hidden=(8,),
    )
    model = make_model(config, make_mirrored_envs(config))
    assert isinstance(model, DoubleDQN)
    model.learn(steps * NUM_ENVS)
    with torch.no_grad():
        for parameter in model.q_net_target.parameters():
            parameter.add_(torch.randn_like(parameter))
    return model


def test_a_gradient_step_is_the_double_estimates() -> None:
    model = filled(n_steps=1)
    buffer = model.replay_buffer
    set_random_seed(0)
    batch = buffer.sample(32)
    set_random_seed(0)
    with torch.no_grad():
        chosen = model.q_net(batch.next_observations).numpy().argmax(axis=1)
        slow = model.q_net_target(batch.next_observations).numpy()
        fast = model.q_net(batch.next_observations).numpy()
    next_value = slow[np.arange(32), chosen]
    assert (next_value < slow.max(axis=1) - 1e-6).any()  # it is not one network's opinion
    assert (next_value != fast.max(axis=1)).any()
    goes_on = 1.0 - batch.dones.numpy()[:, 0]
    target = torch.from_numpy(
        batch.rewards.numpy()[:, 0] + goes_on * model.gamma * next_value
    ).float()
    value = model.q_net(batch.observations)[torch.arange(32), batch.actions[:, 0].long()]
    loss = smooth_l1_loss(value, target).item()
    model.train(gradient_steps=1, batch_size=32)
    assert model.logger.name_to_value["train/loss"] == pytest.approx(loss, rel=1e-5)


def test_no_return_reaches_into_another_episode() -> None:
    model = filled(n_steps=3)
    buffer = model.replay_buffer
    last = buffer.pos - 1
    buffer.dones[last - 5 : last + 1] = 0.0
    buffer.timeouts[last - 5 : last + 1] = 0.0
    truncate_last(model)
    buffer.rewards[last + 1 : last + 4] = 1e6  # of environments started anew
    buffer.pos += 3
    several = buffer._get_samples(np.array([last - 1] * 8))
    assert several.rewards.abs().max() < 1e3
    np.testing.assert_allclose(several.discounts.numpy(), model.gamma**2, rtol=1e-6)
    assert not several.dones.any()  # cut off, not failed: the rest is asked of the network


@pytest.mark.parametrize(
    ("task", "share"), [("slow", 0.0), ("slow", 1.0), *((task, 0.5) for task in TASKS)]
)
def test_a_share_has_a_camera(task, share) -> None:
    config = PPOConfig(task=task, num_envs=8, batch_size=64, camera_share=share)
    envs = make_mirrored_envs(config)
    assert envs.num_envs == 8
    config_of_each = envs.get_attr("config")
    exact = [env_config.sensors == Exact() for env_config in config_of_each]
    assert exact == [True] * round(8 * (1 - share)) + [False] * round(8 * share)
    for env_config, is_exact in zip(config_of_each, exact, strict=True):
        assert env_config.randomisation == (Randomisation() if is_exact else Randomisation(0.2))
        assert env_config.task == training_task(task)
    assert envs.observation_space == gym.make(env_id(task), actions="halves").observation_space


def test_half_of_the_environments_with_exact_sensors_have_zones_of_other_lengths() -> None:
    config = PPOConfig(task="slow", num_envs=32, batch_size=64, camera_share=0.5, zones=(8, 24))
    config_of_each = make_mirrored_envs(config).get_attr("config")
    columns = [env_config.chosen_line.zone_columns for env_config in config_of_each]
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
