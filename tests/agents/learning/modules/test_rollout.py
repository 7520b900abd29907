"""Ragged batches and advantages."""

import numpy as np
import pytest
import torch

from agents.learning.modules.rollout import Batch, advantages, join, pick


def batch(counts: list[int], first: int) -> Batch:
    """Samples numbered from `first`; each module carries its sample's number."""
    number = torch.arange(first, first + len(counts))
    modules = number.repeat_interleave(torch.tensor(counts))
    return Batch(number, number, number, torch.tensor(counts), modules, modules, modules)


def test_picked_samples_keep_their_modules() -> None:
    whole = join([batch([2, 0, 3], 0), batch([1, 4, 0], 3)])
    some = pick(whole, np.array([4, 1, 2, 4]))
    assert some.observations.tolist() == [4, 1, 2, 4]
    assert some.modules.tolist() == [4, 0, 3, 4]
    assert some.place.tolist() == [4, 4, 4, 4, 2, 2, 2, 4, 4, 4, 4]
    assert some.sample.tolist() == [0, 0, 0, 0, 2, 2, 2, 3, 3, 3, 3]


@pytest.mark.parametrize("gae_lambda", [0.0, 0.9, 1.0])
def test_advantages_are_weighted_sums_of_surprises(gae_lambda: float) -> None:
    rng = np.random.default_rng(0)
    shape = (6, 3)
    rewards, value, after = rng.normal(size=(3, *shape))
    ended = rng.random(shape) < 0.3
    gamma = 0.9
    found = advantages(rewards, ended, value, after, gamma, gae_lambda)
    surprise = rewards + gamma * after - value
    for lane in range(shape[1]):
        for period in range(shape[0]):
            total = 0.0
            for later in range(period, shape[0]):
                total += (gamma * gae_lambda) ** (later - period) * surprise[later, lane]
                if ended[later, lane]:
                    break
            assert found[period, lane] == pytest.approx(total)
