"""Rules of Slow and Stop, and the model they predict by."""

import math
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.rules import braking, decoding
from surface_gym.agents.rules.base import FULL, HALF, LEANS, ROLL, ColumnAxes
from surface_gym.agents.rules.decoding import look_at_line
from surface_gym.agents.rules.layouts import FixedSlowing
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.randomisation import Actuators
from surface_gym.sensors import AdaptiveCamera
from surface_gym.tasks import Slow, Stop
from surface_gym.tasks.base import BRAKING
from tests.agents.rules.runs import Scripted, begun, ends, rule, run, run_rule

COLUMNS = 16
# Compiled as Python calls them.
see_line = compiled(decoding.see_line.py_func)
find_span, predict = compiled(braking.find_span.py_func), compiled(braking.predict.py_func)
find_frictions, update = compiled(braking.find_frictions.py_func), compiled(braking.update.py_func)
regret_speed = compiled(braking.regret_speed.py_func)
NOMINAL = braking.Frictions(1.0, 1.0, braking.UNSURE)


class Predictor:
    """Predictions for the parcels of several environments.

    Args:
        config: of the environments.
        levels: (columns,) at which the zone's columns brake.
        lean: [rad] off 90 deg of all axes now; None: that of their levels.
    """

    def __init__(self, config: EnvConfig, levels: np.ndarray, lean: float | None = None) -> None:
        self.sight = look_at_line(config)
        self.model = braking.make_model(config, LEANS[ROLL])
        self.scratch = braking.make_scratch(self.model)
        self.scratch.target[:] = LEANS[levels]
        self.lean = np.full(COLUMNS, lean) if lean is not None else LEANS[levels]

    def span(self, seen: Any) -> braking.Footprint:
        found: braking.Footprint = find_span(seen, self.sight, self.model, self.scratch)
        return found

    def __call__(self, observation: np.ndarray, load: float = 0.0) -> braking.Result:
        seen = see_line(observation, self.sight)._replace(load_ahead=load)
        span, pitch = self.span(seen), self.sight.pitch_x
        found: braking.Result = predict(
            span, self.model, pitch, seen.vx, NOMINAL, self.lean, self.scratch
        )
        return found


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
    load_ahead = np.array([parcel.com_offset[0] for parcel in pair])
    starts = [{"parcel": parcel, "speed": 2.2, "ratio": 0.5} for parcel in pair]
    env, observations = begun(Slow(parcels=pair), starts, observe=("parcel",))
    config = env.config
    levels = np.where(np.arange(COLUMNS) % 2, level, ROLL)
    model, actions = Predictor(config, levels), ColumnAxes(config)(np.stack([levels, levels]))
    # It does not know how the parcel leant just before: a physics step of braking at most.
    most = BRAKING * config.timing.dt
    for _ in range(18):
        before = config.decode(observations).vx
        after = [model(each, load) for each, load in zip(observations, load_ahead, strict=True)]
        observations, *_ = env.step(actions)
        for k, each in enumerate(after):
            now = see_line(observations[k], model.sight)
            assert each.speed == pytest.approx(now.vx, abs=most)
            assert each.place == pytest.approx(model.span(now).place, abs=0.04 * most)
            assert each.braking + each.rolling == pytest.approx(before[k] - each.speed, abs=1e-9)


def test_the_brake_model_follows_axes_that_take_time() -> None:
    starts = [{"parcel": parcel, "speed": 2.2, "ratio": 0.5} for parcel in "SB"]
    env, _ = begun("slow", starts, actuators=Actuators(axis_speed=0.5 * math.pi / 0.1))
    config = env.config
    rolling, half = (ColumnAxes(config)(np.full((2, COLUMNS), level)) for level in (ROLL, HALF))
    for _ in range(12):
        observations, *_ = env.step(rolling)
    see = config.decode(observations)
    model = Predictor(config, np.full(COLUMNS, HALF), LEANS[ROLL])
    after = [model(observation) for observation in observations]
    braking_rule = rule("slow", "braking rule").make(config)
    for actions in (half, rolling, rolling):  # 45 deg take 50 ms
        observations, *_ = env.step(actions)
    now = config.decode(observations)
    assert (see.vx - now.vx > 0.1).all()
    np.testing.assert_allclose([each.speed for each in after], now.vx, rtol=0, atol=0.01)
    # What is remembered of axes: on their way to 45 deg they come as far as pi / 5 in a period.
    _, memory = braking_rule.predict(env.reset(seed=0, options=starts)[0])
    assert set(memory.lean.ravel().round(9)) <= {0.0, round(math.pi / 5.0, 9)}


def test_friction_is_estimated_from_the_speed_it_takes() -> None:
    memory = rule("stop", "braking rule").make(EnvConfig(task="stop")).make_memory(1)
    for drag, rolling in [(0.0, 0.004)] * 5 + [(0.14, 0.002)] * 30:
        lost = 0.85 * drag + 1.3 * rolling
        update(memory.estimate[0], lost, drag, rolling, braking.SEEN_EXACTLY)
    estimated = find_frictions(memory.estimate[0])
    assert estimated.braking == pytest.approx(0.85, abs=0.02)
    assert estimated.rolling == pytest.approx(1.3, abs=0.02)


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


@pytest.mark.parametrize(
    ("task", "goal", "speeds", "goals"),
    [
        ("slow", "ratio", (1.0, 1.7, 2.6), (0.2, 0.4, 0.6, 0.75)),
        ("stop", "position", (0.8, 1.5, 2.2), (1.37, 1.54, 1.71)),
    ],
)
def test_every_ratio_and_place_is_hit(task, goal, speeds, goals) -> None:
    every = product("SB", speeds, goals)
    starts = [{"parcel": parcel, "speed": speed, goal: asked} for parcel, speed, asked in every]
    by_rule, fixed = (run_rule(task, name, starts) for name in ("braking rule", "fixed layout"))
    assert by_rule.success.all()
    assert fixed.success.mean() < 0.5
    if task == "slow":
        np.testing.assert_allclose(ends(by_rule)[:, 1:], [[1.0, 0.0]] * len(starts), atol=1e-4)
    else:
        assert np.median(np.abs(by_rule.metrics["stop_error"])) < 5e-4


def test_a_parcel_that_is_seen_at_rest_asks_for_no_layout_and_warns_of_nothing() -> None:
    env, observations = begun("slow", [{}])
    at_rest = replace(env.config.decode(observations), vx=np.zeros(1))
    slowing = FixedSlowing(env.config)
    assert np.isinf(slowing._regret(at_rest, np.ones((len(slowing._axes), 1000)))).all()


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
        held = braking.SLOW_GENTLY * BRAKING * (1.0 + 0.01 / 0.5) * math.sqrt(0.5)
        way = (speed[rolled - 1] ** 2 - asked**2) / (2.0 * held)
        left = (np.nanmax(x) - x[rolled] - way) / asked
        a_period = config.control_period * start["speed"] / asked
        assert braking.TRIM_TIME < left < braking.TRIM_TIME + a_period


def see_learned(task: str, **features: list[float]) -> tuple[AdaptiveCamera, EnvConfig, list[Any]]:
    """What is decoded of features that a lab's sensors learned, the others 0."""
    config = EnvConfig(task=task, observe=("parcel", "load"), preset="lab")
    seen = np.zeros((len(next(iter(features.values()))), len(config.features)), dtype=np.float32)
    for name, values in features.items():
        seen[:, config.columns[name].place] = values
    assert isinstance(config.sensors, AdaptiveCamera)
    return config.sensors, config, [see_line(row, look_at_line(config)) for row in seen]


def test_friction_and_load_that_the_sensors_learned_are_used() -> None:
    learned = {"cosine of theta": [1.0], "friction learned": [1.5], "load learned, x": [-2.0]}
    sensors, config, (see,) = see_learned("stop", **learned)
    assert see.friction == pytest.approx(1.0 + 1.5 * sensors.friction_spread)
    assert see.load_ahead == pytest.approx(-2.0 * sensors.load_spread)
    assert Predictor(config, np.full(COLUMNS, ROLL)).span(see).load == see.load_ahead
    # A box that rolled for 0.2 s is to brake harder, the less friction there is.
    lab: dict[str, Any] = {"observe": ("parcel", "load"), "preset": "lab"}
    env, seen = begun("stop", [{"parcel": "S", "speed": 1.6, "position": 1.5}] * 3, **lab)
    roll = ColumnAxes(config)(np.full((3, COLUMNS), ROLL))
    for _ in range(5):
        seen, *_ = env.step(roll)
    seen[:] = seen[0]
    seen[:, config.columns["friction learned"].place] = -2.0, 0.0, 2.0
    actions, _ = rule("stop", "braking rule").make(env.config).predict(seen)
    assert (np.diff((actions != roll).sum(axis=1)) < 0).all()
    # Where a load lies along the line is the same in Sort's mirror.
    turned = {"cosine of theta": [0.8, 0.8], "sine of theta": [0.6, 0.6]}
    learned = {"side": [1.0, -1.0], **turned, "load learned, y": [2.0, 2.0]}
    sensors, _, both = see_learned("sort", **learned)
    theta, ahead = math.atan2(0.6, 0.8), -0.6 * 2.0 * sensors.load_spread
    assert [each.theta for each in both] == pytest.approx([theta, -theta])
    assert [each.load_ahead for each in both] == pytest.approx([ahead, ahead])


def test_beyond_the_end_of_the_zone_the_asked_speed_itself_is_best() -> None:
    env, observations = begun("slow", [{"parcel": "S", "speed": 2.0, "ratio": 0.5}])
    model = Predictor(env.config, np.full(COLUMNS, ROLL))
    seen = see_line(observations[0], model.sight)
    span = model.span(seen)
    slow, asked, fast = (
        regret_speed(seen, span, NOMINAL, braking.Result(9.0, speed, 0.0, 0.0), False)
        for speed in (0.9, 1.0, 1.1)
    )
    assert slow > fast
    assert [asked, fast] == pytest.approx([0.0, 0.1], abs=1e-5)


@pytest.mark.parametrize("parcel", ["S", "B"])
def test_a_fixed_layout_is_the_best_of_its_kind(parcel) -> None:
    """No other number of columns leaves nearer to the asked ratio, in the environment itself."""
    start, config = {"parcel": parcel, "speed": 2.1, "ratio": 0.55}, EnvConfig(task="slow")
    chosen = run_rule("slow", "fixed layout", [start]).metrics["ratio_error"][0]
    first = np.arange(COLUMNS) < np.arange(COLUMNS + 1)[:, np.newaxis]
    actions = ColumnAxes(config)(np.concatenate([FULL * first, HALF * first]))
    others = run(Scripted(actions[:, np.newaxis]), config, [start] * len(actions))
    left = np.isin(others.outcome, ("stalled", "out of time"), invert=True)
    assert abs(chosen) == pytest.approx(np.abs(others.metrics["ratio_error"][left]).min(), abs=0.01)
