"""Double Q: the target is what the slow copy says of the action that the network chooses."""

import numpy as np
import pytest
import torch
from torch.nn.functional import smooth_l1_loss

from agents.learning.config import DQNConfig
from agents.learning.double_dqn import DoubleDQN, cut_memory
from agents.learning.model import make_model
from agents.learning.practice import make_practice

LANES = 4


def filled(n_steps: int, steps: int = 40) -> DoubleDQN:
    """A model with some control periods remembered, its two networks apart."""
    config = DQNConfig(
        lanes=LANES, buffer_size=LANES * 60, learning_starts=10**6, n_steps=n_steps, hidden=(8,)
    )
    model = make_model(config, make_practice(config))
    assert isinstance(model, DoubleDQN)
    model.learn(steps * LANES)
    with torch.no_grad():
        for parameter in model.q_net_target.parameters():
            parameter.add_(torch.randn_like(parameter))
    return model


def test_a_gradient_step_is_the_double_estimates() -> None:
    model = filled(n_steps=1)
    buffer = model.replay_buffer
    assert buffer is not None
    np.random.seed(0)  # noqa: NPY002, what Stable-Baselines3 samples by
    batch = buffer.sample(32)
    np.random.seed(0)  # noqa: NPY002
    with torch.no_grad():
        chosen = model.q_net(batch.next_observations).numpy().argmax(axis=1)
        slow = model.q_net_target(batch.next_observations).numpy()
        fast = model.q_net(batch.next_observations).numpy()
    worth = slow[np.arange(32), chosen]
    assert (worth < slow.max(axis=1) - 1e-6).any()  # it is not one network's opinion
    assert (worth != fast.max(axis=1)).any()
    goes_on = 1.0 - batch.dones.numpy()[:, 0]
    target = torch.from_numpy(batch.rewards.numpy()[:, 0] + goes_on * model.gamma * worth).float()
    value = model.q_net(batch.observations)[torch.arange(32), batch.actions[:, 0].long()]
    loss = smooth_l1_loss(value, target).item()
    model.train(gradient_steps=1, batch_size=32)
    assert model.logger.name_to_value["train/loss"] == pytest.approx(loss, rel=1e-5)


def test_no_return_reaches_over_a_cut() -> None:
    model = filled(n_steps=3)
    buffer = model.replay_buffer
    assert buffer is not None
    last = buffer.pos - 1
    buffer.dones[last - 5 : last + 1] = 0.0
    buffer.timeouts[last - 5 : last + 1] = 0.0
    cut_memory(model)
    buffer.rewards[last + 1 : last + 4] = 1e6  # of lanes started anew
    buffer.pos += 3
    several = buffer._get_samples(np.array([last - 1] * 8))
    assert several.rewards.abs().max() < 1e3
    assert several.discounts is not None
    np.testing.assert_allclose(several.discounts.numpy(), model.gamma**2, rtol=1e-6)
    assert not several.dones.any()  # cut off, not failed: the rest is asked of the network
