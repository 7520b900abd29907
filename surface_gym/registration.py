"""The ids that `gymnasium.make` and `gymnasium.make_vec` know."""

from typing import Any

import gymnasium as gym

from surface_gym.config import ENV_TASKS
from surface_gym.flow.task import StreamTask
from surface_gym.tasks.base import Task


def env_id(task: str) -> str:
    """Return the id of one of the package's environments, by its task's name."""
    return f"SmartSurface/{task.capitalize()}-v0"


FLOW = env_id("flow")


def register(task: type[Task], name: str) -> None:
    """Register a user's task in Gymnasium by a name such as "Mine/Reach-v0"."""
    _register(name, task(), task)


def register_all() -> None:
    """Register `SmartSurface/<Task>-v0` for every task of the package."""
    for name, task in ENV_TASKS.items():
        _register(env_id(name), name, task)


def _register(name: str, given: Any, task: type[Task]) -> None:
    gym.register(
        id=name,
        entry_point="surface_gym.env:SmartSurfaceEnv",
        vector_entry_point="surface_gym.vector_env:make_vector_env",
        # A stream ends by itself, after its duration.
        max_episode_steps=None if issubclass(task, StreamTask) else task.periods,
        kwargs={"task": given},
    )
