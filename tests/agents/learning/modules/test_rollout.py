"""Ragged batches."""

import numpy as np
import torch

from agents.learning.modules.rollout import Batch, join, pick


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
