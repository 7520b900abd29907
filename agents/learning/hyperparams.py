"""Hyper-parameters as data: YAML in rl-baselines3-zoo's schema, and the file of a run."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import yaml

from agents.learning.config import CONFIGS, TrainConfig
from agents.policy_card import FLOW_TASK
from agents.tasks import kind_of
from surface_gym.registration import FLOW, env_id
from surface_gym.tasks import TASKS

FOLDER = Path(__file__).parents[1] / "hyperparams"
_NAMES = {"n_envs": "lanes", "n_timesteps": "steps"}  # the zoo's names, and ours
OWN = "default"  # the entry of tasks of one's own
_LINEAR = "lin_"  # the zoo's mark of a learning rate that falls to 0


def defaults(task: str, algo: str) -> TrainConfig:
    """The configuration of a task and an algorithm as their YAML has it.

    Raises:
        ValueError: the algorithm does not learn the task, or the file holds what is not understood.
    """
    file = FOLDER / f"{algo}.yml"
    of_tasks = yaml.safe_load(file.read_text())
    kind = task if task == FLOW_TASK else kind_of(task)
    if kind == FLOW_TASK and FLOW in of_tasks:
        entry = of_tasks[FLOW]
    elif kind in TASKS and env_id(kind) in of_tasks:
        entry = of_tasks[env_id(kind)]
    elif kind not in (*TASKS, FLOW_TASK) and OWN in of_tasks:
        entry = of_tasks[OWN]
    else:
        ids = {FLOW_TASK: FLOW, **{name: env_id(name) for name in TASKS}}
        learned = ", ".join(repr(name) for name, each in ids.items() if each in of_tasks)
        raise ValueError(f"task must be one of {learned} for {algo}, got {task!r}")
    known = {field.name for field in fields(CONFIGS[algo])}
    chosen: dict[str, Any] = {"task": task, "algo": algo}
    for name, value in entry.items():
        if name == "policy" and value == "MlpPolicy":
            continue
        if name == "learning_rate" and isinstance(value, str) and value.startswith(_LINEAR):
            chosen[name] = float(value.removeprefix(_LINEAR))
        elif name == "policy_kwargs" and set(value) == {"net_arch"}:
            chosen["hidden"] = tuple(value["net_arch"])
        elif name == "env_kwargs" and set(value) <= {"actions", "control_period"}:
            chosen.update(value)
        elif name == "n_timesteps":
            chosen["steps"] = int(value)
        elif _NAMES.get(name, name) in known:
            chosen[_NAMES.get(name, name)] = value
        else:
            raise ValueError(f"{file.name}: {name} must be a known setting, got {value!r}")
    return CONFIGS[algo](**chosen)


def write_config(config: TrainConfig, file: Path) -> None:
    """Write all fields of a configuration as YAML."""
    plain = {}
    for field in fields(config):
        value = getattr(config, field.name)
        if isinstance(value, tuple):
            value = list(value)
        plain[field.name] = str(value) if isinstance(value, Path) else value
    file.write_text(yaml.safe_dump(plain, sort_keys=False))


def read_config(file: Path, task: str | None = None) -> TrainConfig:
    """Read what `write_config` wrote.

    Args:
        file: to read.
        task: that it must be of; None: one of the package.

    Raises:
        ValueError: there is no such file, or it holds no configuration, or one of another task.
    """
    if not file.is_file():
        raise ValueError(f"{file.parent} holds no run: {file.name} is missing")
    try:
        plain = yaml.safe_load(file.read_text())
        known = plain["task"] in (*TASKS, FLOW_TASK)
        asked = plain["task"] if task is None and known else task
        if plain["task"] != asked:
            raise ValueError(
                f"task must be {plain['task']!r}, which the run is of: name it by --task, got "
                f"{task!r}"
            )
        plain["hidden"] = tuple(plain["hidden"])
        plain["out"] = Path(plain["out"])
        return CONFIGS[plain["algo"]](**plain)
    except (yaml.YAMLError, TypeError, KeyError, ValueError) as error:
        raise ValueError(f"{file} holds no run's configuration: {error}") from error


def task_of(file: Path) -> str | None:
    """The task that a run's configuration names; None where it is damaged. No code is run."""
    try:
        plain = yaml.safe_load(file.read_text())
        return str(plain["task"])
    except (yaml.YAMLError, TypeError, KeyError):
        return None


def of_seed(config: TrainConfig, seed: int) -> TrainConfig:
    """The run of one seed out of several."""
    return replace(config, seed=seed, seeds=1)
