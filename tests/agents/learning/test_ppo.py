"""Advantages of rollouts."""

import numpy as np
import pytest
import torch

from surface_gym.agents.learning.ppo import compute_advantages


@pytest.mark.parametrize("gae_lambda", [0.0, 0.9, 1.0])
def test_advantages_are_weighted_sums_of_temporal_differences(gae_lambda) -> None:
    rng = np.random.default_rng(0)
    shape = (6, 3)
    rewards, value, next_value = rng.normal(size=(3, *shape))
    ended = rng.random(shape) < 0.3
    gamma = 0.9
    given = map(torch.from_numpy, (rewards, ended, value, next_value))
    found = compute_advantages(*given, gamma, gae_lambda).numpy()
    delta = rewards + gamma * next_value - value
    for i in range(shape[1]):
        for period in range(shape[0]):
            total = 0.0
            for later in range(period, shape[0]):
                total += (gamma * gae_lambda) ** (later - period) * delta[later, i]
                if ended[later, i]:
                    break
            assert found[period, i] == pytest.approx(total, rel=1e-12, abs=1e-12)
