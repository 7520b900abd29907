"""Training: the seed fixes the weights, and bad settings are named."""

from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console

from agents.config import TrainConfig
from agents.training import train


def weights(folder: Path, seed: int) -> torch.Tensor:
    config = TrainConfig(
        seed=seed, steps=256, lanes=4, rollout=32, batch_size=64, epochs=1, hidden=(8,)
    )
    _, _, model = train(config, folder, Console(quiet=True))
    return torch.cat([each.flatten() for each in model.policy.state_dict().values()])


def test_the_seed_fixes_the_weights(tmp_path: Path) -> None:
    first = weights(tmp_path / "a", seed=0)
    assert torch.equal(first, weights(tmp_path / "b", seed=0))
    assert not torch.equal(first, weights(tmp_path / "c", seed=1))


BAD: tuple[dict[str, Any], ...] = (
    {"seed": -1},
    {"steps": 0},
    {"lanes": 0},
    {"rollout": 0},
    {"batch_size": 0},
    {"epochs": 0},
    {"learning_rate": 0.0},
    {"gamma": 1.1},
    {"gae_lambda": -0.1},
    {"entropy": -1.0},
    {"slow_share": 2.0},
    {"hidden": (0,)},
    {"control_period": 0.0},
)


@pytest.mark.parametrize("fields", BAD, ids=lambda fields: next(iter(fields)))
def test_bad_settings_are_named(fields: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(fields))):
        TrainConfig(**fields)
