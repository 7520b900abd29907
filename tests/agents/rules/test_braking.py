"""Rules of Slow and Stop, and what they predict by."""

from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from agents.episodes import run_episodes
from agents.rules.brake_model import BrakeModel
from agents.rules.columns import FULL, HALF, ROLL, SHARES, ColumnAxes
from agents.rules.fixed_braking import FixedSlowing
from agents.sight import line_sight
from surface_gym.settings import Settings
from surface_gym.tasks.line import BRAKING
from tests.agents.rules.runs import rule, run_rule

COLUMNS = 16


@pytest.mark.parametrize("level", [ROLL, HALF, FULL])
def test_the_brake_model_agrees_with_the_simulator(level: int) -> None:
    """Every second column brakes, from before the zone to where the S-box is about to leave it."""
    settings = Settings(task="slow")
    env = sg.SmartSurfaceVectorEnv(2, task="slow", autoreset_mode="SameStep")
    starts = [{"parcel": parcel, "speed": 2.2, "ratio": 0.5} for parcel in "SB"]
    observations, _ = env.reset(seed=0, options=starts)
    levels = np.where(np.arange(COLUMNS) % 2, level, ROLL)[np.newaxis].repeat(2, axis=0)
    model, actions = BrakeModel(settings), ColumnAxes(settings)(levels)
    for _ in range(18):
        see = line_sight(settings, observations)
        place, speed = model.after_a_period(
            see.into_zone, see.vx, see.half_length, SHARES[levels][:, np.newaxis]
        )
        observations, *_ = env.step(actions)
        now = line_sight(settings, observations)
        # It does not know how the parcel leant just before: a physics step of braking at most.
        most = BRAKING * settings.timing.dt
        np.testing.assert_allclose(speed[:, 0], now.vx, rtol=0, atol=most)
        np.testing.assert_allclose(place[:, 0], now.into_zone, rtol=0, atol=0.04 * most)


def test_slowing_hits_every_ratio() -> None:
    starts = [
        {"parcel": parcel, "speed": speed, "ratio": ratio}
        for parcel in "SB"
        for speed in (1.0, 1.7, 2.6)
        for ratio in (0.2, 0.4, 0.6, 0.75)
    ]
    by_rule, fixed = (run_rule("slow", name, starts) for name in ("braking rule", "fixed layout"))
    assert by_rule.success.all()
    assert fixed.success.mean() < 0.5
    np.testing.assert_allclose(by_rule.pose[:, 1:], [[1.0, 0.0]] * len(starts), atol=1e-4)


def test_a_parcel_that_is_seen_at_rest_asks_for_no_layout_and_warns_of_nothing() -> None:
    settings = Settings(task="slow")
    observation, _ = sg.SmartSurfaceEnv(task="slow").reset(seed=0)
    at_rest = replace(line_sight(settings, observation[np.newaxis]), vx=np.zeros(1))
    slowing = FixedSlowing(settings)
    losses = np.ones((len(slowing._axes), 1000))
    assert np.isinf(slowing._regret(at_rest, losses)).all()


def test_slowing_brakes_late_yet_rolls_on_for_a_second() -> None:
    """It rolls until half braking would leave 1.2 s at the asked speed, or a period longer."""
    settings = Settings(task="slow")
    starts = [{"parcel": p, "speed": 1.2, "ratio": ratio} for p in "SB" for ratio in (0.3, 0.5)]
    runs = run_episodes(rule("slow", "braking rule").make(settings), settings, starts, seed=0)
    for start, x in zip(starts, runs.pose[:, :, 0].T, strict=True):
        speed = np.diff(x) / settings.control_period
        rolled = int((speed[:-1] - speed[1:] > 0.02).argmax()) + 1  # periods
        asked = start["speed"] * start["ratio"]
        held = BRAKING * (1.0 + 0.01 / 0.5) / 2.0  # rolling takes mu_min where braking takes mu_max
        way = (speed[rolled - 1] ** 2 - asked**2) / (2.0 * held)
        assert 1.05 < (np.nanmax(x) - x[rolled] - way) / asked < 1.2


def test_beyond_the_end_of_the_zone_the_asked_speed_itself_is_best() -> None:
    """Nothing is left to roll: faster is as bad as it is too fast, slower worse."""
    settings = Settings(task="slow")
    env = sg.SmartSurfaceVectorEnv(1, task="slow")
    start = {"parcel": "S", "speed": 2.0, "ratio": 0.5}
    observations, _ = env.reset(seed=0, options=start)
    slowing = rule("slow", "braking rule").make(settings)
    speed = np.array([[0.9, 1.0, 1.1]])
    regret = slowing._regret(line_sight(settings, observations), np.full((1, 3), 9.0), speed)
    assert regret[0, 0] > regret[0, 2]
    np.testing.assert_allclose(regret[0, 1:], [0.0, 0.1], atol=1e-5)


def test_stopping_hits_every_place() -> None:
    starts = [
        {"parcel": parcel, "speed": speed, "position": position}
        for parcel in "SB"
        for speed in (0.8, 1.5, 2.2)
        for position in (1.37, 1.54, 1.71)
    ]
    by_rule, fixed = (run_rule("stop", name, starts) for name in ("braking rule", "fixed layout"))
    assert by_rule.success.all()
    assert np.median(np.abs(by_rule.figures["stop_error"])) < 5e-4
    assert fixed.success.mean() < 0.5


@pytest.mark.parametrize("parcel", ["S", "B"])
def test_a_fixed_layout_is_the_best_of_its_kind(parcel: str) -> None:
    """No other number of columns leaves nearer to the asked ratio, in the environment itself."""
    speed, ratio = 2.1, 0.55
    settings = Settings(task="slow")
    start = {"parcel": parcel, "speed": speed, "ratio": ratio}
    chosen = run_rule("slow", "fixed layout", [start]).figures["ratio_error"][0]
    first = np.arange(COLUMNS) < np.arange(COLUMNS + 1)[:, np.newaxis]
    actions = ColumnAxes(settings)(np.concatenate([FULL * first, HALF * first]))
    env = sg.SmartSurfaceVectorEnv(len(actions), task="slow", autoreset_mode="Disabled")
    env.reset(seed=0, options=start)
    terminated = np.zeros(len(actions), dtype=bool)
    errors = np.full(len(actions), np.inf)
    for _ in range(120):
        _, _, ended, _, info = env.step(actions)
        left = ended & (info["outcome"] != "stalled")
        errors = np.where(left, info["ratio_error"], errors)
        terminated |= ended
        if ended.any():
            env.reset(seed=0, options={**start, "reset_mask": ended})
    assert abs(chosen) == pytest.approx(np.abs(errors).min(), abs=0.01)
