"""What a policy's weights are for."""

from dataclasses import dataclass
from typing import Any

from surface_gym import checks
from surface_gym.core.actions import GROUPS
from surface_gym.registration import FLOW, env_id
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS, Task

CARD = "policy.yaml"  # the file that holds it
ALGOS = ("ppo", "dqn", "modules", "parcels")
FLOW_TASK = "flow"
_NAMES = {**{env_id(name): name for name in TASKS}, FLOW: FLOW_TASK}
OWN = "Own/"  # before the class of a task of one's own, in place of an id


@dataclass(frozen=True)
class PolicyCard:
    """What a policy's weights are for.

    Raises:
        ValueError: a field is out of its range; the message names it.
    """

    env_id: str  # of the package, or "Own/Class" for a task of one's own
    algo: str  # "ppo", "dqn", "modules" or "parcels"
    actions: str  # kind of action
    control_period: float  # [s]
    hidden: tuple[int, ...]  # units of the hidden layers
    observe: tuple[str, ...] = ()  # groups of features that it sees beside the task's

    def __post_init__(self) -> None:
        if not str(self.env_id).startswith(OWN):
            checks.one_of("env_id", self.env_id, _NAMES)
        checks.one_of("algo", self.algo, ALGOS)
        checks.positive("control_period", self.control_period)
        for units in self.hidden:
            checks.integer("hidden", units, least=1)
        if not self.hidden:
            raise ValueError("hidden must be at least one layer, got none")
        if self.algo == "modules":
            checks.one_of("env_id", self.env_id, (env_id("sort"),))
            checks.one_of("actions", self.actions, ("modules",))
        checks.some_of("observe", self.observe, tuple(GROUPS))
        if (self.algo == "parcels") != (self.env_id == FLOW):
            raise ValueError(f"algo must be 'parcels' for {FLOW} alone, got {self.algo!r}")
        if self.algo == "parcels":
            checks.one_of("actions", self.actions, ("parcels",))

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment the policy was trained on."""
        more: dict[str, Any] = {"gate": True} if self.algo == "parcels" else {}
        if self.observe:
            more["observe"] = self.observe
        return {"actions": self.actions, "control_period": self.control_period, **more}

    @property
    def task(self) -> str:
        """The name of the package's task, or of the class of one's own."""
        return _NAMES.get(self.env_id, self.env_id.removeprefix(OWN))

    def settings(self, task: Task | None = None) -> Settings:
        """Those of the environment the policy is for.

        Args:
            task: of one's own that it was trained on; None: one of the package.

        Raises:
            ValueError: it was trained on another task. A card says which, and runs no code for it.
        """
        if self.task == FLOW_TASK:
            raise ValueError(f"env_id must be that of one parcel a lane, got {self.env_id!r}")
        own = self.env_id.startswith(OWN)
        if own and type(task).__name__ != self.task:
            raise ValueError(
                f"task must be {self.task}, of one's own, which the policy was trained on, "
                f"got {None if task is None else type(task).__name__}"
            )
        return Settings(task=task if own and task is not None else self.task, **self.env_kwargs)
