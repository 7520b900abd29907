"""Hyper-parameters of one's own: written and read again they are the same; errors name them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from agents.learning.config import DQNConfig, PPOConfig, TrainConfig
from agents.learning.hyperparams import defaults, write_hyperparams
from surface_gym.tasks import TASKS

ROOT = Path(__file__).parents[3]
LEARNED = [
    *((task, algo) for algo in ("ppo", "dqn") for task in TASKS),
    ("sort", "modules"),
    ("flow", "parcels"),
    (f"{ROOT}/examples/reach.py:Reach", "ppo"),
    (f"{ROOT}/examples/haste.py:Haste", "dqn"),
]


@pytest.mark.parametrize(("task", "algo"), LEARNED)
def test_what_is_written_is_read_again(task: str, algo: str, tmp_path: Path) -> None:
    config = replace(
        defaults(task, algo), steps=123_456, learning_rate=1 / 3e4, gamma=0.1 + 0.2, friction=0.35,
        control_period=0.02, hidden=(7, 9, 11), checkpoint_every=777,
    )  # fmt: skip
    write_hyperparams(config, tmp_path / "own.yml")
    assert defaults(task, algo, tmp_path / "own.yml") == config


def test_seeds_folder_and_name_are_no_hyperparameters(tmp_path: Path) -> None:
    config = PPOConfig(seed=5, seeds=3, name="a", out=tmp_path)
    write_hyperparams(config, tmp_path / "own.yml")
    assert defaults("sort", "ppo", tmp_path / "own.yml") == PPOConfig()


def test_it_is_the_zoos_schema(tmp_path: Path) -> None:
    config: TrainConfig = DQNConfig(task="slow", lanes=32, learning_rate=2e-5)
    write_hyperparams(config, tmp_path / "own.yml")
    entry = yaml.safe_load((tmp_path / "own.yml").read_text())["SmartSurface/Slow-v0"]
    assert entry["n_envs"] == 32
    assert entry["n_timesteps"] == 1_000_000
    assert entry["learning_rate"] == "lin_2e-05"
    assert entry["policy_kwargs"] == {"net_arch": [64, 64]}
    assert entry["env_kwargs"] == {"actions": "halves", "control_period": 0.04}
    assert not {"task", "algo", "seed", "seeds", "out", "name"} & entry.keys()


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        ({"normalize": True}, "normalize must be a known setting"),
        ({"seed": 3}, "seed must be a known setting"),
        ({"policy": "CnnPolicy"}, "policy must be a known setting"),
        ({"policy_kwargs": {"net_arch": 64}}, "policy_kwargs must be a known setting"),
        ({"policy_kwargs": {}}, "policy_kwargs must be a known setting"),
        ({"env_kwargs": {"task": "slow"}}, "env_kwargs must be a known setting"),
        ({"env_kwargs": ["actions"]}, "env_kwargs must be a known setting"),
        ({"learning_rate": 0.001}, "learning_rate must be lin_ and a number, .* got 0.001"),
        ({"learning_rate": "lin_fast"}, "learning_rate must be lin_ and a number"),
        ({"n_timesteps": "long"}, "n_timesteps must be a finite number"),
        ({"gamma": 1.5}, "gamma must be between 0 and 1"),
        (3, "SmartSurface/Sort-v0 must hold names and values"),
    ],
    ids=str,
)
def test_what_is_not_allowed_is_named(entry: Any, named: str, tmp_path: Path) -> None:
    (tmp_path / "own.yml").write_text(yaml.safe_dump({"SmartSurface/Sort-v0": entry}))
    with pytest.raises(ValueError, match=r"own\.yml does not hold hyper-parameters: " + named):
        defaults("sort", "ppo", tmp_path / "own.yml")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "an entry a task"),
        ("[1", "flow sequence"),
        ("SmartSurface/Slow-v0: {}", "task must be one of 'slow' for ppo, got 'sort'"),
        ("!!python/object/apply:os.getcwd []", "could not determine a constructor"),
    ],
)
def test_a_foreign_file_is_refused(text: str, named: str, tmp_path: Path) -> None:
    (tmp_path / "own.yml").write_text(text)
    with pytest.raises(ValueError, match=r"own\.yml.*" + named):
        defaults("sort", "ppo", tmp_path / "own.yml")


def test_a_missing_file_is_named() -> None:
    with pytest.raises(ValueError, match=r"nowhere\.yml"):
        defaults("sort", "ppo", Path("nowhere.yml"))
