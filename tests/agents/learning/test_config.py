"""Configurations: bad fields are named; hyper-parameters of the package and of users are read, and
come back from files as they were written.
"""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from surface_gym.agents.learning import algorithms, config as configs
from surface_gym.agents.learning.runs import read_config, training_command, write_config
from surface_gym.agents.library import ALGORITHMS
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS
from tests.environments import ON_SLOPES

ROOT = Path(__file__).parents[3]
BAD: tuple[dict[str, Any], ...] = (
    {"task": "juggle"}, {"actions": "thirds"}, {"seed": -1}, {"seeds": 0}, {"steps": 0},
    {"num_envs": 0}, {"preset": "field"}, {"observe": ("moon",)}, {"checkpoint_every": 0},
    {"control_period": 0.0}, {"camera_share": 1.5}, {"zones": (0,)},
    {"friction": 1.0}, {"hidden": (0,)}, {"hidden": ()},
    {"learning_rate": 0.0}, {"gamma": 1.1}, {"batch_size": 0}, {"n_steps": 0},
)  # fmt: skip
BAD_PPO: tuple[dict[str, Any], ...] = (
    {"algo": "dqn"}, {"n_epochs": 0}, {"batch_size": 1000}, {"gae_lambda": -0.1},
    {"ent_coef": -1.0}, {"zones": (8,), "task": "track"},
)  # fmt: skip
BAD_MODULES: tuple[dict[str, Any], ...] = (
    {"algo": "ppo"}, {"task": "slow"}, {"actions": "halves"}, {"split_probability": 1.5},
    {"gamma": 1.1},
)  # fmt: skip
BAD_PARCELS = ({"task": "sort"}, {"actions": "modules"})
BAD_LOCAL = ({"task": "sort"}, {"actions": "parcels"}, {"split_probability": 2.0})
BAD_SCHEDULE: tuple[dict[str, Any], ...] = (
    {"task": "sort"}, {"actions": "halves"}, {"lines": 0}, {"batch_size": 0},
    {"gradient_steps": -1},
)  # fmt: skip
BAD_DQN: tuple[dict[str, Any], ...] = (
    {"algo": "ppo"}, {"actions": "modules"}, {"buffer_size": 0}, {"learning_starts": -1},
    {"gradient_steps": 0}, {"tau": 2.0}, {"exploration_fraction": -0.1},
    {"exploration_final_eps": 1.1}, {"max_grad_norm": 0.0},
)  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (kind, wrong)
        for kind in (each.config for each in ALGORITHMS.values())
        for wrong in BAD
        if next(iter(wrong)) in kind.__dataclass_fields__
    ]
    + [(algorithms.PPOConfig, wrong) for wrong in BAD_PPO]
    + [(algorithms.DQNConfig, wrong) for wrong in BAD_DQN]
    + [(algorithms.ModulesConfig, wrong) for wrong in BAD_MODULES]
    + [(algorithms.SchedulesConfig, wrong) for wrong in BAD_SCHEDULE]
    + [(algorithms.ParcelsConfig, wrong) for wrong in BAD_PARCELS]
    + [(algorithms.LocalConfig, wrong) for wrong in BAD_LOCAL],
    ids=lambda value: value.__name__ if isinstance(value, type) else str(value),
)
def test_bad_fields_are_named(kind, wrong) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        kind(**wrong)


@pytest.mark.parametrize(
    ("task", "algo"),
    [(task, algo) for algo in ("ppo", "dqn") for task in TASKS] + [("sort", "modules")],
)
def test_defaults_are_understood_in_the_zoos_schema(task, algo) -> None:
    entry = yaml.safe_load((configs.FOLDER / f"{algo}.yml").read_text())[env_id(task)]
    config = configs.defaults(task, algo)
    assert (config.task, config.algo, config.num_envs) == (task, algo, entry["n_envs"])
    assert config.steps == int(entry["n_timesteps"])
    assert config.hidden == tuple(entry["policy_kwargs"]["net_arch"])
    assert f"lin_{config.learning_rate:g}" == f"lin_{float(entry['learning_rate'][4:]):g}"
    for field in fields(config):
        if field.name in entry and field.name != "learning_rate":
            assert getattr(config, field.name) == entry[field.name]


LEARNED = [
    *((task, algo) for algo in ("ppo", "dqn") for task in TASKS),
    ("sort", "modules"),
    ("flow", "schedule"),
    *((task, algo) for algo in ("parcels", "local") for task in ON_SLOPES),
    (f"{ROOT}/examples/reach.py:Reach", "ppo"),
    (f"{ROOT}/examples/haste.py:Haste", "dqn"),
]


@pytest.mark.parametrize(("task", "algo"), LEARNED)
def test_what_is_written_is_read_again(task, algo, tmp_path) -> None:
    hidden = (12,) if algo == "parcels" else (7, 9, 11)
    config = replace(
        configs.defaults(task, algo), steps=123_456, learning_rate=1 / 3e4,
        control_period=0.02, hidden=hidden, checkpoint_every=777,
    )  # fmt: skip
    if isinstance(config, configs.ParcelConfig):
        config = replace(config, friction=0.35)
    assert config.task == task
    whole = replace(config, seed=7, seeds=3, name="a", out=tmp_path)
    configs.write_hyperparams(whole, tmp_path / "own.yml")
    assert configs.defaults(task, algo, tmp_path / "own.yml") == config
    write_config(whole, tmp_path / "config.yaml")
    assert read_config(tmp_path / "config.yaml", task) == whole


def test_it_is_the_zoos_schema(tmp_path) -> None:
    config: configs.TrainConfig = algorithms.DQNConfig(task="slow", num_envs=32, learning_rate=2e-5)
    configs.write_hyperparams(config, tmp_path / "own.yml")
    entry = yaml.safe_load((tmp_path / "own.yml").read_text())["SmartSurface/Slow-v0"]
    assert (entry["n_envs"], entry["n_timesteps"]) == (32, 1_000_000)
    assert (entry["learning_rate"], entry["policy_kwargs"]) == ("lin_2e-05", {"net_arch": [64, 64]})
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
def test_an_unknown_field_is_named(entry, named, tmp_path) -> None:
    (tmp_path / "own.yml").write_text(yaml.safe_dump({"SmartSurface/Sort-v0": entry}))
    with pytest.raises(ValueError, match=r"own\.yml does not hold hyper-parameters: " + named):
        configs.defaults("sort", "ppo", tmp_path / "own.yml")
    with pytest.raises(ValueError, match="task must be one of 'sort' for ppo, got 'slow'"):
        configs.defaults("slow", "ppo", tmp_path / "own.yml")


def test_an_algorithm_of_a_plugin_needs_no_file_of_options(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(ALGORITHMS._values, "plugged", ALGORITHMS["ppo"])
    config = configs.defaults("sort", "plugged")
    assert config == algorithms.PPOConfig(algo="plugged")
    assert training_command(config).endswith("--task sort --algo plugged")
    (tmp_path / "own.yml").write_text("sort: {gamma: 0.9}\n")
    with pytest.raises(ValueError, match="entries must be ids such as 'SmartSurface/Sort-v0', got"):
        configs.defaults("sort", "plugged", tmp_path / "own.yml")


@pytest.mark.parametrize("task", [*TASKS, f"{ROOT}/examples/reach.py:Reach"])
def test_every_task_has_defaults_for_a_device(task, tmp_path) -> None:
    config = configs.defaults(task, "ppo", device="cuda")
    assert isinstance(config, algorithms.PPOConfig)
    assert (config.task, config.device, config.camera_share) == (task, "cuda", 0.0)
    assert config.num_envs >= 16_384
    # Checkpoints are many rollouts apart.
    assert config.checkpoint_every >= 10 * config.num_envs * config.n_steps
    configs.write_hyperparams(config, tmp_path / "own.yml")
    assert configs.defaults(task, "ppo", tmp_path / "own.yml", device="cuda") == config
    of_gpu, of_cpu = (
        yaml.safe_load((configs.FOLDER / f"{name}.yml").read_text()) for name in ("ppo-cuda", "ppo")
    )
    assert set(of_gpu) == {*of_cpu, "beside the zoo"}
    assert set(of_gpu[env_id("sort")]) == set(of_cpu[env_id("sort")])


def test_the_configuration_of_one_seed_of_several() -> None:
    several = algorithms.PPOConfig(seeds=3, steps=5)
    assert configs.config_of_seed(several, 2) == algorithms.PPOConfig(seed=2, seeds=1, steps=5)
