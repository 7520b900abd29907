"""What a training run is made of; every field is a flag of `train.py`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeGuard, get_args

from surface_gym import checks
from surface_gym.core.actions import GROUPS
from surface_gym.lines import Line

from ..policy_card import FLOW_TASK, PolicyCard
from ..tasks import find_task, id_of

AlgoName = Literal["ppo", "dqn", "modules", "parcels"]
ConditionName = Literal["nominal", "lab"]
NOMINAL: ConditionName = "nominal"  # what one says that asks for nothing else
ActionName = Literal["halves", "quadrants", "window", "modules", "parcels"]
DeviceName = Literal["cpu", "cuda"]
CPU: DeviceName = "cpu"  # where one learns who says nothing else


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """What all algorithms have in common.

    Raises:
        ValueError: a field is out of its range; the message names it.
    """

    task: str = "sort"
    """What to learn: sort, slow, stop, track, orient, or one's own as path/to/file.py:Class."""
    algo: AlgoName = "ppo"
    """PPO, DQN with double Q, or (for Sort) PPO of modules that decide each for itself."""
    seed: int = 0
    """Of the starts, the network and the sampling; the first of `seeds`."""
    seeds: int = 1
    """Trained in parallel processes, and summed up."""
    steps: int = 1_000_000
    """Control periods to learn from, all lanes together."""
    actions: ActionName = "halves"
    """Kind of action, as the environment has it."""
    control_period: float = 0.04
    """[s] between decisions."""
    lanes: int = 64
    """Parcels at a time."""
    condition: ConditionName = NOMINAL
    """What to be ready for: nominal, the two boxes and axes that turn at once; or lab."""
    observe: tuple[str, ...] = ()
    """Groups of features to see beside the task's: parcel, rotors, load."""
    camera_share: float = 0.5
    """[-] of lanes seen by a camera, late and noisy, with varied friction, or in the lab; the
    others exact."""
    zones: tuple[int, ...] = ()
    """Columns that obey, in turn, on half of the lanes seen exactly; none: all as the task has."""
    friction: float = 0.2
    """[-] spread of the friction in these lanes."""
    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers, of policy and value alike."""
    learning_rate: float = 1e-3
    """At the start; it falls to 0 over the run."""
    gamma: float = 0.99
    """Discount a control period."""
    checkpoint_every: int = 500_000
    """Control periods from checkpoint to checkpoint, where all lanes start anew."""
    out: Path = Path("runs")
    """Folder that run folders are made in."""
    name: str | None = None
    """Of the run's folder; by default the task, the algorithm, the seed and the time."""

    def __post_init__(self) -> None:
        self._check_task()
        named = [algo for algo, kind in CONFIGS.items() if kind is type(self)]
        checks.one_of("algo", self.algo, named)
        checks.one_of("actions", self.actions, get_args(ActionName))
        checks.one_of("condition", self.condition, get_args(ConditionName))
        checks.some_of("observe", self.observe, tuple(GROUPS))
        checks.integer("seed", self.seed, least=0)
        for name in ("seeds", "steps", "lanes", "checkpoint_every"):
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
        """Raise a ValueError where there is no such task, or it has no such zones."""
        if not isinstance(find_task(self.task).plant, Line):
            self._check_no_zones()

    def _check_no_zones(self) -> None:
        """Raise a ValueError where there are zones: the task knows none."""
        if self.zones:
            raise ValueError(f"zones must be none for {self.task}, got {self.zones}")


@dataclass(frozen=True, kw_only=True)
class PPOConfig(TrainConfig):
    """Train PPO on a task, then compare it with the paper's fixed layout.

    Defaults are the task's, from agents/hyperparams/ppo.yml.
    """

    n_steps: int = 64
    """Control periods of each lane between updates."""
    batch_size: int = 1024
    """Of a gradient step."""
    n_epochs: int = 5
    """Passes over a rollout."""
    gae_lambda: float = 0.95
    """Of the generalised advantage estimate."""
    ent_coef: float = 0.003
    """Weight of the entropy bonus."""
    device: DeviceName = CPU
    """Where the lanes are moved and the network learns: cpu, or cuda for PPO of lanes seen
    exactly, with defaults from agents/hyperparams/ppo-cuda.yml."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.one_of("device", self.device, get_args(DeviceName))
        if self.device != CPU:
            self._check_on_device()
        for name in ("n_steps", "batch_size", "n_epochs"):
            checks.integer(name, getattr(self, name), least=1)
        if self._samples % self.batch_size:
            raise ValueError(
                f"batch_size must be a factor of lanes x n_steps, {self._samples}, "
                f"got {self.batch_size!r}"
            )
        checks.within("gae_lambda", self.gae_lambda, 0.0, 1.0)
        checks.not_negative("ent_coef", self.ent_coef)

    def _check_on_device(self) -> None:
        """Raise a ValueError where a field is not for a device, which knows no cameras or zones."""
        only = {"algo": "ppo", "condition": NOMINAL, "camera_share": 0.0, "zones": ()}
        for name, allowed in only.items():
            if getattr(self, name) != allowed:
                raise ValueError(
                    f"{name} must be {allowed!r} for device {self.device!r}, "
                    f"got {getattr(self, name)!r}"
                )

    @property
    def _samples(self) -> int:
        """Of a rollout."""
        return self.lanes * self.n_steps


@dataclass(frozen=True, kw_only=True)
class DQNConfig(TrainConfig):
    """Train DQN with double Q on a task, then compare it with the paper's fixed layout.

    Defaults are the task's, from agents/hyperparams/dqn.yml.
    """

    algo: AlgoName = "dqn"
    """PPO, DQN with double Q, or (for Sort) PPO of modules that decide each for itself."""
    buffer_size: int = 500_000
    """Control periods remembered."""
    learning_starts: int = 5_000
    """Control periods before the first gradient step."""
    batch_size: int = 512
    """Of a gradient step."""
    n_steps: int = 3
    """Control periods of reward summed before the network is asked for the rest."""
    gradient_steps: int = 8
    """After every control period of all lanes."""
    tau: float = 0.005
    """[-] share of the network that goes into its slow copy at an update."""
    exploration_fraction: float = 0.15
    """[-] of the run over which the share of random actions falls."""
    exploration_final_eps: float = 0.02
    """[-] share of random actions after that."""
    max_grad_norm: float = 1.0
    """Gradients longer than this are shortened."""

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
    """Train modules that decide each for itself to sort, by PPO with draws they share, then compare
    them with the paper's fixed layout.

    Defaults are from agents/hyperparams/modules.yml.
    """

    algo: AlgoName = "modules"
    """PPO, DQN with double Q, or (for Sort) PPO of modules that decide each for itself."""
    actions: ActionName = "modules"
    """Kind of action, as the environment has it."""
    parted: float = 0.3
    """[-] probability that a line through the parcel parts its modules into two sides, each with a
    draw of its own; otherwise all modules share one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, only in (("task", "sort"), ("actions", "modules")):
            if getattr(self, name) != only:
                raise ValueError(
                    f"{name} must be {only!r} for modules, got {getattr(self, name)!r}"
                )
        checks.within("parted", self.parted, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class ParcelsConfig(PPOConfig):
    """Train parcels of a flow that decide each by weights they share: they imitate a reservation,
    then learn on by PPO. Then their capacity is measured.

    Defaults are from agents/hyperparams/parcels.yml.
    """

    task: str = FLOW_TASK
    """What to learn: flow."""
    algo: AlgoName = "parcels"
    """PPO of a flow's parcels, by shared weights."""
    actions: ActionName = "parcels"
    """Kind of action, as the environment has it."""
    seats: int = 20
    """For parcels on a line at a time, and the one at its gate."""
    clip_range: float = 0.1
    """[-] by which a choice's likelihood may change in an update and still earn."""
    imitation: int = 40
    """Passes over what a reservation does, before; 0: none, learning begins with chance."""
    critic_first: int = 400_000
    """Control periods at the start in which the value is learned alone."""

    @property
    def _samples(self) -> int:
        """Of a rollout: a sample a seat."""
        return self.lanes * self.seats * self.n_steps

    def _check_task(self) -> None:
        self._check_no_zones()
        checks.one_of("task", self.task, (FLOW_TASK,))

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.one_of("actions", self.actions, ("parcels",))
        checks.integer("seats", self.seats, least=2)
        for name in ("imitation", "critic_first"):
            checks.integer(name, getattr(self, name), least=0)
        checks.positive("clip_range", self.clip_range)


def on_device(config: TrainConfig) -> TypeGuard[PPOConfig]:
    """Whether a run's tensors stay on a device beside the CPU."""
    return isinstance(config, PPOConfig) and config.device != CPU


def card_of(config: TrainConfig) -> PolicyCard:
    """What the policy of a run is for."""
    return PolicyCard(
        id_of(config.task),
        config.algo,
        config.actions,
        config.control_period,
        config.hidden,
        config.observe,
    )


CONFIGS: dict[str, type[TrainConfig]] = {
    "ppo": PPOConfig,
    "dqn": DQNConfig,
    "modules": ModulesConfig,
    "parcels": ParcelsConfig,
}
