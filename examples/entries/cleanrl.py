"""Entry of the benchmark: PPO in CleanRL's style, trained on Sort with five seeds.

python examples/learners/cleanrl_sort.py --seed 0  # likewise 1 to 4
surface-gym benchmark --policy examples/entries/cleanrl.py:CleanRL --tasks sort --seeds 0 1 2 3 4
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from surface_gym.config import EnvConfig

ROOT = Path(__file__).parents[2]  # where the commands above run


class CleanRL:
    """Takes the most likely action of a network with two hidden layers of 64 units."""

    env_kwargs = {"actions": "halves"}

    def __init__(self, config: EnvConfig, seed: int) -> None:
        del config
        torch.set_num_threads(1)
        hidden = nn.Linear(15, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()
        self._network = nn.Sequential(*hidden, nn.Linear(64, 16))
        self._network.load_state_dict(torch.load(ROOT / f"cleanrl-{seed}.pt", weights_only=True))

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Return actions (num_envs,) for observations (num_envs, features)."""
        del episode_start, deterministic
        with torch.no_grad():
            chosen = self._network(torch.from_numpy(np.asarray(observation))).argmax(dim=1)
        return chosen.numpy(), state
