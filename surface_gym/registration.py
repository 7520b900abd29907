"""The ids that `gymnasium.make` and `gymnasium.make_vec` know."""

import gymnasium as gym

from surface_gym.tasks import TASKS

MAX_EPISODE_STEPS = {"sort": 100}  # control periods; 4 s at 40 ms


def register() -> None:
    """Register `SmartSurface/<Task>-v0` for every task."""
    for name in TASKS:
        gym.register(
            id=f"SmartSurface/{name.capitalize()}-v0",
            entry_point="surface_gym.env:SmartSurfaceEnv",
            vector_entry_point="surface_gym.vector_env:SmartSurfaceVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS[name],
            kwargs={"task": name},
        )
