"""Rules on slopes: who leaves rightly, held against what each task asks, and off their tuning."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.rules.departures import HoldAndRelease, PassAndPark, TimeSlots
from surface_gym.agents.rules.patterns import Patterns, PatternsInOrder
from surface_gym.agents.rules.slopes import SlopeRule
from surface_gym.config import EnvConfig
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.exits import Exit, Exits, side_by_side
from surface_gym.flow.slope_tasks import lines, shuffled
from surface_gym.flow.state import JAM
from surface_gym.flow.take_away import Stops, TakeAwayStatistics, bulk, slope_line
from surface_gym.state import RUNNING
from tests.environments import begun

ALIGNMENT, TILT = math.radians(10.0), math.radians(8.0)
MOUTH: dict[str, Any] = {"exits": "mouth", "alignment": ALIGNMENT}


def played(make: Any, task: str, **arguments: Any) -> tuple[TakeAwayStatistics, StreamBatch]:
    given = {"duration": 120.0, **arguments}
    config = EnvConfig(task, actions=make.acts_by, **given)
    batch, rule, state = begun(config), make(config), None
    while batch.outcome[0] == RUNNING:
        action, state = rule.predict(batch.observation, state, np.array([state is None]))
        batch.step(config.action_kind.commands(action, 1))
    return config.stream_task.compute_statistics(batch.streams, 0, False, 1), batch


class TestTimeSlots:
    @pytest.mark.parametrize(
        ("task", "arguments", "least"),
        [
            ("singulate", {"stream": bulk(14_000.0)}, 8000.0),
            ("singulate", {"stream": bulk(14_000.0), **MOUTH}, 5500.0),
            ("singulate", {"stream": bulk(14_000.0), **MOUTH, "exits": "mouths"}, 7500.0),
            ("singulate", {"stream": bulk(14_000.0), "demand": Stops()}, 4500.0),
            ("merge", {"stream": lines(9000.0)}, 6000.0),
            ("merge", {"stream": lines(9000.0), "inlets": side_by_side(2)}, 6000.0),
        ],
    )
    def test_parcels_leave_one_by_one(self, task, arguments, least) -> None:
        found, batch = played(TimeSlots, task, **arguments)
        assert batch.outcome[0] != JAM
        assert found.parcels_per_hour > least
        assert found.correct_gaps == 1.0
        assert found.aligned > 0.99
        assert found.beside < 0.01

    @pytest.mark.parametrize(
        "arguments",
        [
            {"line": slope_line(4.0, 1.0)},
            {"tilt": math.radians(5.0)},
            {"take_away": 1.2, "gap": 0.6},
            {"control_period": 0.02},
            {"sensors": sg.sensors.Camera(), "randomisation": sg.Randomisation(friction=0.2)},
            {"max_parcels": 6},
        ],
    )
    def test_it_holds_off_what_it_was_tuned_on(self, arguments) -> None:
        found, batch = played(TimeSlots, "singulate", stream=bulk(12_000.0), **arguments)
        assert batch.outcome[0] != JAM
        assert found.correct_gaps > 0.98
        assert found.parcels_per_hour > 2500.0

    def test_a_thin_stream_passes_as_it_comes(self) -> None:
        found, batch = played(TimeSlots, "singulate", stream=bulk(900.0))
        assert batch.streams.correct[0, : batch.streams.arrivals[0] - 4].all()
        assert found.time_mean < 2.9  # rolling takes 2.5 s


class TestPatterns:
    @pytest.mark.parametrize(
        ("task", "arguments", "least"),
        [
            ("singulate", {"stream": bulk(14_000.0)}, 9000.0),
            ("singulate", {"stream": bulk(14_000.0), **MOUTH}, 7500.0),
            ("singulate", {"stream": bulk(14_000.0), **MOUTH, "demand": Stops()}, 5000.0),
            ("singulate", {"stream": bulk(14_000.0), **MOUTH, "preset": "lab"}, 6500.0),
            ("merge", {"stream": lines(9000.0)}, 7000.0),
        ],
    )
    def test_more_parcels_leave_one_by_one(self, task, arguments, least) -> None:
        found, batch = played(Patterns, task, **arguments)
        assert batch.outcome[0] != JAM
        assert found.parcels_per_hour > least
        assert found.correct_gaps >= (0.98 if "preset" in arguments else 1.0)
        assert found.aligned > 0.99
        assert found.beside < 0.01

    @pytest.mark.parametrize(
        "arguments",
        [
            {"line": slope_line(3.0)},
            {"tilt": math.radians(6.0)},
            {"tilt": math.radians(10.0)},
            {"exits": Exits((Exit("aside", 0, -0.5, 0.1),))},
            {"control_period": 0.02},
            {"max_parcels": 6},
        ],
    )
    def test_it_holds_off_what_it_was_tuned_on(self, arguments) -> None:
        given: dict[str, Any] = {**MOUTH, "stream": bulk(12_000.0), **arguments}
        found, batch = played(Patterns, "singulate", **given)
        assert batch.outcome[0] != JAM
        assert found.correct_gaps > 0.98
        assert found.parcels_per_hour > 2500.0


def test_one_that_holds_and_releases_keeps_parcels_longer_and_gaps_right() -> None:
    held, batch = played(HoldAndRelease, "singulate", stream=bulk(14_000.0))
    slots, _ = played(TimeSlots, "singulate", stream=bulk(14_000.0))
    assert batch.outcome[0] != JAM
    assert held.correct_gaps > 0.99
    assert held.parcels_per_hour > 2500.0
    assert held.time_mean > slots.time_mean


@pytest.mark.parametrize(
    ("make", "window", "rate"),
    [
        (PassAndPark, 1, 3000.0), (PassAndPark, 2, 2600.0), (PassAndPark, 4, 2200.0),
        (PassAndPark, 8, 1600.0), (PatternsInOrder, 4, 2200.0),
    ],
)  # fmt: skip
def test_parcels_leave_in_their_order(make: type[SlopeRule], window: int, rate: float) -> None:
    found, batch = played(make, "sequence", stream=shuffled(rate, window))
    assert batch.outcome[0] != JAM
    assert found.order_errors == 0.0
    assert found.correct_gaps == 1.0
    assert batch.streams.tally[0, 2] == 0  # wrong
    assert found.parcels_per_hour > 0.85 * rate


@pytest.mark.parametrize(
    ("make", "task"),
    [
        (TimeSlots, "merge"),
        (HoldAndRelease, "singulate"),
        (PassAndPark, "sequence"),
        (Patterns, "merge"),
    ],
)
def test_a_batch_is_led_as_each_of_it_alone(make: type[SlopeRule], task: str) -> None:
    config = EnvConfig(task, actions=make.acts_by, duration=6.0)
    rule, together = make(config), begun(config, 3, seed=7)
    alone = [begun(config, seed=7 + i) for i in range(3)]
    state, states = None, [None] * 3
    for _ in range(150):
        actions, state = rule.predict(together.observation, state)
        for i, batch in enumerate(alone):
            action, states[i] = rule.predict(batch.observation[0], states[i])
            np.testing.assert_array_equal(action, actions[i])
            batch.step(action[np.newaxis])
        together.step(actions)


def test_an_episode_that_begins_anew_forgets_the_last() -> None:
    config = EnvConfig("singulate", actions="parcels")
    rule = TimeSlots(config)
    batch = StreamBatch(config, 2)
    for i in range(2):
        batch.seed(i, np.random.default_rng(5))
    batch.reset(np.arange(2))
    first, state = rule.predict(batch.observation)
    other = rule.predict(np.roll(batch.observation, 1, axis=1), state)[1]
    again, _ = rule.predict(batch.observation, other, np.array([True, False]))
    np.testing.assert_array_equal(first[0], again[0])


class TestArguments:
    def test_a_surface_that_nothing_rolls_down_is_refused(self) -> None:
        config = EnvConfig("singulate", actions="parcels", tilt=0.0)
        with pytest.raises(ValueError, match="tilt must let parcels roll"):
            TimeSlots(config)

    def test_other_tasks_and_actions_are_refused(self) -> None:
        with pytest.raises(ValueError, match="task must be one with a take-away"):
            TimeSlots(EnvConfig("flow", actions="parcels"))
        with pytest.raises(ValueError, match="task must be a Sequence"):
            PassAndPark(EnvConfig("merge", actions="parcels"))
        with pytest.raises(ValueError, match="actions must be"):
            TimeSlots(EnvConfig("singulate"))
        with pytest.raises(ValueError, match="actions must be"):
            Patterns(EnvConfig("singulate", actions="parcels"))
