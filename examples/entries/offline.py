"""Entries of the benchmark: policies that learned Sort from a data set, with five seeds each.

surface-gym dataset sort --policy mixed
python examples/learners/bc_sort.py --seed 0   # likewise 1 to 4
python examples/learners/cql_sort.py --seed 0  # likewise 1 to 4
surface-gym benchmark --policy examples/entries/offline.py:Cloned --tasks sort --seeds 0 1 2 3 4
surface-gym benchmark --policy examples/entries/offline.py:CQL --tasks sort --seeds 0 1 2 3 4
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from surface_gym.config import EnvConfig

ROOT = Path(__file__).parents[2]  # where the commands above run


class Cloned:
    """Takes the most likely action of a cloned network with two hidden layers of 64 units."""

    env_kwargs = {"actions": "halves"}

    def __init__(self, config: EnvConfig, seed: int) -> None:
        del config
        torch.set_num_threads(1)
        hidden = nn.Linear(15, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU()
        network = nn.Sequential(*hidden, nn.Linear(64, 16))
        network.load_state_dict(torch.load(ROOT / f"bc-{seed}.pt", weights_only=True))
        self._network: Any = network

    def _choose(self, observations: Any) -> Any:
        return self._network(observations).argmax(dim=1)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Return actions (num_envs,) for observations (num_envs, features)."""
        del episode_start, deterministic
        with torch.no_grad():
            chosen = self._choose(torch.from_numpy(np.asarray(observation)))
        return chosen.numpy(), state


class CQL(Cloned):
    """Takes the best action of a network that d3rlpy has exported after Q-learning (CQL)."""

    def __init__(self, config: EnvConfig, seed: int) -> None:
        del config
        torch.set_num_threads(1)
        load: Any = torch.jit.load
        self._network = load(ROOT / f"cql-{seed}.pt")

    def _choose(self, observations: Any) -> Any:
        return self._network(observations).flatten()
