"""The ids that `gymnasium.make` and `gymnasium.make_vec` know."""

import gymnasium as gym

from surface_gym.tasks import TASKS

# Control periods of an episode at most: 4 to 12 s at 40 ms.
MAX_EPISODE_STEPS = {"sort": 100, "slow": 100, "stop": 150, "track": 300, "orient": 200}


def env_id(task: str) -> str:
    """The id of a task's environment."""
    return f"SmartSurface/{task.capitalize()}-v0"


def register() -> None:
    """Register `SmartSurface/<Task>-v0` for every task."""
    for name in TASKS:
        gym.register(
            id=env_id(name),
            entry_point="surface_gym.env:SmartSurfaceEnv",
            vector_entry_point="surface_gym.vector_env:SmartSurfaceVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS[name],
            kwargs={"task": name},
        )
