"""Behaviour cloning from a data set of Sort in plain PyTorch; saves bc-SEED.pt.

pip install -e ".[agents,data]"
surface-gym dataset sort --policy mixed
python examples/learners/bc_sort.py --seed 0
"""

import os
from functools import lru_cache
from typing import Any

import minari
import numpy as np
import torch
from fresh_starts import Act, run, success
from torch import Tensor, nn

DATA = os.environ.get("SURFACE_GYM_DATA", "smart-surface/sort/mixed-v0")
BATCH, RATE = 1024, 1e-3


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Make a network with two hidden layers of 64 units."""
    hidden = nn.Linear(inputs, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU()
    return nn.Sequential(*hidden, nn.Linear(64, outputs))


@lru_cache
def read(name: str) -> tuple[Tensor, Tensor]:
    """Read the observations and the actions of all control periods."""
    episodes = [
        (each.observations[:-1], each.actions)
        for each in minari.load_dataset(name).iterate_episodes()
    ]
    seen, actions = map(np.concatenate, zip(*episodes, strict=True))
    return torch.from_numpy(seen), torch.from_numpy(actions)


def learn(steps: int, seed: int) -> Act:
    """Learn from `steps` drawn control periods; return the policy. The learning rate falls to 0."""
    seen, actions = read(DATA)
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # the network is small
    actor, turns = network(15, 16), -(-steps // BATCH)
    adam = torch.optim.Adam(actor.parameters(), RATE)
    for turn in range(turns):
        adam.param_groups[0]["lr"] = RATE * (1 - turn / turns)
        some = torch.randint(len(seen), (BATCH,))
        loss: Any = nn.functional.cross_entropy(actor(seen[some]), actions[some])
        adam.zero_grad()
        loss.backward()
        adam.step()
        if turn % 500 == 0:
            print(f"{(turn + 1) * BATCH:8} periods: loss {loss:.3f}", flush=True)
    torch.save(actor.state_dict(), f"bc-{seed}.pt")
    return lambda observation: np.asarray(actor(torch.from_numpy(observation)).argmax(dim=1))


def main() -> None:
    """Train, and run the policy with its most likely actions on fresh starts."""
    run(learn, success, 2_500_000, "minari")


if __name__ == "__main__":
    main()
