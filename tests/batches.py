"""Batches on which starts are put by hand."""

from typing import Any

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.tasks.start import Start


def put(batch: Batch, start: Start, i: int = 0) -> None:
    """Begin a start on an environment."""
    chosen = np.array([i])
    batch.place(chosen, start)
    batch.begin(chosen)


def batch_with(start: Start, seed: int = 0, **settings: Any) -> Batch:
    """A batch of one environment on which a start was put; what it draws comes from the seed."""
    batch = Batch(EnvConfig(**settings), 1)
    batch.reset_cache.seed(0, np.random.default_rng(seed))
    put(batch, start)
    return batch
