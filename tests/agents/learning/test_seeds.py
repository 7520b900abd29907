"""Seeds trained in processes of their own come to what each comes to alone."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from rich.console import Console

from agents.learning.config import ModulesConfig, PPOConfig, TrainConfig
from agents.learning.folder import parts
from agents.learning.seeds import train_seeds
from agents.policies.files import WEIGHTS

SMALL = PPOConfig(
    task="slow", seed=3, seeds=2, lanes=8, steps=2_000, n_steps=16, batch_size=64, n_epochs=1,
    hidden=(8,),
)  # fmt: skip
SMALL_MODULES = ModulesConfig(
    seed=3, seeds=2, lanes=8, steps=512, n_steps=16, batch_size=64, n_epochs=1, hidden=(8,)
)


@pytest.mark.parametrize("config", [SMALL, SMALL_MODULES], ids=lambda config: config.algo)
def test_seeds_apart_are_seeds_alone(config: TrainConfig, tmp_path: Path) -> None:
    learned = train_seeds(config, tmp_path, Console(quiet=True), 2)
    assert [each.steps >= config.steps for each in learned] == [True, True]
    assert [folder.name for _, folder in parts(config, tmp_path)] == ["seed-3", "seed-4"]
    alone = tmp_path / "alone"
    alone.mkdir()
    train_seeds(replace(config, seed=4, seeds=1), alone, Console(quiet=True), 2)
    weights = {
        name: torch.load(tmp_path / name / WEIGHTS) for name in ("alone", "seed-3", "seed-4")
    }
    for name, values in weights["alone"].items():
        assert torch.equal(values, weights["seed-4"][name])
    assert not all(
        torch.equal(values, weights["seed-3"][name]) for name, values in weights["alone"].items()
    )


def test_one_seed_lies_in_the_runs_own_folder(tmp_path: Path) -> None:
    one = replace(SMALL, seeds=1)
    assert parts(one, tmp_path) == [(one, tmp_path)]
