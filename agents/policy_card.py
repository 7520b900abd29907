"""What a policy's weights are for."""

from dataclasses import dataclass
from typing import Any

import gymnasium as gym

from surface_gym import checks
from surface_gym.registration import env_id
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS

ALGOS = ("ppo", "dqn", "modules")


@dataclass(frozen=True)
class PolicyCard:
    """What a policy's weights are for.

    Raises:
        ValueError: a field is out of its range; the message names it.
    """

    env_id: str
    algo: str  # "ppo", "dqn" or "modules"
    actions: str  # kind of action
    control_period: float  # [s]
    hidden: tuple[int, ...]  # units of the hidden layers

    def __post_init__(self) -> None:
        checks.one_of("env_id", self.env_id, [env_id(task) for task in TASKS])
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
        """The task's name."""
        return str(gym.spec(self.env_id).kwargs["task"])

    @property
    def settings(self) -> Settings:
        """Those of the environment the policy is for."""
        return Settings(task=self.task, **self.env_kwargs)
