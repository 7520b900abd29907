"""Poses that agree with a pattern of switches, and what a parcel can do."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.compiler.jit import compiled
from surface_gym.physics.types import GYRATION
from surface_gym.sensors import AdaptiveCamera, Camera, Exact, Presence, presence
from surface_gym.state import GRAVITY_X, GRAVITY_Y, EnvState, env_state
from tests.sensors.runs import MINUS_45, all_say, contradicts

TOLERANCE = 0.001  # [m]


@compiled
def agree(state: Any, tolerance: float) -> None:
    presence.agree(state, tolerance)


@compiled
def keep_possible(state: Any, energy: float) -> None:
    presence.keep_possible(state, energy)


@compiled
def most_energy(state: Any) -> float:
    return presence.most_energy(state)


@compiled
def between_places(low: float, high: float, count: int) -> tuple[int, int]:
    return presence.between_places(low, high, count)


ACTIONS = {"sort": "halves", "track": "window"}


def placed(task: str, parcel: str) -> tuple[sg.SmartSurfaceVectorEnv, EnvState]:
    env = sg.SmartSurfaceVectorEnv(1, task, actions=ACTIONS[task], sensors=Presence())
    env.reset(seed=0, options={"parcel": parcel})
    batch = env.batch
    arrays = (batch.surfaces, batch.parcels, batch.bodies)
    return env, env_state.py_func(*arrays, 0, 0, batch.params.elements)


def lie(state: EnvState, truth: Any, *sensed: Any) -> None:
    """Put the parcel at a true pose, and the estimate at pose and velocity, else at 0."""
    state.truth[:3] = truth
    state.sensor_state[:] = 0.0
    both = np.concatenate(sensed)
    state.sensor_state[: len(both)] = both


def disagrees(env: sg.SmartSurfaceVectorEnv, state: EnvState, parcel: str) -> bool:
    state.sensed[:] = state.sensor_state[:6]
    return bool(contradicts(env, parcel, TOLERANCE)[0])


@pytest.mark.parametrize("parcel", ["S", "B"])
@pytest.mark.parametrize(("task", "far"), [("sort", False), ("track", False), ("track", True)])
def test_a_pose_is_found_that_agrees(task: str, parcel: str, far: bool) -> None:
    env, state = placed(task, parcel)
    rng = np.random.default_rng(0)
    for _ in range(100):
        turn = 3.0 if far else 1.0
        pose = rng.uniform([0.8, 0.9, -turn], [1.2, 1.1, turn])
        anywhere = rng.uniform([-50.0, -50.0, -3.0], [50.0, 50.0, 3.0])
        lie(state, pose, anywhere if far else pose + rng.normal(0.0, [0.03, 0.03, 0.1]))
        agree(state, TOLERANCE)
        assert not disagrees(env, state, parcel)
        assert np.isfinite(state.sensor_state).all()
        assert not far or math.hypot(*(state.sensor_state[:2] - state.truth[:2])) < 0.1


def test_a_pose_that_agrees_stays() -> None:
    _, state = placed("track", "B")
    lie(state, (1.013, 1.021, 0.3), (1.0135, 1.0206, 0.301), (1.0, 0.1, 0.2))
    before = state.sensor_state.copy()
    agree(state, TOLERANCE)
    np.testing.assert_array_equal(state.sensor_state, before)


def test_a_pose_and_the_velocity_move_the_way_the_switches_say() -> None:
    """A box that is a tenth of a pitch too far back: the next column's switches are pressed."""
    _, state = placed("track", "B")
    # It covers the columns at 0.85 ... 1.25 m, of which the estimate leaves out that at 1.25.
    lie(state, (1.03, 1.0, 0.0), (1.015, 1.0, 0.0))
    agree(state, TOLERANCE)
    assert state.sensor_state[0] == pytest.approx(1.025, abs=TOLERANCE)
    assert state.sensor_state[1:3] == pytest.approx([1.0, 0.0], abs=0.01)
    assert state.sensor_state[3] > 0.0


def test_where_no_switch_is_pressed_the_estimate_leaves_the_rotors() -> None:
    env, state = placed("sort", "S")
    lie(state, (1.0, 1.5, 0.0), (1.0, 1.16, 0.0))  # beside the line
    agree(state, TOLERANCE)
    assert not disagrees(env, state, "S")
    assert math.hypot(state.sensor_state[0] - 1.0, state.sensor_state[1] - 1.16) < 0.15


def test_what_is_beyond_the_surface_comes_back_over_it() -> None:
    _, state = placed("track", "S")
    state.sensor_state[:6] = (1e12, -1e12, 1e4, 0.0, 0.0, 0.0)
    keep_possible(state, 1.0)
    rows, columns = state.rotor.shape
    assert 0.0 < state.sensor_state[0] < 0.1 * columns + 0.2
    assert -0.2 < state.sensor_state[1] < 0.1 * rows
    assert 0.0 <= state.sensor_state[2] < 2.0 * math.pi


def test_what_is_possible_stays_and_what_is_too_fast_is_slowed_down_on_its_way() -> None:
    _, state = placed("track", "S")
    state.sensor_state[:6] = (1.0, 1.0, -4.0, 1.0, 0.3, 2.0)
    before = state.sensor_state.copy()
    keep_possible(state, 4.0)
    np.testing.assert_array_equal(state.sensor_state, before)
    state.sensor_state[:6] = (1.0, 1.0, 0.0, 30.0, 40.0, 10.0)
    keep_possible(state, 4.0)
    vx, vy, omega = state.sensor_state[3:6]
    assert vx**2 + vy**2 + state.body[GYRATION] * omega**2 == pytest.approx(4.0)
    assert vy / vx == pytest.approx(4.0 / 3.0)


def test_the_way_down_a_slope_in_any_direction_is_possible() -> None:
    _, state = placed("track", "S")
    rows, columns = state.rotor.shape

    def most(x: float, y: float) -> float:
        state.surface[[GRAVITY_X, GRAVITY_Y]] = x, y
        return most_energy(state) / presence.MARGIN

    level = most(0.0, 0.0)
    assert most(0.5, 0.0) - level == pytest.approx(2.0 * 0.5 * 0.1 * columns)
    assert most(0.0, -0.3) - level == pytest.approx(2.0 * 0.3 * 0.1 * rows)
    assert most(-0.5, 0.3) - level == pytest.approx(0.1 * columns + 0.06 * rows)


@pytest.mark.parametrize(
    ("low", "high", "places"),
    [
        (0.2, 3.7, (1, 3)), (2.0, 3.0, (2, 3)), (-0.5, 20.0, (0, 9)), (2.2, 2.8, (3, 2)),
        (-1e300, 1e300, (0, 9)), (-math.inf, math.inf, (0, 9)), (1e300, math.inf, (10, 9)),
        (-math.inf, -1e300, (0, -1)), (math.nan, math.nan, (10, -1)),
    ],
)  # fmt: skip
def test_places_between_any_floats(low: float, high: float, places: tuple[int, int]) -> None:
    assert between_places(low, high, 10) == places


def first_ends(task: str, sensors: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outcome, time and pose at each environment's first end, with all modules alike.

    So it does not matter which half a module belongs to by what the sensors say.
    """
    env = sg.SmartSurfaceVectorEnv(
        64, task, actions="halves", sensors=sensors, max_episode_steps=60
    )
    env.reset(seed=0)
    outcome = np.empty(env.num_envs, dtype=object)
    time, pose = np.zeros(env.num_envs), np.zeros((env.num_envs, 3))
    running = np.ones(env.num_envs, dtype=bool)
    while running.any():
        # To a side, so that rotors are left behind.
        _, _, terminated, truncated, info = env.step(all_say(env, MINUS_45))
        ended = running & (terminated | truncated)
        outcome[ended] = info["outcome"][ended]
        time[ended], pose[ended] = info["time"][ended], info["pose"][ended]
        running &= ~ended
    return outcome, time, pose


# Tasks for which other tests compile these sensors with halves.
@pytest.mark.parametrize(
    ("task", "kind"), [("stop", Camera), ("slow", AdaptiveCamera), ("sort", Presence)]
)
def test_every_sensor_leaves_the_truth_alone(task: str, kind: Any) -> None:
    for seen, true in zip(first_ends(task, kind()), first_ends(task, Exact()), strict=True):
        np.testing.assert_array_equal(seen, true)
