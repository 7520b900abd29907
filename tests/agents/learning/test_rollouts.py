"""Advantages of rollouts."""

import numpy as np
import pytest
import torch

from agents.learning.rollouts import advantages


@pytest.mark.parametrize("gae_lambda", [0.0, 0.9, 1.0])
def test_advantages_are_weighted_sums_of_surprises(gae_lambda: float) -> None:
    rng = np.random.default_rng(0)
    shape = (6, 3)
    rewards, value, after = rng.normal(size=(3, *shape))
    ended = rng.random(shape) < 0.3
    gamma = 0.9
    told = map(torch.from_numpy, (rewards, ended, value, after))
    found = advantages(*told, gamma, gae_lambda).numpy()
    surprise = rewards + gamma * after - value
    for lane in range(shape[1]):
        for period in range(shape[0]):
            total = 0.0
            for later in range(period, shape[0]):
                total += (gamma * gae_lambda) ** (later - period) * surprise[later, lane]
                if ended[later, lane]:
                    break
            assert found[period, lane] == pytest.approx(total, rel=1e-12, abs=1e-12)
