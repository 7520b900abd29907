"""Environments for LeRobot's EnvHub: put this file into a repository of the hub, as env.py.

from lerobot.envs.factory import make_env
envs = make_env("USER/REPOSITORY", n_envs=8, trust_remote_code=True)
"""

from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TransformObservation

import surface_gym  # noqa: F401  registers the environments

STATE = "agent_pos"  # which LeRobot calls observation.state


def make_single(task: str) -> gym.Env[Any, Any]:
    """Make an environment; actions are the angles [rad] of axes ahead of the parcel and behind."""
    env = gym.make(
        f"SmartSurface/{task.capitalize()}-v0", actions="halves", orientations="any",
        render_mode="rgb_array",
    )  # fmt: skip
    space = gym.spaces.Dict({STATE: env.observation_space})
    return TransformObservation(env, lambda seen: {STATE: seen}, space)


def make_env(n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None) -> Any:
    """Make environments of a task of one parcel, by default Sort; LeRobot calls this function."""
    task = getattr(cfg, "task", None) or "sort"
    kind = AsyncVectorEnv if use_async_envs else SyncVectorEnv
    makers = [partial(make_single, task)] * n_envs
    return {task: {0: kind(makers, autoreset_mode=AutoresetMode.SAME_STEP)}}
