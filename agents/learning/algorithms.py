"""The package's learning algorithms: options, training functions and policies.

Training and policy modules are imported on first use, so that options are available without
PyTorch.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, get_args

from surface_gym import checks
from surface_gym.flow.take_away import TakeAwayTask
from surface_gym.flow.task import Flow
from surface_gym.registration import DEFAULT_SLOPE
from surface_gym.tasks.base import Task
from surface_gym.tasks.sort import Sort

from ..library import ALGORITHMS, QUEUE, Algorithm, check_heads
from .config import CPU, NOMINAL, ActionName, DeviceName, ParcelConfig, TrainConfig

MOST_PARCELS = 12  # maximum parcels on a surface for policies of parcels or modules


@dataclass(frozen=True, kw_only=True)
class RolloutConfig(TrainConfig):
    """Options of all PPO algorithms."""

    n_steps: int = 64
    """Control periods per environment between updates."""
    batch_size: int = 1024
    """Samples of a gradient step."""
    n_epochs: int = 5
    """Passes over a rollout."""
    gamma: float = 0.99
    """Discount factor of a control period."""
    gae_lambda: float = 0.95
    """Lambda of the generalised advantage estimate."""
    ent_coef: float = 0.003
    """Weight of the entropy bonus."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("n_steps", "batch_size", "n_epochs"):
            checks.integer(name, getattr(self, name), least=1)
        samples = self.num_envs * self.n_steps
        if samples % self.batch_size:
            raise ValueError(
                f"batch_size must be a factor of num_envs x n_steps, {samples}, "
                f"got {self.batch_size!r}"
            )
        for name in ("gamma", "gae_lambda"):
            checks.within(name, getattr(self, name), 0.0, 1.0)
        checks.not_negative("ent_coef", self.ent_coef)


@dataclass(frozen=True, kw_only=True)
class PPOConfig(ParcelConfig, RolloutConfig):
    """Train PPO on a task, then compare the agent with the paper's fixed layout.

    Each task's defaults are in agents/hyperparams/ppo.yml.
    """

    algo: str = "ppo"
    """PPO."""
    device: DeviceName = CPU
    """Device of the environments and the network: cpu, or cuda with exact sensors, with defaults in
    agents/hyperparams/ppo-cuda.yml.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if checks.one_of("device", self.device, get_args(DeviceName)) == CPU:
            return
        # A device has no cameras or zones.
        allowed = {"preset": NOMINAL, "camera_share": 0.0, "zones": (), "estimate": None}
        for name, only in allowed.items():
            if getattr(self, name) != only:
                raise ValueError(
                    f"{name} must be {only!r} for device {self.device!r}, "
                    f"got {getattr(self, name)!r}"
                )


@dataclass(frozen=True, kw_only=True)
class DQNConfig(ParcelConfig):
    """Train DQN with double Q on a task, then compare the agent with the paper's fixed layout.

    Each task's defaults are in agents/hyperparams/dqn.yml.
    """

    algo: str = "dqn"
    """DQN with double Q."""
    gamma: float = 0.99
    """Discount factor of a control period."""
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
    """[-] weight of the network in updates of the target network."""
    exploration_fraction: float = 0.15
    """[-] share of the run in which the rate of random actions decreases."""
    exploration_final_eps: float = 0.02
    """[-] final rate of random actions."""
    max_grad_norm: float = 1.0
    """Maximum norm of a gradient."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("buffer_size", "batch_size", "n_steps", "gradient_steps"):
            checks.integer(name, getattr(self, name), least=1)
        checks.integer("learning_starts", self.learning_starts, least=0)
        for name in ("gamma", "tau", "exploration_fraction", "exploration_final_eps"):
            checks.within(name, getattr(self, name), 0.0, 1.0)
        checks.positive("max_grad_norm", self.max_grad_norm)


@dataclass(frozen=True, kw_only=True)
class ModulesConfig(ParcelConfig, RolloutConfig):
    """Train a sorting policy by PPO. All modules use the same policy.

    The modules under a parcel share random numbers. The trained agent is compared with the paper's
    fixed layout.

    Defaults are in agents/hyperparams/modules.yml.
    """

    algo: str = "modules"
    """Shared-policy PPO per module."""
    actions: ActionName = "modules"
    """Kind of action, as in the environment."""
    split_probability: float = 0.3
    """[-] probability of splitting a parcel's modules into two groups with separate random numbers.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.within("split_probability", self.split_probability, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class SchedulesConfig(TrainConfig):
    """Train a policy that schedules streams on any line, then measure the policy's capacity.

    The policy learns to predict which of its decisions make parcels touch. The capacity is the
    highest rate of arrivals that the policy sustains.

    Defaults are in agents/hyperparams/schedule.yml.
    """

    task: str = Flow().name
    """Task to learn."""
    algo: str = "schedule"
    """Monte Carlo values of decisions on a schedule."""
    actions: ActionName = "parcels"
    """Kind of action, as in the environment."""
    lines: int = 4
    """Rollouts between updates, each on a random line with `num_envs` streams."""
    batch_size: int = 1024
    """Decisions per gradient step."""
    gradient_steps: int = 60
    """Gradient steps per update."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("lines", "batch_size", "gradient_steps"):
            checks.integer(name, getattr(self, name), least=1)


@dataclass(frozen=True, kw_only=True)
class ParcelsConfig(RolloutConfig):
    """Train one policy shared by all parcels of a stream, by PPO with a reward for each parcel.

    If the task's rule has `is_prior`, the policy corrects this rule. In this case, compare the
    policy with the rules.

    Defaults are in agents/hyperparams/parcels.yml.
    """

    task: str = DEFAULT_SLOPE
    """Task on a stream of parcels."""
    algo: str = "parcels"
    """Shared-policy PPO per parcel."""
    actions: ActionName = "parcels"
    """Kind of action, as in the environment."""
    hidden: tuple[int, ...] = (64,)
    """Units of all layers, one number."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_heads(self.hidden)


@dataclass(frozen=True, kw_only=True)
class LocalConfig(RolloutConfig):
    """Train one policy for all modules on a slope by PPO, then compare the policy with rules.

    A module has local observations and messages of its neighbours. Training begins with imitation
    of the task's rule.

    Defaults are in agents/hyperparams/local.yml.
    """

    task: str = DEFAULT_SLOPE
    """Task on a slope with a take-away."""
    algo: str = "local"
    """Shared-policy PPO per module with local observations."""
    actions: ActionName = "modules"
    """Kind of action, as in the environment."""
    split_probability: float = 0.3
    """[-] probability of splitting a parcel's modules into two groups with separate random numbers.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.within("split_probability", self.split_probability, 0.0, 1.0)


def _later(module: str, name: str) -> Callable[..., Any]:
    """Return a function that, when called, imports `name` from a module and calls `name`."""

    def call(*given: Any, **options: Any) -> Any:
        return getattr(import_module(module, __package__), name)(*given, **options)

    return call


def _trained_by(module: str, learner: str) -> Callable[..., Any]:
    """Return a training function that uses the class `learner` of a module; see `train_learner`."""

    def train(config: TrainConfig, folder: Path, on_progress: Any = lambda *_: None) -> Any:
        from .learner import train_learner

        return train_learner(config, folder, on_progress, _later(module, learner))

    return train


_train_model = _trained_by(".sb3", "ModelLearner")


def _train_ppo(config: PPOConfig, *more: Any) -> Any:
    """Train PPO on the CPU by Stable-Baselines3, and on other devices by the module `cuda`."""
    if config.device == CPU:
        return _train_model(config, *more)
    return _later(".cuda", "train_on_device")(config, *more)


def _shows_parcels(task: Task) -> bool:
    return task.is_stream and any(each.name == "present" for each in task.features)


_BUILD = _later("..policy", "build_policy")
_OF_ONE_PARCEL = ("halves", "quadrants", "window", "modules")
ALGORITHMS.register(
    "ppo",
    Algorithm("PPO", PPOConfig, _train_ppo, _BUILD, _OF_ONE_PARCEL, build_options=()),
)
ALGORITHMS.register(
    "dqn",
    Algorithm(
        "DQN", DQNConfig, _trained_by(".sb3", "ModelLearner"), _BUILD, ("halves",), build_options=()
    ),
)
ALGORITHMS.register(
    "modules",
    Algorithm(
        "PPO per module",
        ModulesConfig,
        _trained_by(".shared", "ModuleLearner"),
        _later("..module_policy", "build_modules"),
        ("modules",),
        lambda task: type(task) is Sort,
        f"{Sort().name!r}",
        build_options=(),
    ),
)
ALGORITHMS.register(
    "schedule",
    Algorithm(
        "decisions on a schedule",
        SchedulesConfig,
        _trained_by(".schedules", "ScheduleLearner"),
        _later("..schedule_policy", "build_schedule"),
        ("parcels",),
        lambda task: type(task) is Flow,
        f"{Flow().name!r}",
        {"gate": True, "queue": QUEUE},
        ("config", "most_touches"),
    ),
)
ALGORITHMS.register(
    "parcels",
    Algorithm(
        "PPO per parcel",
        ParcelsConfig,
        _trained_by(".slopes", "ParcelLearner"),
        _later("..slope_policy", "build_parcels"),
        ("parcels",),
        _shows_parcels,
        "one on a stream of parcels that shows which rows are `present`",
        {"max_parcels": MOST_PARCELS},
        ("config",),
    ),
)
ALGORITHMS.register(
    "local",
    Algorithm(
        "PPO per module",
        LocalConfig,
        _trained_by(".slopes", "LocalLearner"),
        _later("..slope_policy", "build_local"),
        ("modules",),
        lambda task: isinstance(task, TakeAwayTask),
        "one on a slope with a take-away",
        {"max_parcels": MOST_PARCELS},
        ("config",),
    ),
)
