"""Double Q: the target is the slow copy's value of the action that the network chooses."""

import numpy as np
import pytest
import torch
from stable_baselines3.common.utils import set_random_seed
from torch.nn.functional import smooth_l1_loss

from surface_gym.agents.learning.config import DQNConfig
from surface_gym.agents.learning.sb3 import DoubleDQN, make_mirrored_envs, make_model, truncate_last

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
