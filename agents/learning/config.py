"""Configuration of a training run; every field is a flag of `train.py`."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeGuard, get_args

import yaml

from surface_gym import checks
from surface_gym.files import DAMAGE, describe_damage, parse_number
from surface_gym.registration import FLOW_TASK, ON_SLOPES, PERIODS, env_id

from ..yaml_file import read_yaml

if TYPE_CHECKING:
    from ..library import PolicyCard

AlgoName = Literal["ppo", "dqn", "modules", "schedule", "parcels", "local"]
PresetName = Literal["nominal", "lab"]
NOMINAL: PresetName = "nominal"
ActionName = Literal["halves", "quadrants", "window", "modules", "parcels"]
DeviceName = Literal["cpu", "cuda"]
CPU: DeviceName = "cpu"

# Earlier names of fields, which files and command lines may still have.
RENAMED = {
    "lanes": "num_envs",
    "condition": "preset",
    "parted": "split_probability",
}


def current_option(argument: str) -> str:
    """Return an argument with the current name of its option, if it has an earlier one."""
    option, equals, value = argument.partition("=")
    name = option.removeprefix("--")
    if option == name or name not in RENAMED:
        return argument
    return f"--{RENAMED[name].replace('_', '-')}{equals}{value}"


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Options of all algorithms."""

    task: str = "sort"
    """Task to learn: sort, slow, stop, track, orient, or a user's as path/to/file.py:Class."""
    algo: AlgoName = "ppo"
    """PPO; DQN with double Q; shared-policy PPO per module (modules, Sort); Monte Carlo values of
    decisions on a schedule (schedule, Flow); on slopes PPO per parcel (parcels) or per module that
    sees what is near (local)."""
    seed: int = 0
    """Seed of the starts, the network and the sampling; the first of `seeds`."""
    seeds: int = 1
    """Number of seeds, trained in parallel processes and summarised."""
    steps: int = 1_000_000
    """Control periods to learn from, of all environments together."""
    actions: ActionName = "halves"
    """Kind of action, as in the environment."""
    control_period: float = 0.04
    """[s] between decisions."""
    num_envs: int = 64
    """Number of environments."""
    preset: PresetName = NOMINAL
    """Conditions to train for: nominal, the two boxes and axes that turn at once; or lab."""
    observe: tuple[str, ...] = ()
    """Groups of features in the observation beside the task's: parcel, rotors, load."""
    camera_share: float = 0.5
    """[-] of environments with a late and noisy camera and varied friction, or the lab preset; the
    others have exact sensors."""
    zones: tuple[int, ...] = ()
    """Columns of other zones, each on an equal share of half of the environments with exact
    sensors; none: the task's zone on all."""
    friction: float = 0.2
    """[-] spread of the varied friction."""
    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers, of policy and value alike."""
    learning_rate: float = 1e-3
    """Learning rate at the start; it falls to 0 over the run."""
    gamma: float = 0.99
    """Discount factor of a control period."""
    checkpoint_every: int = 500_000
    """Control periods between checkpoints, at which all environments start anew."""
    out: Path = Path("runs")
    """Folder to make run folders in."""
    name: str | None = None
    """Name of the run's folder; by default the task, the algorithm, the seed and the time."""

    def __post_init__(self) -> None:
        self._check_task()
        named = [algo for algo, kind in CONFIGS.items() if kind is type(self)]
        checks.one_of("algo", self.algo, named)
        checks.one_of("actions", self.actions, get_args(ActionName))
        checks.one_of("preset", self.preset, get_args(PresetName))
        if self.observe:
            from surface_gym.core.actions import GROUPS

            checks.some_of("observe", self.observe, tuple(GROUPS))
        checks.integer("seed", self.seed, least=0)
        for name in ("seeds", "steps", "num_envs", "checkpoint_every"):
            checks.integer(name, getattr(self, name), least=1)
        checks.positive("control_period", self.control_period)
        checks.positive("learning_rate", self.learning_rate)
        for name in ("camera_share", "gamma"):
            checks.within(name, getattr(self, name), 0.0, 1.0)
        if checks.within("friction", self.friction, 0.0, 1.0) == 1.0:
            raise ValueError(f"friction must be less than 1, got {self.friction!r}")
        for columns in self.zones:
            checks.integer("zones", columns, least=1)
        for units in self.hidden:
            checks.integer("hidden", units, least=1)
        if not self.hidden:
            raise ValueError("hidden must be at least one layer, got none")

    def _check_task(self) -> None:
        """Raise a ValueError if there is no such task, or if it has no such zones."""
        if not self.zones and is_registered(self.task):
            return
        from surface_gym.lines import Line

        from ..library import find_task

        if not isinstance(find_task(self.task).line, Line):
            self._check_no_zones()

    def _check_no_zones(self) -> None:
        if self.zones:
            raise ValueError(f"zones must be none for {self.task}, got {self.zones}")


@dataclass(frozen=True, kw_only=True)
class PPOConfig(TrainConfig):
    """Train PPO on a task, then compare it with the paper's fixed layout.

    Defaults are the task's, in agents/hyperparams/ppo.yml.
    """

    n_steps: int = 64
    """Control periods of each environment between updates."""
    batch_size: int = 1024
    """Samples of a gradient step."""
    n_epochs: int = 5
    """Passes over a rollout."""
    gae_lambda: float = 0.95
    """Lambda of the generalised advantage estimate."""
    ent_coef: float = 0.003
    """Weight of the entropy bonus."""
    device: DeviceName = CPU
    """Device of the environments and the network: cpu, or cuda for PPO with exact sensors, with
    defaults in agents/hyperparams/ppo-cuda.yml."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.one_of("device", self.device, get_args(DeviceName))
        if self.device != CPU:
            self._check_on_device()
        for name in ("n_steps", "batch_size", "n_epochs"):
            checks.integer(name, getattr(self, name), least=1)
        if self._samples % self.batch_size:
            raise ValueError(
                f"batch_size must be a factor of num_envs x n_steps, {self._samples}, "
                f"got {self.batch_size!r}"
            )
        checks.within("gae_lambda", self.gae_lambda, 0.0, 1.0)
        checks.not_negative("ent_coef", self.ent_coef)

    def _check_on_device(self) -> None:
        """Raise a ValueError if a field is not for a device, which has no cameras or zones."""
        only = {"algo": "ppo", "preset": NOMINAL, "camera_share": 0.0, "zones": ()}
        for name, allowed in only.items():
            if getattr(self, name) != allowed:
                raise ValueError(
                    f"{name} must be {allowed!r} for device {self.device!r}, "
                    f"got {getattr(self, name)!r}"
                )

    @property
    def _samples(self) -> int:
        return self.num_envs * self.n_steps


@dataclass(frozen=True, kw_only=True)
class DQNConfig(TrainConfig):
    """Train DQN with double Q on a task, then compare it with the paper's fixed layout.

    Defaults are the task's, in agents/hyperparams/dqn.yml.
    """

    algo: AlgoName = "dqn"
    """PPO; DQN with double Q; shared-policy PPO per module (modules, Sort); Monte Carlo values of
    decisions on a schedule (schedule, Flow); on slopes PPO per parcel (parcels) or per module that
    sees what is near (local)."""
    buffer_size: int = 500_000
    """Transitions in the replay buffer."""
    learning_starts: int = 5_000
    """Control periods before the first gradient step."""
    batch_size: int = 512
    """Samples of a gradient step."""
    n_steps: int = 3
    """Control periods of an n-step return."""
    gradient_steps: int = 8
    """Gradient steps after every control period of all environments."""
    tau: float = 0.005
    """[-] weight of the network in an update of the target network."""
    exploration_fraction: float = 0.15
    """[-] of the run in which the share of random actions falls."""
    exploration_final_eps: float = 0.02
    """[-] share of random actions after that."""
    max_grad_norm: float = 1.0
    """Maximum norm of a gradient."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.actions != "halves":
            raise ValueError(f"actions must be 'halves' for DQN, got {self.actions!r}")
        for name in ("buffer_size", "batch_size", "n_steps", "gradient_steps"):
            checks.integer(name, getattr(self, name), least=1)
        checks.integer("learning_starts", self.learning_starts, least=0)
        for name in ("tau", "exploration_fraction", "exploration_final_eps"):
            checks.within(name, getattr(self, name), 0.0, 1.0)
        checks.positive("max_grad_norm", self.max_grad_norm)


@dataclass(frozen=True, kw_only=True)
class ModulesConfig(PPOConfig):
    """Train one policy shared by all modules to sort, by PPO with shared draws, then compare it
    with the paper's fixed layout.

    Defaults are in agents/hyperparams/modules.yml.
    """

    algo: AlgoName = "modules"
    """PPO; DQN with double Q; shared-policy PPO per module (modules, Sort); Monte Carlo values of
    decisions on a schedule (schedule, Flow); on slopes PPO per parcel (parcels) or per module that
    sees what is near (local)."""
    actions: ActionName = "modules"
    """Kind of action, as in the environment."""
    split_probability: float = 0.3
    """[-] that a line through the parcel splits its modules into two groups, each with a draw of
    its own; otherwise all modules share one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, only in (("task", "sort"), ("actions", "modules")):
            if getattr(self, name) != only:
                raise ValueError(
                    f"{name} must be {only!r} for modules, got {getattr(self, name)!r}"
                )
        checks.within("split_probability", self.split_probability, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class SchedulesConfig(TrainConfig):
    """Train one policy on the schedule of streams, on any lines: it learns which decisions lead to
    touches, from those that it takes itself. Then measure its capacity.

    Defaults are in agents/hyperparams/schedule.yml.
    """

    task: str = FLOW_TASK
    """Task to learn: flow."""
    algo: AlgoName = "schedule"
    """Monte Carlo values of decisions on a schedule."""
    actions: ActionName = "parcels"
    """Kind of action, as in the environment."""
    lines: int = 4
    """Rollouts between updates, each on a line drawn at random, with `num_envs` streams."""
    batch_size: int = 1024
    """Decisions of a gradient step."""
    gradient_steps: int = 60
    """Gradient steps of an update."""

    def _check_task(self) -> None:
        self._check_no_zones()
        checks.one_of("task", self.task, (FLOW_TASK,))

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.one_of("actions", self.actions, ("parcels",))
        for name in ("lines", "batch_size", "gradient_steps"):
            checks.integer(name, getattr(self, name), least=1)


@dataclass(frozen=True, kw_only=True)
class ParcelsConfig(PPOConfig):
    """Train one policy shared by all parcels on a slope, which corrects the task's rule, by PPO
    with a reward for each; then compare it with that rule.

    Defaults are in agents/hyperparams/parcels.yml.
    """

    task: str = "singulate"
    """Task to learn: singulate, merge or sequence."""
    algo: AlgoName = "parcels"
    """PPO per parcel."""
    actions: ActionName = "parcels"
    """Kind of action, as in the environment."""
    hidden: tuple[int, ...] = (64,)
    """Units of all layers, one number."""

    def _check_task(self) -> None:
        self._check_no_zones()
        checks.one_of("task", self.task, ON_SLOPES)

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.one_of("actions", self.actions, ("parcels",))
        from ..library import check_heads

        check_heads(self.hidden)


@dataclass(frozen=True, kw_only=True)
class LocalConfig(PPOConfig):
    """Train one policy shared by all modules on a slope, each of which sees only itself and what
    its neighbours pass on, by PPO, beginning from the task's rule; then compare it with that rule.

    Defaults are in agents/hyperparams/local.yml.
    """

    task: str = "singulate"
    """Task to learn: singulate, merge or sequence."""
    algo: AlgoName = "local"
    """PPO per module."""
    actions: ActionName = "modules"
    """Kind of action, as in the environment."""
    split_probability: float = 0.3
    """[-] that a line through a parcel splits its modules into two groups, each with a draw of its
    own; otherwise all modules share one."""

    def _check_task(self) -> None:
        self._check_no_zones()
        checks.one_of("task", self.task, ON_SLOPES)

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.one_of("actions", self.actions, ("modules",))
        checks.within("split_probability", self.split_probability, 0.0, 1.0)


CONFIGS: dict[str, type[TrainConfig]] = {
    "ppo": PPOConfig,
    "dqn": DQNConfig,
    "modules": ModulesConfig,
    "schedule": SchedulesConfig,
    "parcels": ParcelsConfig,
    "local": LocalConfig,
}


def is_registered(task: str) -> bool:
    """Return whether a name is that of a single-parcel task of the package."""
    return PERIODS.get(task) is not None


def on_device(config: TrainConfig) -> TypeGuard[PPOConfig]:
    """Return whether a run's tensors stay on a device other than the CPU."""
    return isinstance(config, PPOConfig) and config.device != CPU


def config_of_seed(config: TrainConfig, seed: int) -> TrainConfig:
    """Return the configuration of one seed of several."""
    return replace(config, seed=seed, seeds=1)


def make_card(config: TrainConfig) -> "PolicyCard":
    """Build the card of a run's policy."""
    from ..library import PolicyCard, card_env_id

    return PolicyCard(
        card_env_id(config.task),
        config.algo,
        config.actions,
        config.control_period,
        config.hidden,
        config.observe,
    )


FOLDER = Path(__file__).parents[1] / "hyperparams"
_ZOO = {"num_envs": "n_envs", "steps": "n_timesteps"}  # the zoo's names of fields
_FIELDS = {**RENAMED, **{zoo: name for name, zoo in _ZOO.items()}}
# No hyper-parameters:
_OF_THE_RUN = ("task", "algo", "preset", "device", "seed", "seeds", "out", "name")
_OF_THE_ENV = {"actions", "control_period", "observe"}
# Fields that the zoo does not know and would refuse, in a section of their own.
BESIDE = "beside the zoo"
_BESIDE = {
    "camera_share", "zones", "friction", "checkpoint_every", "split_probability", "lines",
}  # fmt: skip
OWN = "default"  # the entry of users' tasks
_LINEAR = "lin_"  # the zoo's mark of a learning rate that falls to 0


def defaults(
    task: str, algo: str, file: Path | None = None, preset: str = NOMINAL, device: str = CPU
) -> TrainConfig:
    """Read the default configuration of a task and an algorithm."""
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
    except DAMAGE as error:
        reason = describe_damage(error)
        raise ValueError(f"{file} does not hold hyper-parameters: {reason}") from None


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
    if task in PERIODS:
        return env_id(task)
    from ..library import task_kind

    kind = task_kind(task)
    return env_id(kind) if is_registered(kind) else OWN


def _read(given: dict[str, str], file: Path) -> TrainConfig:
    """Read a task's entry; task, algorithm, preset and device are given."""
    task, algo = given["task"], given["algo"]
    of_tasks = read_yaml(file, by_hand=True)
    key = _entry_name(task)
    if key not in of_tasks:
        known = ", ".join(repr(name) for name in PERIODS if env_id(name) in of_tasks)
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
        elif name == "policy_kwargs" and _hidden(value) is not None:
            chosen["hidden"] = _hidden(value)
        elif name == "env_kwargs" and isinstance(value, dict) and set(value) <= _OF_THE_ENV:
            chosen.update({**value, "observe": tuple(value.get("observe", ()))})
        elif name == "zones" and isinstance(value, list):
            chosen[name] = tuple(value)
        elif name == "n_timesteps":
            chosen["steps"] = int(checks.positive(name, value, 1.0, 1e15))
        elif _FIELDS.get(name, name) in known_fields:
            chosen[_FIELDS.get(name, name)] = value
        else:
            raise ValueError(f"{name} must be a known setting, got {value!r}")
    return CONFIGS[algo](**chosen)


def _initial_rate(value: Any) -> float:
    """Parse the zoo's notation of a learning rate that falls to 0."""
    try:
        if isinstance(value, str) and value.startswith(_LINEAR):
            return parse_number("learning_rate", value.removeprefix(_LINEAR))
    except ValueError:
        pass
    raise ValueError(
        f"learning_rate must be {_LINEAR} and a number, since it falls to 0, got {value!r:.60}"
    )


def _hidden(value: Any) -> tuple[int, ...] | None:
    """Parse the zoo's notation of hidden layers; None where there is more or anything else."""
    layers = value.get("net_arch") if isinstance(value, dict) and len(value) == 1 else None
    return tuple(layers) if isinstance(layers, list) else None
