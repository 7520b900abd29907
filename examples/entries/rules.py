"""Entries of the benchmark without learning: fixed layouts and rules of the package.

surface-gym benchmark --policy examples/entries/rules.py:BestRule --kind rule
"""

from typing import Any

import numpy as np

from surface_gym.agents.base import find_axes
from surface_gym.agents.rules import BEST_RULES, RULES
from surface_gym.config import EnvConfig

RULE = BEST_RULES


class FixedLayout:
    """The paper's fixed layout for the task; on streams, all modules let parcels roll on."""

    names = dict.fromkeys(RULE, "fixed layout")

    @classmethod
    def env_kwargs(cls, task: str, preset: str | None) -> dict[str, Any]:
        """Return the arguments of the environment that the rule needs."""
        del preset
        rule = RULES.get(f"{task}: {cls.names[task]}")
        if rule is None:
            return {"actions": "parcels"}
        return {"actions": rule.actions, "observe": list(rule.observe)}

    def __init__(self, config: EnvConfig, seed: int) -> None:
        del seed
        rule = RULES.get(f"{config.task_name}: {self.names[config.task_name]}")
        self._policy = RollOn(config) if rule is None else rule.make(config)

    def predict(self, *arguments: Any, **named: Any) -> Any:
        """Return the rule's actions; see `Controller.predict`."""
        return self._policy.predict(*arguments, **named)


class BestRule(FixedLayout):
    """The best rule of each task."""

    names = RULE


class RollOn:
    """Turns all modules to the angle at which parcels roll on."""

    def __init__(self, config: EnvConfig) -> None:
        self._size, self._choice = config.action_kind.size, find_axes(config).roll

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:  # fmt: skip
        """Return the same actions (num_envs, size) for all observations."""
        del state, episode_start, deterministic
        return np.full((len(observation), self._size), self._choice), None
