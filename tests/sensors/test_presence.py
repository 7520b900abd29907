"""Presence switches: what the observer makes of the covered pattern."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.sensors import Entry, Presence
from tests.environments import same_choice
from tests.sensors.runs import BRAKE, PLUS_45, ROLL, all_say, contradicts, errors, rms

DISC = sg.Parcel(sg.Disc(0.15))
HEXAGON = sg.Parcel(
    sg.Polygon(0.16 * np.stack([f(np.arange(6) * np.pi / 3) for f in (np.cos, np.sin)], -1))
)


@pytest.mark.parametrize("speed", [0.8, 1.5, 2.5])
@pytest.mark.parametrize("choice", [PLUS_45, BRAKE])
@pytest.mark.parametrize("parcel", ["S", "B", DISC, HEXAGON], ids=["S", "B", "disc", "hexagon"])
def test_errors_are_small(parcel: Any, choice: int, speed: float) -> None:
    found = rms(errors(Presence(), choice, speed=speed, parcel=parcel))
    boxes = parcel in ("S", "B")
    assert (found[:2] < (0.006 if boxes else 0.01)).all()
    assert not boxes or found[2] < math.radians(2.0)
    assert (found[3:5] < (0.08 if boxes else 0.1)).all()


def test_an_unsure_entry_is_made_up_for() -> None:
    vague = Presence(entry=Entry(position=0.02, angle=0.05, speed=0.2, turning=0.3))
    env = sg.SmartSurfaceVectorEnv(32, actions="halves", sensors=vague)
    env.reset(seed=0, options={"speed": 1.0, "parcel": "B", "side": 1})
    memory = env.batch.parcels
    start = rms(memory.sensed - memory.truth)
    for _ in range(15):
        env.step(all_say(env, ROLL))
    end = rms(memory.sensed - memory.truth)
    assert end[0] < 0.4 * start[0]
    assert end[3] < 0.4 * start[3]


def test_nothing_is_seen_between_switches() -> None:
    def sensed(shift: float) -> np.ndarray:
        env = sg.SmartSurfaceEnv(actions="halves", sensors=Presence())
        env.reset(seed=0, options={"speed": 0.3, "parcel": "S", "side": 1})
        env.batch.parcels.state[0, 1] += shift  # 20 mm from the next module's centre
        for _ in range(2):
            env.step(same_choice(env, ROLL))
        return env.batch.parcels.sensed[0].copy()

    np.testing.assert_array_equal(sensed(0.0), sensed(0.004))


def test_wrong_friction_is_borne() -> None:
    found = rms(errors(Presence(mu_max=0.4), BRAKE, speed=1.5, parcel="B"))
    assert found[0] < 0.02


NUM_ENVS, PERIODS, HELD = 48, 75, 5
PITCH = 0.1  # [m]
NOMINAL = 0.5  # [-] mu_max of every line

WORLDS = {
    "load": (Presence(), sg.Randomisation(com_offset=0.5)),
    "friction 0.8": (Presence(mu_max=NOMINAL / 0.8), sg.Randomisation()),
    "friction 1.2": (Presence(mu_max=NOMINAL / 1.2), sg.Randomisation()),
    "lost samples": (
        Presence(sample_rate=50.0, drop=0.5, mu_max=NOMINAL / 0.8),
        sg.Randomisation(),
    ),
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


def env_of(world: str) -> sg.SmartSurfaceVectorEnv:
    sensors, varied = WORLDS[world]
    settings = {"actions": "window", "sensors": sensors, "randomisation": varied}
    return sg.SmartSurfaceVectorEnv(NUM_ENVS, "track", **settings)


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
        assert world == "lost samples" or row.max() <= 2
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
