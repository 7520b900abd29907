"""Observations that an export is tried on."""

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.conditions import Condition

from ..episodes import arguments
from .source import Source

Singles = NDArray[np.float32]

LANES = 50  # parcels at a time that are driven
FARTHEST = 3.0  # [-] from 0 that a number at random may be
WHOLE_SHARE = 0.1  # [-] of the random numbers that are whole, for what holds at these alone


def observations_for(source: Source, count: int, seed: int = 0) -> Singles:
    """(count, features) half met by the policy where it practised, half at random.

    Args:
        source: of the policy.
        count: of observations.
        seed: of starts, noise and what is drawn.
    """
    practised = source.training.practised
    each = count // 2 // len(practised)
    met = [driven(source, condition, each, seed) for condition in practised]
    there = sum(map(len, met))
    return np.concatenate([*met, at_random(source, count - there, seed)])


def driven(source: Source, condition: Condition, count: int, seed: int) -> Singles:
    """(count, features) along episodes of the policy under a condition."""
    lanes = min(LANES, count)
    settings = source.settings
    given = {**arguments(settings), "condition": condition}
    for name in ("sensors", "actuators", "randomisation"):
        del given[name]  # which the condition sets
    env = SmartSurfaceVectorEnv(
        num_envs=lanes,
        max_episode_steps=settings.chosen_task.periods,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
        **given,
    )
    seen, _ = env.reset(seed=seed)
    kept = [seen]
    while len(kept) * lanes < count:
        action, _ = source.policy.predict(seen, deterministic=True)
        seen, *_ = env.step(action)
        kept.append(seen)
    env.close()
    return np.concatenate(kept)[:count]


def at_random(source: Source, count: int, seed: int) -> Singles:
    """(count, features) of the observation space, as far as it is of moderate size."""
    space = source.settings.observation_space()
    low, high = np.maximum(space.low, -FARTHEST), np.minimum(space.high, FARTHEST)
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(low, high, (count, len(low)))
    drawn = np.where(rng.random(drawn.shape) < WHOLE_SHARE, np.round(drawn), drawn)
    return drawn.astype(np.float32)
