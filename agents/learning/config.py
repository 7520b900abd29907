"""Configuration of a training run; every field is a flag of `train.py`.

Files with the defaults of each task have the format of rl-baselines3-zoo.
"""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar, get_args

import yaml

from surface_gym import checks
from surface_gym.feature_groups import GROUPS
from surface_gym.files import DAMAGE, describe_damage, parse_number
from surface_gym.lines import Line
from surface_gym.registration import DEFAULT_TASK, PERIODS, env_id
from surface_gym.tasks.features import compute_digest

from ..library import (
    MOST_LAYERS,
    PolicyCard,
    card_algo,
    card_env_id,
    find_algorithm,
    find_task,
    read_yaml,
    task_kind,
)

PresetName = Literal["nominal", "lab"]
NOMINAL: PresetName = "nominal"
ActionName = Literal["halves", "quadrants", "window", "modules", "parcels"]
DeviceName = Literal["cpu", "cuda"]
CPU: DeviceName = "cpu"

SWEEP = "sweep.yml"  # file in the folder of a search


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Options of all algorithms. An algorithm's own configuration inherits from this class."""

    presets: ClassVar[tuple[str, ...]] = (NOMINAL,)  # presets of the algorithm

    task: str = DEFAULT_TASK
    """Name of the task, or a custom task as path/to/file.py:Class."""
    algo: str = "ppo"
    """Name of the algorithm, or a custom algorithm as path/to/file.py:NAME."""
    seed: int = 0
    """Seed of the starts, the network and the sampling; the first of `seeds`."""
    seeds: int = 1
    """Number of seeds, trained in parallel processes and summarised."""
    steps: int = 1_000_000
    """Total control periods over all environments."""
    actions: ActionName = "halves"
    """Kind of action, as in the environment."""
    control_period: float = 0.04
    """[s] between decisions."""
    num_envs: int = 64
    """Number of environments."""
    preset: PresetName = NOMINAL
    """Conditions of training: nominal (the two boxes, and axes that turn at once) or lab."""
    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers of policy and value."""
    learning_rate: float = 1e-3
    """Initial learning rate, which decreases linearly to 0."""
    checkpoint_every: int = 500_000
    """Control periods between checkpoints, at which all environments restart."""
    out: Path = Path("runs")
    """Folder of run folders."""
    name: str | None = None
    """Name of the run's folder; the default has task, algorithm, seed and time."""

    def __post_init__(self) -> None:
        algorithm = find_algorithm(self.algo)
        if algorithm.config is not type(self):
            raise ValueError(
                f"algo must be one with the options {type(self).__name__}, got {self.algo!r}"
            )
        algorithm.check(find_task(self.task), self.actions)
        checks.one_of("preset", self.preset, self.presets)
        checks.integer("seed", self.seed, least=0)
        for name in ("seeds", "steps", "num_envs", "checkpoint_every"):
            checks.integer(name, getattr(self, name), least=1)
        checks.positive("control_period", self.control_period)
        checks.positive("learning_rate", self.learning_rate)
        for units in self.hidden:
            checks.integer("hidden", units, least=1)
        if not 1 <= len(self.hidden) <= MOST_LAYERS:
            raise ValueError(f"hidden must be 1 to {MOST_LAYERS} layers, got {len(self.hidden)}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the algorithm's name, because this class may be in a user's file."""
        return _make_config, ({each.name: getattr(self, each.name) for each in fields(self)},)


def _make_config(values: dict[str, Any]) -> TrainConfig:
    config: TrainConfig = find_algorithm(values["algo"]).config(**values)
    return config


@dataclass(frozen=True, kw_only=True)
class ParcelConfig(TrainConfig):
    """Options of algorithms that train with one parcel at a time."""

    presets = (NOMINAL, "lab")

    observe: tuple[str, ...] = ()
    """Additional groups of features in the observation: parcel, rotors, load."""
    camera_share: float = 0.5
    """[-] share of environments with a noisy, delayed camera and varied friction, or with the lab
    preset; the others have exact sensors.
    """
    zones: tuple[int, ...] = ()
    """Columns of other zones, used in equal shares by half of the environments with exact sensors.
    """
    friction: float = 0.2
    """[-] spread of the varied friction."""
    estimate: Path | None = None
    """File of a surface identified by `surface-gym identify`; all environments are on it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.some_of("observe", self.observe, tuple(GROUPS))
        checks.within("camera_share", self.camera_share, 0.0, 1.0)
        if checks.within("friction", self.friction, 0.0, 1.0) == 1.0:
            raise ValueError(f"friction must be less than 1, got {self.friction!r}")
        for columns in self.zones:
            checks.integer("zones", columns, least=1)
        if self.zones and not isinstance(find_task(self.task).line, Line):
            raise ValueError(f"zones must be none for {self.task}, got {self.zones}")


Config = TypeVar("Config", bound=TrainConfig)


def config_of_seed(config: Config, seed: int) -> Config:
    """Return the configuration for one seed of a run with several seeds."""
    return replace(config, seed=seed, seeds=1)


def device_of(config: TrainConfig) -> DeviceName:
    """Return the device of a run. Algorithms without the option `device` run on the CPU."""
    device: DeviceName = getattr(config, "device", CPU)
    return device


def make_card(config: TrainConfig) -> PolicyCard:
    """Build the card, i.e. the description, of a run's policy."""
    card = PolicyCard(
        card_env_id(config.task),
        card_algo(config.algo),
        config.actions,
        config.control_period,
        config.hidden,
        getattr(config, "observe", ()),
    )
    shown = card.env_config(find_task(config.task)).features
    return replace(card, features=compute_digest(shown))


FOLDER = Path(__file__).parents[1] / "hyperparams"
_ZOO = {"num_envs": "n_envs", "steps": "n_timesteps"}  # the zoo's names of fields
_FIELDS = {zoo: name for name, zoo in _ZOO.items()}
# Fields that are no hyper-parameters:
_OF_THE_RUN = ("task", "algo", "preset", "estimate", "device", "seed", "seeds", "out", "name")
_OF_THE_ENV = {"actions", "control_period", "observe"}
# Fields that the zoo does not accept, in a separate section.
BESIDE = "beside the zoo"
_BESIDE = {
    "camera_share", "zones", "friction", "checkpoint_every", "split_probability", "lines",
}  # fmt: skip
OTHERS = "default"  # entry of custom tasks
_LINEAR = "lin_"  # the zoo's prefix of a learning rate that decreases to 0


def defaults(
    task: str, algo: str, file: Path | None = None, preset: str = NOMINAL, device: str = CPU
) -> TrainConfig:
    """Read the default configuration of a task and an algorithm.

    Args:
        file: file of hyper-parameters. The default is the package's file for the algorithm, preset
            and device.
    """
    given = {"task": task, "algo": algo, "preset": preset}
    kind = find_algorithm(algo).config
    checks.one_of("device", device, get_args(DeviceName))
    if device != CPU:
        if "device" not in {each.name for each in fields(kind)}:
            raise ValueError(f"algo must be one for device {device!r}, got {algo!r}")
        given["device"] = device
    if file is None:
        if not (FOLDER / f"{algo}.yml").is_file():  # an algorithm of a user
            config: TrainConfig = kind(**given)
            return config
        checks.one_of("preset", preset, kind.presets)
        variant = preset if device == CPU else device
        name = algo if variant == NOMINAL else f"{algo}-{variant}"
        return _read(given, FOLDER / f"{name}.yml")
    try:
        return _read(given, file)
    except DAMAGE as error:
        reason = describe_damage(error)
        raise ValueError(f"{file} does not hold hyper-parameters: {reason}") from None


def write_hyperparams(config: TrainConfig, file: Path) -> None:
    """Write hyper-parameters to a file that `defaults` reads; leave out seeds, folder and name."""
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
    """Return a task's key in a file of options. The key is an id, or `OTHERS` for a custom task."""
    kind = task_kind(task)
    return env_id(kind) if kind in PERIODS else OTHERS


def _read(given: dict[str, str], file: Path) -> TrainConfig:
    """Read a task's configuration from a file. `given` has task, algorithm, preset and device."""
    task, algo = given["task"], given["algo"]
    of_tasks = read_yaml(file, by_hand=True)
    key = _entry_name(task)
    if key not in of_tasks:
        known = ", ".join(repr(name) for name in PERIODS if env_id(name) in of_tasks)
        if not known:
            raise ValueError(f"entries must be ids such as {key!r}, got {sorted(of_tasks)}")
        raise ValueError(f"task must be one of {known} for {algo}, got {task!r}")
    beside = of_tasks.get(BESIDE) or {}
    if not isinstance(beside, dict):
        raise ValueError(f"{BESIDE} must hold an entry a task, got {beside!r}")
    entries = [of_tasks[key], beside.get(key, {})]
    for entry in entries:
        if not isinstance(entry, dict):
            raise ValueError(f"{key} must hold names and values, got {entry!r}")
    kind = find_algorithm(algo).config
    known_fields = {field.name for field in fields(kind)}.difference(_OF_THE_RUN)
    chosen: dict[str, Any] = dict(given)
    for name, value in [*entries[0].items(), *entries[1].items()]:
        if name == "policy" and value == "MlpPolicy":
            continue
        if name == "learning_rate":
            chosen[name] = _initial_rate(value)
        elif name == "policy_kwargs" and _hidden(value) is not None:
            chosen["hidden"] = _hidden(value)
        elif name == "env_kwargs" and isinstance(value, dict) and set(value) <= _OF_THE_ENV:
            lists = {name: tuple(each) for name, each in value.items() if isinstance(each, list)}
            chosen.update({**value, **lists})
        elif name == "zones" and isinstance(value, list):
            chosen[name] = tuple(value)
        elif name == "n_timesteps":
            chosen["steps"] = int(checks.positive(name, value, 1.0, 1e15))
        elif _FIELDS.get(name, name) in known_fields:
            chosen[_FIELDS.get(name, name)] = value
        else:
            raise ValueError(f"{name} must be a known setting, got {value!r}")
    config: TrainConfig = kind(**chosen)
    return config


def _initial_rate(value: Any) -> float:
    """Parse the zoo's notation of a learning rate that decreases to 0, e.g. "lin_0.001"."""
    try:
        if isinstance(value, str) and value.startswith(_LINEAR):
            return parse_number("learning_rate", value.removeprefix(_LINEAR))
    except ValueError:
        pass
    raise ValueError(
        f"learning_rate must be {_LINEAR} and a number, since it falls to 0, got {value!r:.60}"
    )


def _hidden(value: Any) -> tuple[int, ...] | None:
    """Return the layers in rl-baselines3-zoo's {"net_arch": [...]}, or None for other values."""
    layers = value.get("net_arch") if isinstance(value, dict) and len(value) == 1 else None
    return tuple(layers) if isinstance(layers, list) else None
