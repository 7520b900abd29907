"""Hyper-parameters as data: YAML in rl-baselines3-zoo's schema, and the file of a run."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import yaml

from surface_gym import checks
from surface_gym.registration import FLOW, env_id
from surface_gym.tasks import TASKS

from ..policy_card import FLOW_TASK
from ..tasks import kind_of
from .config import CONFIGS, CPU, NOMINAL, TrainConfig

FOLDER = Path(__file__).parents[1] / "hyperparams"
_NAMES = {"n_envs": "lanes", "n_timesteps": "steps"}  # the zoo's names, and ours
_ZOOS = {ours: its for its, ours in _NAMES.items()}
# No hyper-parameters:
_OF_THE_RUN = ("task", "algo", "condition", "device", "seed", "seeds", "out", "name")
_OF_THE_ENV = {"actions", "control_period", "observe"}
# What the zoo has no word for and would refuse: in an entry of its own.
BESIDE = "beside the zoo"
_BESIDE = {
    "camera_share", "zones", "friction", "checkpoint_every", "parted", "seats", "imitation",
    "critic_first",
}  # fmt: skip
OWN = "default"  # the entry of tasks of one's own
_LINEAR = "lin_"  # the zoo's mark of a learning rate that falls to 0


def defaults(
    task: str, algo: str, file: Path | None = None, condition: str = NOMINAL, device: str = CPU
) -> TrainConfig:
    """The configuration of a task and an algorithm as their YAML has it.

    Args:
        task: to learn.
        algo: that learns it.
        file: of one's own, in the same schema; None: the package's.
        condition: what to be ready for.
        device: to learn on.

    Raises:
        ValueError: the algorithm does not learn the task, or not on the device, or the file holds
            what is not understood or not allowed.
    """
    given = {"task": task, "algo": algo, "condition": condition}
    if device != CPU:
        checks.one_of(f"algo, on device {device!r},", algo, ("ppo",))
        given["device"] = device
    if file is None:
        of_what = condition if device == CPU else device
        name = algo if of_what == NOMINAL else f"{algo}-{of_what}"
        return _read(given, FOLDER / f"{name}.yml")
    try:
        return _read(given, file)
    except (OSError, yaml.YAMLError, ValueError) as error:
        words = " ".join(str(error).split())
        raise ValueError(f"{file} does not hold hyper-parameters: {words}") from None


def write_hyperparams(config: TrainConfig, file: Path) -> None:
    """Write a configuration as `defaults` reads it, under its task's id; all but its seeds, its
    folder and its name.
    """
    entry: dict[str, Any] = {}
    beside: dict[str, Any] = {}
    of_env: dict[str, Any] = {}
    for field in fields(config):
        value = getattr(config, field.name)
        if field.name == "hidden":
            entry["policy_kwargs"] = {"net_arch": list(value)}
        elif field.name == "learning_rate":
            entry[field.name] = f"{_LINEAR}{value!r}"
        elif field.name in _OF_THE_ENV:
            if value != ():
                of_env[field.name] = list(value) if isinstance(value, tuple) else value
        elif field.name in _BESIDE:
            beside[field.name] = list(value) if isinstance(value, tuple) else value
        elif field.name not in _OF_THE_RUN:
            entry[_ZOOS.get(field.name, field.name)] = value
    entry["env_kwargs"] = of_env
    key = _key(config.task)
    file.write_text(yaml.safe_dump({key: entry, BESIDE: {key: beside}}, sort_keys=False))


def _key(task: str) -> str:
    """The name of a task's entry."""
    kind = task if task == FLOW_TASK else kind_of(task)
    if kind == FLOW_TASK:
        return FLOW
    return env_id(kind) if kind in TASKS else OWN


def _read(given: dict[str, str], file: Path) -> TrainConfig:
    """What a file says beside what is given: task, algo, condition, and a device but the CPU."""
    task, algo = given["task"], given["algo"]
    of_tasks = yaml.safe_load(file.read_text())
    if not isinstance(of_tasks, dict):
        raise ValueError(f"it must hold an entry a task, got {of_tasks!r}")
    key = _key(task)
    if key not in of_tasks:
        ids = {FLOW_TASK: FLOW, **{name: env_id(name) for name in TASKS}}
        learned = ", ".join(repr(name) for name, each in ids.items() if each in of_tasks)
        raise ValueError(f"task must be one of {learned} for {algo}, got {task!r}")
    beside = of_tasks.get(BESIDE) or {}
    if not isinstance(beside, dict):
        raise ValueError(f"{BESIDE} must hold an entry a task, got {beside!r}")
    entries = [of_tasks[key], beside.get(key, {})]
    for entry in entries:
        if not isinstance(entry, dict):
            raise ValueError(f"{key} must hold names and values, got {entry!r}")
    known = {field.name for field in fields(CONFIGS[algo])}.difference(_OF_THE_RUN)
    chosen: dict[str, Any] = dict(given)
    for name, value in [*entries[0].items(), *entries[1].items()]:
        if name == "policy" and value == "MlpPolicy":
            continue
        if name == "learning_rate":
            chosen[name] = _falling(value)
        elif name == "policy_kwargs" and _is_of_units(value):
            chosen["hidden"] = tuple(value["net_arch"])
        elif name == "env_kwargs" and isinstance(value, dict) and set(value) <= _OF_THE_ENV:
            chosen.update({**value, "observe": tuple(value.get("observe", ()))})
        elif name == "zones" and isinstance(value, list):
            chosen[name] = tuple(value)
        elif name == "n_timesteps":
            chosen["steps"] = int(checks.positive(name, value))
        elif _NAMES.get(name, name) in known:
            chosen[_NAMES.get(name, name)] = value
        else:
            raise ValueError(f"{name} must be a known setting, got {value!r}")
    return CONFIGS[algo](**chosen)


def _falling(value: Any) -> float:
    """A learning rate's first value, in the zoo's words for one that falls to 0."""
    try:
        if isinstance(value, str) and value.startswith(_LINEAR):
            return float(value.removeprefix(_LINEAR))
    except ValueError:
        pass
    raise ValueError(
        f"learning_rate must be {_LINEAR} and a number, since it falls to 0, got {value!r}"
    )


def _is_of_units(value: Any) -> bool:
    """Whether a value is the zoo's for units of hidden layers, and nothing else."""
    return (
        isinstance(value, dict)
        and set(value) == {"net_arch"}
        and isinstance(value["net_arch"], list)
    )


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
        for name in ("hidden", "observe", "zones"):
            plain[name] = tuple(plain.get(name, ()))
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
