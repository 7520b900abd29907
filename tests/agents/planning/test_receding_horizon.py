"""The planner of slopes: its model is true, it is the same every time, it gains on its rule."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.planning.planner import RecedingHorizon
from surface_gym.agents.rules.departures import HoldAndRelease, PassAndPark, TimeSlots
from surface_gym.agents.scheduling.scheduler import begin_streams
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.take_away import bulk
from surface_gym.randomisation import Actuators

SEED, SMALL = 4, {"candidates": 6, "horizon": 30}
LAB = PRESETS["lab"]
BULK: dict[str, Any] = {
    "actions": "parcels", "stream": bulk(14_000.0), "exits": "mouth",
    "alignment": math.radians(10.0), "duration": 20.0,
}  # fmt: skip
MOUTH = EnvConfig("singulate", **BULK)
VARIED = MOUTH.replace(randomisation=LAB.randomisation, actuators=Actuators(stuck_share=0.02))
LATE = VARIED.replace(actuators=LAB.actuators)


def play(
    controller: Any, config: EnvConfig, periods: int, surfaces: int = 2
) -> tuple[StreamBatch, list[Any]]:
    """Play for so many control periods; return the surfaces and all that was done."""
    batch = begin_streams(config, surfaces, SEED)
    if isinstance(controller, RecedingHorizon):
        controller.watch(batch)
    done, state, fresh = [], None, np.ones(surfaces, dtype=np.bool_)
    for _ in range(periods):
        actions, state = controller.predict(batch.observation, state, fresh)
        batch.step(config.action_kind.commands(actions, surfaces))
        fresh[:] = False
        done.append(actions)
    return batch, done


@pytest.mark.parametrize("config", [VARIED, LATE], ids=["varied", "lab"])
def test_what_is_planned_happens(config: EnvConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    rated = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 2.0, 2.0, 0.0])  # two surfaces, four times
    monkeypatch.setattr(RecedingHorizon, "_rate", lambda *_: rated)
    planner = RecedingHorizon(TimeSlots(config), config, candidates=4, horizon=25, followed=25)
    batch, _ = play(planner, config, 75)
    model, rows = planner._model, np.array([6, 5])
    np.testing.assert_array_equal(
        batch.parcels.truth.reshape(2, batch.rows, -1),
        model.parcels.truth.reshape(8, batch.rows, -1)[rows],
    )
    np.testing.assert_array_equal(batch.streams.tally, model.streams.tally[rows])
    np.testing.assert_array_equal(batch.observation, model.observation[rows])


def test_the_rule_is_followed_where_nothing_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RecedingHorizon, "_rate", lambda _, before: np.zeros(len(before)))
    planned, done = play(RecedingHorizon(TimeSlots(MOUTH), MOUTH, **SMALL), MOUTH, 60)
    ruled, said = play(TimeSlots(MOUTH), MOUTH, 60)
    np.testing.assert_array_equal(done, said)
    np.testing.assert_array_equal(planned.observation, ruled.observation)


def test_plans_are_the_same_again_and_of_each_surface_by_itself() -> None:
    planner = RecedingHorizon(TimeSlots(MOUTH), MOUTH, **SMALL)
    batch, done = play(planner, MOUTH, 100)
    _, again = play(RecedingHorizon(TimeSlots(MOUTH), MOUTH, **SMALL), MOUTH, 100)
    np.testing.assert_array_equal(done, again)
    alone, _ = play(planner, MOUTH, 100, surfaces=1)
    np.testing.assert_array_equal(alone.observation[0], batch.observation[0])
    _, said = play(TimeSlots(MOUTH), MOUTH, 100)
    assert not np.array_equal(done, said)
    _, other = play(RecedingHorizon(TimeSlots(MOUTH), MOUTH, **SMALL, seed=1), MOUTH, 100)
    assert not np.array_equal(done, other)


def test_what_is_followed_is_rated_no_worse_than_the_rule_and_sometimes_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rated, rate = [], RecedingHorizon._rate

    def keep(planner: RecedingHorizon, before: np.ndarray) -> np.ndarray:
        rated.append(rate(planner, before).reshape(-1, 2))
        return rated[-1].ravel()

    monkeypatch.setattr(RecedingHorizon, "_rate", keep)
    play(RecedingHorizon(TimeSlots(VARIED), VARIED, **SMALL), VARIED, 150)
    gained = np.array(rated).max(axis=1) - np.array(rated)[:, 0]
    assert gained.shape == (15, 2)
    assert (gained >= 0.0).all()
    assert (gained > 0.0).any(axis=0).all()  # on each surface


def test_a_surface_that_begins_anew_drops_what_was_planned() -> None:
    planner = RecedingHorizon(TimeSlots(MOUTH), MOUTH, **SMALL)
    batch = begin_streams(MOUTH, 1, SEED)
    planner.watch(batch)
    fresh, state = np.ones(1, dtype=np.bool_), None
    for _ in range(55):
        actions, state = planner.predict(batch.observation, state, fresh)
        batch.step(MOUTH.action_kind.commands(actions, 1))
        fresh[:] = False
    state.variations.left[:] = 9
    batch.reset(np.arange(1))
    actions, _ = planner.predict(batch.observation, state, np.ones(1, dtype=np.bool_))
    ruled, _ = TimeSlots(MOUTH).predict(batch.observation)
    np.testing.assert_array_equal(actions, ruled)


@pytest.mark.parametrize(
    ("task", "rule"), [("singulate", HoldAndRelease), ("sequence", PassAndPark)]
)
def test_it_varies_any_rule_of_parcels(task: str, rule: Any) -> None:
    config = EnvConfig(task, actions="parcels", duration=4.0)
    batch, _ = play(RecedingHorizon(rule(config), config, **SMALL), config, 25, surfaces=1)
    assert np.isfinite(batch.observation).all()


def test_what_it_cannot_know_is_refused() -> None:
    seen = MOUTH.replace(sensors=sg.sensors.Camera())
    with pytest.raises(ValueError, match="sensors must be Exact"):
        RecedingHorizon(TimeSlots(seen), seen)
    with pytest.raises(ValueError, match="followed must be a whole number of at most 5, got 9"):
        RecedingHorizon(TimeSlots(MOUTH), MOUTH, horizon=5, followed=9)
    planner, batch = RecedingHorizon(TimeSlots(MOUTH), MOUTH), begin_streams(MOUTH, 2, SEED)
    with pytest.raises(ValueError, match="watch a batch of the 2 surfaces first"):
        planner.predict(batch.observation)
