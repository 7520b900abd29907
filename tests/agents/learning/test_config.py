"""Configurations: bad fields are named, the YAML of every task is understood, files come back."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from agents.learning.config import CONFIGS, DQNConfig, ModulesConfig, PPOConfig
from agents.learning.hyperparams import FOLDER, defaults, of_seed, read_config, write_config
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS

BAD: tuple[dict[str, Any], ...] = (
    {"task": "juggle"},
    {"actions": "thirds"},
    {"seed": -1},
    {"seeds": 0},
    {"steps": 0},
    {"lanes": 0},
    {"checkpoint_every": 0},
    {"control_period": 0.0},
    {"camera_share": 1.5},
    {"zones": (0,)},
    {"zones": (8,), "task": "track"},
    {"friction": 1.0},
    {"hidden": (0,)},
    {"hidden": ()},
    {"learning_rate": 0.0},
    {"gamma": 1.1},
    {"batch_size": 0},
    {"n_steps": 0},
)
BAD_PPO: tuple[dict[str, Any], ...] = (
    {"algo": "dqn"},
    {"n_epochs": 0},
    {"batch_size": 1000},
    {"gae_lambda": -0.1},
    {"ent_coef": -1.0},
)
BAD_MODULES: tuple[dict[str, Any], ...] = (
    {"algo": "ppo"},
    {"task": "slow"},
    {"actions": "halves"},
    {"parted": 1.5},
)
BAD_DQN: tuple[dict[str, Any], ...] = (
    {"algo": "ppo"},
    {"actions": "modules"},
    {"buffer_size": 0},
    {"learning_starts": -1},
    {"gradient_steps": 0},
    {"tau": 2.0},
    {"exploration_fraction": -0.1},
    {"exploration_final_eps": 1.1},
    {"max_grad_norm": 0.0},
)


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [(kind, wrong) for kind in CONFIGS.values() for wrong in BAD]
    + [(PPOConfig, wrong) for wrong in BAD_PPO]
    + [(DQNConfig, wrong) for wrong in BAD_DQN]
    + [(ModulesConfig, wrong) for wrong in BAD_MODULES],
    ids=lambda value: value.__name__ if isinstance(value, type) else str(value),
)
def test_bad_settings_are_named(kind: type[Any], wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        kind(**wrong)


@pytest.mark.parametrize(
    ("task", "algo"),
    [(task, algo) for algo in ("ppo", "dqn") for task in TASKS] + [("sort", "modules")],
)
class TestYaml:
    def test_it_is_understood_in_the_zoos_schema(self, task: str, algo: str) -> None:
        entry = yaml.safe_load((FOLDER / f"{algo}.yml").read_text())[env_id(task)]
        config = defaults(task, algo)
        assert (config.task, config.algo) == (task, algo)
        assert config.lanes == entry["n_envs"]
        assert config.steps == int(entry["n_timesteps"])
        assert config.hidden == tuple(entry["policy_kwargs"]["net_arch"])
        assert f"lin_{config.learning_rate:g}" == f"lin_{float(entry['learning_rate'][4:]):g}"
        for field in fields(config):
            if field.name in entry and field.name != "learning_rate":
                assert getattr(config, field.name) == entry[field.name]

    def test_a_file_comes_back_as_it_was(self, task: str, algo: str, tmp_path: Path) -> None:
        config = replace(defaults(task, algo), seed=7, name="a", out=tmp_path)
        write_config(config, tmp_path / "config.yaml")
        assert read_config(tmp_path / "config.yaml") == config


def test_a_setting_that_is_not_known_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ppo.yml").write_text("SmartSurface/Sort-v0:\n  normalize: true\n")
    monkeypatch.setattr("agents.learning.hyperparams.FOLDER", tmp_path)
    with pytest.raises(ValueError, match="normalize"):
        defaults("sort", "ppo")


def test_modules_learn_no_task_but_sort() -> None:
    with pytest.raises(ValueError, match="task must be one of 'sort' for modules, got 'slow'"):
        defaults("slow", "modules")


def test_the_run_of_one_seed() -> None:
    several = PPOConfig(seeds=3, steps=5)
    assert of_seed(several, 2) == PPOConfig(seed=2, seeds=1, steps=5)


@pytest.mark.parametrize(
    "text", ["", "[1", "algo: sac\nhidden: [1]\nout: a", "!!python/object/apply:os.getcwd []"]
)
def test_a_foreign_file_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(ValueError, match=r"config\.yaml"):
        read_config(tmp_path / "config.yaml")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no run"):
        read_config(tmp_path / "config.yaml")
