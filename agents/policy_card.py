"""What a policy's weights are for."""

from dataclasses import dataclass
from typing import Any

from surface_gym import checks
from surface_gym.registration import env_id
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS, Task

CARD = "policy.yaml"  # the file that holds it
ALGOS = ("ppo", "dqn", "modules")
_NAMES = {env_id(name): name for name in TASKS}
OWN = "Own/"  # before the class of a task of one's own, in place of an id


@dataclass(frozen=True)
class PolicyCard:
    """What a policy's weights are for.

    Raises:
        ValueError: a field is out of its range; the message names it.
    """

    env_id: str  # of the package, or "Own/Class" for a task of one's own
    algo: str  # "ppo", "dqn" or "modules"
    actions: str  # kind of action
    control_period: float  # [s]
    hidden: tuple[int, ...]  # units of the hidden layers

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

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment the policy was trained on."""
        return {"actions": self.actions, "control_period": self.control_period}

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
        own = self.env_id.startswith(OWN)
        if own and type(task).__name__ != self.task:
            raise ValueError(
                f"task must be {self.task}, of one's own, which the policy was trained on, "
                f"got {None if task is None else type(task).__name__}"
            )
        return Settings(task=task if own and task is not None else self.task, **self.env_kwargs)
