"""Presence where the world is not as its observer assumes: it has to stay with its switches."""

from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.sensors import Presence
from tests.sensors.runs import contradicts

NUM_ENVS, PERIODS, HELD = 48, 75, 5
PITCH = 0.1  # [m]
NOMINAL = 0.5  # [-] mu_max of every line

WORLDS = {
    "load": (Presence(), sg.Randomisation(com_offset=0.5)),
    "friction 0.8": (Presence(mu_max=NOMINAL / 0.8), sg.Randomisation()),
    "friction 1.2": (Presence(mu_max=NOMINAL / 1.2), sg.Randomisation()),
}


def drive(env: sg.SmartSurfaceVectorEnv, parcel: str, periods: int = PERIODS) -> Any:
    """Random actions, each held a while; after each period the environments that still run."""
    env.reset(seed=0, options={"parcel": parcel})
    env.action_space.seed(0)
    running = np.ones(env.num_envs, dtype=bool)
    for period in range(periods):
        if period % HELD == 0:
            action = env.action_space.sample()
        observation, _, terminated, truncated, _ = env.step(action)
        running &= ~(terminated | truncated)
        yield observation[running], running


def env_of(world: str, **settings: Any) -> sg.SmartSurfaceVectorEnv:
    sensors, randomisation = WORLDS[world]
    return sg.SmartSurfaceVectorEnv(
        NUM_ENVS,
        "track",
        actions="quadrants",
        sensors=sensors,
        randomisation=randomisation,
        **settings,
    )


@pytest.mark.parametrize("parcel", ["S", "B"])
@pytest.mark.parametrize("world", WORLDS)
def test_the_estimate_stays_with_the_switches(world: str, parcel: str) -> None:
    env = env_of(world)
    memory = env.batch.parcels
    row = np.zeros(NUM_ENVS, dtype=int)
    space = env.single_observation_space
    for observations, running in drive(env, parcel):
        error = np.hypot(*(memory.sensed - memory.truth)[running, :2].T)
        assert error.max(initial=0.0) <= PITCH
        row = np.where(contradicts(env, parcel, 0.001) & running, row + 1, 0)
        assert row.max() <= 2
        assert all(space.contains(observation) for observation in observations)


def test_an_estimate_that_is_thrown_off_comes_back() -> None:
    env = env_of("load")
    for _ in drive(env, "B", periods=3):
        pass
    memory = env.batch.parcels
    memory.sensor_state[:, :6] = np.array([1e9, -1e9, 1e3, 1e6, -1e6, 1e6])
    env.step(np.zeros_like(env.action_space.sample()))
    assert not contradicts(env, "B", 0.001).any()
    assert np.hypot(*(memory.sensed - memory.truth)[:, :2].T).max() <= PITCH
    assert np.abs(memory.sensed[:, 3:5]).max() < 10.0


def test_what_is_lost_of_the_samples_does_not_make_it_stray() -> None:
    sensors = Presence(sample_rate=50.0, drop=0.5, mu_max=NOMINAL / 0.8)
    env = sg.SmartSurfaceVectorEnv(NUM_ENVS, "track", actions="quadrants", sensors=sensors)
    memory = env.batch.parcels
    for _, running in drive(env, "B"):
        error = np.hypot(*(memory.sensed - memory.truth)[running, :2].T)
        assert error.max(initial=0.0) <= PITCH


def test_two_runs_are_the_same() -> None:
    first, second = (env_of("load", threads=threads) for threads in (1, 2))
    for _ in zip(drive(first, "B", 30), drive(second, "B", 30), strict=True):
        np.testing.assert_array_equal(first.batch.parcels.sensed, second.batch.parcels.sensed)
