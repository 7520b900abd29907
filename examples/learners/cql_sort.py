"""Conservative Q-learning of d3rlpy from a data set of Sort; saves cql-SEED.pt.

pip install -r examples/learners/d3rlpy.txt -e ".[agents,data]"
surface-gym dataset sort --policy mixed
python examples/learners/cql_sort.py --seed 0
"""

import os
from functools import lru_cache
from typing import Any

import d3rlpy
import minari
import numpy as np
import torch
from d3rlpy.algos import DiscreteCQLConfig
from d3rlpy.dataset import MDPDataset
from d3rlpy.logging import NoopAdapterFactory
from d3rlpy.models import VectorEncoderFactory
from fresh_starts import Act, run, success

DATA = os.environ.get("SURFACE_GYM_DATA", "smart-surface/sort/mixed-v0")
BATCH = 256


@lru_cache
def read(name: str) -> Any:
    """Read all transitions; d3rlpy's own reader would misalign actions after each episode."""
    episodes = [
        (each.observations[:-1], each.actions, each.rewards, each.terminations, each.truncations)
        for each in minari.load_dataset(name).iterate_episodes()
    ]
    return MDPDataset(*map(np.concatenate, zip(*episodes, strict=True)))


def learn(steps: int, seed: int) -> Act:
    """Learn from `steps` drawn control periods; return the policy."""
    d3rlpy.seed(seed)
    torch.set_num_threads(1)  # the networks are small
    turns = -(-steps // BATCH)
    algorithm = DiscreteCQLConfig(
        learning_rate=1e-3,
        batch_size=BATCH,
        target_update_interval=50,
        alpha=4.0,
        encoder_factory=VectorEncoderFactory([64, 64]),
    ).create(device="cpu:0")
    algorithm.fit(
        read(DATA),
        n_steps=turns,
        n_steps_per_epoch=min(turns, 500),
        save_interval=turns,
        logger_adapter=NoopAdapterFactory(),
        show_progress=False,
    )
    algorithm.save_policy(f"cql-{seed}.pt")  # TorchScript, which d3rlpy need not read
    return lambda observation: np.asarray(algorithm.predict(observation))


def main() -> None:
    """Train, and run the policy with its best actions on fresh starts."""
    run(learn, success, 256_000, "minari", "d3rlpy")


if __name__ == "__main__":
    main()
