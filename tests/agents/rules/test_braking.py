"""Rules of Slow and Stop, and the model they predict by."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.rules.base import FULL, HALF, LEANS, ROLL, ColumnAxes
from surface_gym.agents.rules.braking import (
    SLOW_GENTLY,
    TRIM_TIME,
    Braked,
    BrakeModel,
    FrictionEstimate,
    SlowingRule,
    contact_span,
)
from surface_gym.agents.rules.layouts import FixedSlowing
from surface_gym.config import EnvConfig
from surface_gym.randomisation import Actuators
from surface_gym.sensors import AdaptiveCamera
from surface_gym.tasks import Slow, Stop
from surface_gym.tasks.line import BRAKING
from tests.agents.rules.runs import rule, run_rule

COLUMNS = 16


NOMINAL = FrictionEstimate.frictions(FrictionEstimate.unknown(2))


def square(side: float) -> sg.Parcel:
    return sg.Parcel(sg.Rectangle(side, side))


@pytest.mark.parametrize("level", [ROLL, HALF, FULL])
@pytest.mark.parametrize(
    "pair",
    [
        (square(0.25), square(0.45)),
        # Supports beside the rotors bear part of these.
        (square(0.30), square(0.35)),
        (sg.Parcel(sg.Rectangle(0.4, 0.25)), sg.Parcel(sg.Disc(0.19))),
        (replace(square(0.25), com_offset=(0.04, 0)), replace(square(0.45), com_offset=(-0.04, 0))),
    ],
    ids=["of the study", "partly on supports", "a rectangle and a disc", "loads off centre"],
)
def test_the_brake_model_agrees_with_the_simulator(level, pair) -> None:
    """Every second column brakes, from before the zone to where the first is about to leave it.

    The place of the load is given, as a sensor that learns would.
    """
    config = EnvConfig(task=Slow(parcels=pair), observe=("parcel",))
    load_ahead = np.array([parcel.com_offset[0] for parcel in pair])
    env = sg.SmartSurfaceVectorEnv(
        2, task=config.task, observe=("parcel",), autoreset_mode="SameStep"
    )
    starts = [{"parcel": parcel, "speed": 2.2, "ratio": 0.5} for parcel in pair]
    observations, _ = env.reset(seed=0, options=starts)
    levels = np.where(np.arange(COLUMNS) % 2, level, ROLL)[np.newaxis].repeat(2, axis=0)
    model, actions = BrakeModel(config, LEANS[ROLL]), ColumnAxes(config)(levels)
    target = LEANS[levels]
    for _ in range(18):
        see = replace(config.decode(observations), load_ahead=load_ahead)
        under = contact_span(config, see)
        after = model.predict(under, see.vx, NOMINAL, target, target[:, np.newaxis])
        observations, *_ = env.step(actions)
        now = config.decode(observations)
        # It does not know how the parcel leant just before: a physics step of braking at most.
        most = BRAKING * config.timing.dt
        np.testing.assert_allclose(after.speed[:, 0], now.vx, rtol=0, atol=most)
        place = contact_span(config, now).place
        np.testing.assert_allclose(after.place[:, 0], place, rtol=0, atol=0.04 * most)
        taken = after.braking + after.rolling
        np.testing.assert_allclose(taken[:, 0], see.vx - after.speed[:, 0], rtol=0, atol=1e-9)


def test_the_brake_model_follows_axes_that_take_time() -> None:
    """Half braking is commanded for a period, then rolling: both are predicted, axes turning."""
    actuators = Actuators(axis_speed=0.5 * math.pi / 0.1)
    config = EnvConfig(task="slow", actuators=actuators)
    env = sg.SmartSurfaceVectorEnv(2, task="slow", actuators=actuators, autoreset_mode="SameStep")
    starts = [{"parcel": parcel, "speed": 2.2, "ratio": 0.5} for parcel in "SB"]
    observations, _ = env.reset(seed=0, options=starts)
    levels = np.full((2, COLUMNS), ROLL)
    for _ in range(12):
        observations, *_ = env.step(ColumnAxes(config)(levels))
    see = config.decode(observations)
    model, target = BrakeModel(config, LEANS[ROLL]), LEANS[np.full((2, 1, COLUMNS), HALF)]
    after = model.predict(contact_span(config, see), see.vx, NOMINAL, LEANS[levels], target)
    observations, *_ = env.step(ColumnAxes(config)(np.full((2, COLUMNS), HALF)))
    for _ in range(2):  # 45 deg take 50 ms
        observations, *_ = env.step(ColumnAxes(config)(levels))
    now = config.decode(observations)
    assert (see.vx - now.vx > 0.1).all()
    np.testing.assert_allclose(after.speed[:, 0], now.vx, rtol=0, atol=0.01)
    lean = model.lean_after(LEANS[levels], target[:, 0])
    np.testing.assert_allclose(lean, math.pi / 5.0, rtol=1e-9)


def test_friction_is_estimated_from_the_speed_it_takes() -> None:
    estimate = FrictionEstimate.for_sensors(EnvConfig(task="stop"))
    known = estimate.unknown(1)
    for braking, rolling in [(0.0, 0.004)] * 5 + [(0.14, 0.002)] * 30:
        parts = np.array([braking]), np.array([rolling])
        known = estimate.update(known, 0.85 * parts[0] + 1.3 * parts[1], *parts)
    estimated = estimate.frictions(known)
    assert estimated.braking[0] == pytest.approx(0.85, abs=0.02)
    assert estimated.rolling[0] == pytest.approx(1.3, abs=0.02)


@pytest.mark.parametrize(
    ("task", "others"),
    [
        (Stop(parcels=(square(0.5),)), {}),
        (Slow(parcels=(square(0.3), square(0.35))), {}),
        (Stop(), {"actuators": Actuators(axis_speed=0.5 * math.pi / 0.1)}),
        (Slow(), {"actuators": Actuators(axis_speed=0.5 * math.pi / 0.05)}),
        (Slow(), {"line": replace(Slow().line, mu_min=0.013, mu_support=0.0065)}),
    ],
    ids=["large", "on supports", "slow axes, stop", "slow axes, slow", "rolling hard"],
)
def test_braking_holds_where_it_is_not_as_in_the_study(task, others) -> None:
    config = EnvConfig(task=task, **others)
    controller = rule(task.name, "braking rule").make(config)
    assert run_episodes(controller, config, [{}] * 40, seed=50).success.mean() >= 0.9


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
    config = EnvConfig(task="slow")
    observation, _ = sg.SmartSurfaceEnv(task="slow").reset(seed=0)
    at_rest = replace(config.decode(observation[np.newaxis]), vx=np.zeros(1))
    slowing = FixedSlowing(config)
    losses = np.ones((len(slowing._axes), 1000))
    assert np.isinf(slowing._regret(at_rest, losses)).all()


def test_slowing_brakes_late_yet_rolls_on_for_a_second() -> None:
    """It brakes in the last period before gentle braking would leave less than 1.2 s to trim."""
    config = EnvConfig(task="slow")
    starts = [{"parcel": p, "speed": 1.2, "ratio": ratio} for p in "SB" for ratio in (0.3, 0.5)]
    runs = run_episodes(rule("slow", "braking rule").make(config), config, starts, seed=0)
    for start, x in zip(starts, runs.pose[:, :, 0].T, strict=True):
        speed = np.diff(x) / config.control_period
        rolled = int((speed[:-1] - speed[1:] > 0.01).argmax()) + 1  # periods
        asked = start["speed"] * start["ratio"]
        # At 45 deg braking takes mu_max and rolling mu_min.
        held = SLOW_GENTLY * BRAKING * (1.0 + 0.01 / 0.5) * math.sqrt(0.5)
        way = (speed[rolled - 1] ** 2 - asked**2) / (2.0 * held)
        left = (np.nanmax(x) - x[rolled] - way) / asked
        a_period = config.control_period * start["speed"] / asked
        assert TRIM_TIME < left < TRIM_TIME + a_period


def test_friction_and_load_that_the_sensors_learned_are_used() -> None:
    config = EnvConfig(task="stop", observe=("parcel", "load"), preset="lab")
    observation = np.zeros((1, len(config.features)), dtype=np.float32)
    place = {feature.name: k for k, feature in enumerate(config.features)}
    observation[0, place["cosine of theta"]] = 1.0
    observation[0, place["friction learned"]] = 1.5
    observation[0, place["load learned, x"]] = -2.0
    see = config.decode(observation)
    sensors = config.sensors
    assert isinstance(sensors, AdaptiveCamera)
    np.testing.assert_allclose(see.friction, 1.0 + 1.5 * sensors.friction_spread)
    np.testing.assert_allclose(see.load_ahead, -2.0 * sensors.load_spread)
    np.testing.assert_allclose(contact_span(config, see).load, see.load_ahead)


def test_where_a_load_lies_along_the_line_is_the_same_in_sorts_mirror() -> None:
    config = EnvConfig(task="sort", observe=("parcel", "load"), preset="lab")
    place = {feature.name: k for k, feature in enumerate(config.features)}
    seen = np.zeros((2, len(config.features)), dtype=np.float32)
    seen[:, place["side"]] = (1.0, -1.0)
    seen[:, place["cosine of theta"]], seen[:, place["sine of theta"]] = 0.8, 0.6
    seen[:, place["load learned, y"]] = 2.0
    see = config.decode(seen)
    sensors = config.sensors
    assert isinstance(sensors, AdaptiveCamera)
    np.testing.assert_allclose(see.theta, math.atan2(0.6, 0.8) * np.array([1.0, -1.0]), rtol=1e-6)
    np.testing.assert_allclose(see.load_ahead, -0.6 * 2.0 * sensors.load_spread, rtol=1e-6)


def test_beyond_the_end_of_the_zone_the_asked_speed_itself_is_best() -> None:
    """Nothing is left to roll: faster is as bad as it is too fast, slower worse."""
    config = EnvConfig(task="slow")
    env = sg.SmartSurfaceVectorEnv(1, task="slow")
    start = {"parcel": "S", "speed": 2.0, "ratio": 0.5}
    observations, _ = env.reset(seed=0, options=start)
    slowing = SlowingRule(config)
    see = config.decode(observations)
    frictions = FrictionEstimate.frictions(FrictionEstimate.unknown(1))
    none = np.zeros((1, 3))
    after = Braked(np.full((1, 3), 9.0), np.array([[0.9, 1.0, 1.1]]), none, none)
    regret = slowing._regret(see, contact_span(config, see), frictions, after)
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
    assert np.median(np.abs(by_rule.metrics["stop_error"])) < 5e-4
    assert fixed.success.mean() < 0.5


@pytest.mark.parametrize("parcel", ["S", "B"])
def test_a_fixed_layout_is_the_best_of_its_kind(parcel) -> None:
    """No other number of columns leaves nearer to the asked ratio, in the environment itself."""
    speed, ratio = 2.1, 0.55
    config = EnvConfig(task="slow")
    start = {"parcel": parcel, "speed": speed, "ratio": ratio}
    chosen = run_rule("slow", "fixed layout", [start]).metrics["ratio_error"][0]
    first = np.arange(COLUMNS) < np.arange(COLUMNS + 1)[:, np.newaxis]
    actions = ColumnAxes(config)(np.concatenate([FULL * first, HALF * first]))
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
