"""Watching changes nothing: with actions that no sensor touches, every sensor sees the same run."""

from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.sensors import KINDS, Exact

NUM_ENVS = 64


def first_ends(sensors: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outcome, time and pose at each environment's first end; "modules" depends on no sensing."""
    env = sg.SmartSurfaceVectorEnv(NUM_ENVS, sensors=sensors, max_episode_steps=60)
    env.reset(seed=0, options={"side": 1})
    minus_45 = np.full(env.action_space.shape, 2)  # sorts, so that rotors are left behind
    outcome = np.empty(NUM_ENVS, dtype=object)
    time, pose = np.zeros(NUM_ENVS), np.zeros((NUM_ENVS, 3))
    running = np.ones(NUM_ENVS, dtype=bool)
    while running.any():
        _, _, terminated, truncated, info = env.step(minus_45)
        ended = running & (terminated | truncated)
        outcome[ended] = info["outcome"][ended]
        time[ended], pose[ended] = info["time"][ended], info["pose"][ended]
        running &= ~ended
    return outcome, time, pose


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_sensor_leaves_the_truth_alone(kind: Any) -> None:
    for seen, true in zip(first_ends(kind()), first_ends(Exact()), strict=True):
        np.testing.assert_array_equal(seen, true)
