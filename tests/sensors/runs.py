"""Runs of Sort whose sensed poses are held against the true ones."""

from typing import Any

import numpy as np

import surface_gym as sg

ROLL, MINUS_45, PLUS_45, BRAKE = 3, 2, 1, 0


def errors(sensors: Any, choice: int, lanes: int = 16, seed: int = 0, **start: Any) -> np.ndarray:
    """(decisions, 6) sensed pose and velocity minus the true ones, over episodes of one choice."""
    env = sg.SmartSurfaceVectorEnv(
        lanes, actions="quadrants", sensors=sensors, max_episode_steps=60, autoreset_mode="SameStep"
    )
    env.reset(seed=seed, options={"side": 1, **start})
    memory = env._batch.lanes
    found = []
    running = np.ones(lanes, dtype=bool)
    while running.any():
        _, _, terminated, truncated, _ = env.step(np.full((lanes, 4), choice))
        running &= ~(terminated | truncated)
        found.append((memory.sensed - memory.truth)[running])
    return np.concatenate(found)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0))
