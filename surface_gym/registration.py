"""The ids that `gymnasium.make` and `gymnasium.make_vec` know."""

from typing import Any

import gymnasium as gym

from surface_gym.tasks import TASKS
from surface_gym.tasks.base import Task

FLOW = "SmartSurface/Flow-v0"  # ends by itself, after its duration


def env_id(task: str) -> str:
    """The id of one of the package's environments, by its task's name."""
    return f"SmartSurface/{task.capitalize()}-v0"


def register(task: type[Task], name: str) -> None:
    """Make a task of one's own known to Gymnasium by a name such as "Mine/Reach-v0"."""
    _register(name, task(), task.periods)


def register_all() -> None:
    """Register `SmartSurface/<Task>-v0` for every task of the package."""
    for name, task in TASKS.items():
        _register(env_id(name), name, task.periods)
    gym.register(
        id=FLOW,
        entry_point="surface_gym.flow.env:FlowEnv",
        vector_entry_point="surface_gym.devices:make_flow_vector_env",
    )


def _register(name: str, task: Any, periods: int) -> None:
    gym.register(
        id=name,
        entry_point="surface_gym.env:SmartSurfaceEnv",
        vector_entry_point="surface_gym.devices:make_vector_env",
        max_episode_steps=periods,
        kwargs={"task": task},
    )
