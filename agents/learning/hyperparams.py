"""Hyper-parameters as data: YAML in rl-baselines3-zoo's schema."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from surface_gym import checks
from surface_gym.registration import FLOW, env_id

from ..base import FLOW_TASK
from .config import CONFIGS, CPU, NOMINAL, RENAMED, TrainConfig, is_registered

FOLDER = Path(__file__).parents[1] / "hyperparams"
_ZOO = {"num_envs": "n_envs", "steps": "n_timesteps"}  # the zoo's names of fields
_FIELDS = {**RENAMED, **{zoo: name for name, zoo in _ZOO.items()}}
# No hyper-parameters:
_OF_THE_RUN = ("task", "algo", "preset", "device", "seed", "seeds", "out", "name")
_OF_THE_ENV = {"actions", "control_period", "observe"}
# Fields that the zoo does not know and would refuse, in a section of their own.
BESIDE = "beside the zoo"
_BESIDE = {
    "camera_share", "zones", "friction", "checkpoint_every", "split_probability", "slots",
    "imitation", "critic_first",
}  # fmt: skip
OWN = "default"  # the entry of users' tasks
_LINEAR = "lin_"  # the zoo's mark of a learning rate that falls to 0


def defaults(
    task: str, algo: str, file: Path | None = None, preset: str = NOMINAL, device: str = CPU
) -> TrainConfig:
    """Read the default configuration of a task and an algorithm.

    Args:
        task: to learn.
        algo: to learn it by.
        file: of a user, in the same schema; None: the package's.
        preset: conditions to train for.
        device: to learn on.

    Raises:
        ValueError: the algorithm does not learn the task, or not on the device, or the file holds
            something unknown or not allowed.
    """
    given = {"task": task, "algo": algo, "preset": preset}
    if device != CPU:
        checks.one_of(f"algo, on device {device!r},", algo, ("ppo",))
        given["device"] = device
    if file is None:
        variant = preset if device == CPU else device
        name = algo if variant == NOMINAL else f"{algo}-{variant}"
        return _read(given, FOLDER / f"{name}.yml")
    try:
        return _read(given, file)
    except (OSError, yaml.YAMLError, ValueError) as error:
        message = " ".join(str(error).split())
        raise ValueError(f"{file} does not hold hyper-parameters: {message}") from None


def write_hyperparams(config: TrainConfig, file: Path) -> None:
    """Write a configuration for `defaults` to read, without its seeds, folder and name."""
    entry: dict[str, Any] = {}
    beside: dict[str, Any] = {}
    of_env: dict[str, Any] = {}
    for field in fields(config):
        value = getattr(config, field.name)
        plain = list(value) if isinstance(value, tuple) else value
        if field.name == "hidden":
            entry["policy_kwargs"] = {"net_arch": plain}
        elif field.name == "learning_rate":
            entry[field.name] = f"{_LINEAR}{value!r}"
        elif field.name in _OF_THE_ENV:
            if value != ():
                of_env[field.name] = plain
        elif field.name in _BESIDE:
            beside[field.name] = plain
        elif field.name not in _OF_THE_RUN:
            entry[_ZOO.get(field.name, field.name)] = value
    entry["env_kwargs"] = of_env
    key = _entry_name(config.task)
    file.write_text(yaml.safe_dump({key: entry, BESIDE: {key: beside}}, sort_keys=False))


def _entry_name(task: str) -> str:
    """Return the name of a task's entry: the id of the package's task, or `OWN`."""
    if task == FLOW_TASK:
        return FLOW
    if is_registered(task):
        return env_id(task)
    from ..tasks import task_kind

    kind = task_kind(task)
    return env_id(kind) if is_registered(kind) else OWN


def _read(given: dict[str, str], file: Path) -> TrainConfig:
    """Read a task's entry; task, algorithm, preset and device are given."""
    task, algo = given["task"], given["algo"]
    of_tasks = yaml.safe_load(file.read_text())
    if not isinstance(of_tasks, dict):
        raise ValueError(f"it must hold an entry a task, got {of_tasks!r}")
    key = _entry_name(task)
    if key not in of_tasks:
        ids = [name for name in of_tasks if str(name).startswith("SmartSurface/")]
        known = ", ".join(repr(_task_name(name)) for name in ids)
        raise ValueError(f"task must be one of {known} for {algo}, got {task!r}")
    beside = of_tasks.get(BESIDE) or {}
    if not isinstance(beside, dict):
        raise ValueError(f"{BESIDE} must hold an entry a task, got {beside!r}")
    entries = [of_tasks[key], beside.get(key, {})]
    for entry in entries:
        if not isinstance(entry, dict):
            raise ValueError(f"{key} must hold names and values, got {entry!r}")
    known_fields = {field.name for field in fields(CONFIGS[algo])}.difference(_OF_THE_RUN)
    chosen: dict[str, Any] = dict(given)
    for name, value in [*entries[0].items(), *entries[1].items()]:
        if name == "policy" and value == "MlpPolicy":
            continue
        if name == "learning_rate":
            chosen[name] = _initial_rate(value)
        elif name == "policy_kwargs" and _is_net_arch(value):
            chosen["hidden"] = tuple(value["net_arch"])
        elif name == "env_kwargs" and isinstance(value, dict) and set(value) <= _OF_THE_ENV:
            chosen.update({**value, "observe": tuple(value.get("observe", ()))})
        elif name == "zones" and isinstance(value, list):
            chosen[name] = tuple(value)
        elif name == "n_timesteps":
            chosen["steps"] = int(checks.positive(name, value))
        elif _FIELDS.get(name, name) in known_fields:
            chosen[_FIELDS.get(name, name)] = value
        else:
            raise ValueError(f"{name} must be a known setting, got {value!r}")
    return CONFIGS[algo](**chosen)


def _task_name(env: str) -> str:
    """Return the task's name in an id such as "SmartSurface/Sort-v0"."""
    return env.removeprefix("SmartSurface/").rpartition("-")[0].lower()


def _initial_rate(value: Any) -> float:
    """Parse the zoo's notation of a learning rate that falls to 0."""
    try:
        if isinstance(value, str) and value.startswith(_LINEAR):
            return float(value.removeprefix(_LINEAR))
    except ValueError:
        pass
    raise ValueError(
        f"learning_rate must be {_LINEAR} and a number, since it falls to 0, got {value!r}"
    )


def _is_net_arch(value: Any) -> bool:
    """Return whether a value is the zoo's notation of hidden layers, and nothing else."""
    return (
        isinstance(value, dict)
        and set(value) == {"net_arch"}
        and isinstance(value["net_arch"], list)
    )
