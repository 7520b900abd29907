"""The scheduler: its search, what it remembers, and the streams it leads."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from surface_gym.agents.base import find_orientation
from surface_gym.agents.scheduling import scheduler as module
from surface_gym.agents.scheduling.leading import make_workspace, search
from surface_gym.agents.scheduling.maneuvers import ColumnGroups, make_library
from surface_gym.agents.scheduling.scheduler import (
    Scheduler,
    clairvoyant_bound,
    entrance_bound,
    make_scheduler,
    predict_rate,
)
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Poisson, Steady
from surface_gym.flow.exits import flow_line
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import COLUMN
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera
from tests.agents.rules.runs import counts, gated, line, zoned

CROWD = Stream(Steady(15000.0), parcels=("S",), speeds=1.5)
# With axes that take time, as the kernel of a camera that other tests compile.
VARIED = {"randomisation": Randomisation(friction=0.2), "actuators": Actuators(axis_speed=30.0)}
ONCE, NEVER = np.zeros(1, dtype=np.int64), np.full(1, -1e6)


def best_by_trying_all(gaps, delay, options, queue, booked, entered) -> float:
    """Find the least cost [s] over all sequences of maneuvers."""
    found = np.inf
    for sequence in product(*(options[kind][options[kind] >= 0] for kind in queue)):
        ways, times = list(booked), list(entered)
        for way in sequence:
            times.append(max(0.0, *(t + gaps[w, way] for w, t in zip(ways, times, strict=True))))
            ways.append(way)
        found = min(found, times[-1] + delay[sequence[-1]])
    return found


class TestSearch:
    def test_it_finds_the_best_of_all_sequences(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(50):
            gaps, delay = rng.uniform(0.1, 1.0, (6, 6)), rng.uniform(0.0, 0.5, 6)
            options = np.array([[0, 1, -1], [2, 3, -1], [4, 5, -1]])
            queue = rng.integers(3, size=4)
            booked, entered = rng.integers(6, size=2), np.array([-0.1, -0.4])
            space = make_workspace()
            first, time = search(gaps, delay, options, queue, booked, entered, 0.0, space)
            best = best_by_trying_all(gaps, delay, options, queue, booked, entered)
            assert space.cost[3, 0] == pytest.approx(best)
            assert first in options[queue[0]]
            assert time >= max(entered + gaps[booked, first]) - 1e-12

    def test_looking_ahead_pays_where_the_best_now_is_bad_for_the_next(self) -> None:
        gaps = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 0.1], [0.0, 0.0, 0.0]])
        options = np.array([[0, 1], [2, -1]])
        entered = np.zeros(1)
        booked = np.array([2])
        gaps[2] = [0.5, 0.6, 0.5]
        one = search(
            gaps, np.zeros(3), options, np.array([0]), booked, entered, 0.0, make_workspace()
        )
        two = search(
            gaps, np.zeros(3), options, np.array([0, 1]), booked, entered, 0.0, make_workspace()
        )
        assert (one, two) == ((0, 0.5), (1, 0.6))


def rates(config: EnvConfig, scheduler: Scheduler) -> tuple[dict[str, int], float]:
    """Count what a scheduler does, and the parcels an hour that enter as time goes to infinity."""
    odds = np.ones(len(scheduler.library.signature))
    return counts(scheduler, config), predict_rate(scheduler.library, odds, 500)


class TestStreams:
    @pytest.mark.parametrize(
        ("config", "groups"),
        [
            (gated(CROWD), None),
            (gated(CROWD, queue=4), None),
            (gated(Stream(Poisson(9000.0, 0.1), parcels=("S", "B"), speeds=(1.0, 1.5))), None),
            (zoned(CROWD), ColumnGroups()),
            (zoned(CROWD), ColumnGroups(7)),
            (zoned(CROWD), ColumnGroups(7, 1, exclusive=True)),
            (gated(CROWD, exits="chutes", line=flow_line(4.0)), None),
            (gated(CROWD, sensors=Camera(), **VARIED), None),
        ],
        ids=["modules", "queue", "mixed", "columns", "zones", "zone", "chutes", "camera"],
    )
    def test_more_than_a_line_takes_is_sorted_without_a_touch(self, config, groups) -> None:
        made = make_scheduler(config, groups)
        assert made is not None
        count = counts(made, config)
        assert (count["wrong"], count["touches"]) == (0, 0)
        assert count["right"] > 16

    def test_no_schedule_passes_the_bounds(self) -> None:
        config = gated(CROWD, duration=20.0)
        made = make_scheduler(config)
        odds = np.ones(3)
        predicted = predict_rate(made.library, odds, 3000)
        best = clairvoyant_bound(made.library, odds, 3000)
        assert 0.97 * best < predicted < 1.01 * best
        assert best < entrance_bound(config)
        count = counts(made, config, num_envs=8)
        rate = 3600.0 * count["right"] / (8 * config.stream_task.duration)
        assert 0.8 * best < rate < 1.02 * best  # the first and last parcels do not count

    def test_what_cannot_be_sorted_has_no_scheduler(self) -> None:
        slow = gated(Stream(Steady(1000.0), speeds=0.05), duration=8.0)
        assert make_scheduler(slow) is None

    def test_a_gate_is_asked_for(self) -> None:
        with pytest.raises(ValueError, match="gate must be True for a schedule, got False"):
            Scheduler(line(CROWD))


class TestMemory:
    def test_environments_and_episodes_are_booked_apart(self) -> None:
        config = gated(CROWD)
        controller = Scheduler(config)
        tables = np.random.default_rng(0).normal(size=(4, 2, config.stream_task.rows, 29))
        tables = tables.astype(np.float32)
        tables[..., COLUMN.present.place] = tables[..., COLUMN.present.place] > 0.0
        fresh = np.array([[True, True], [False, True], [False, False], [True, False]])
        together, state = [], None
        for table, begins in zip(tables, fresh, strict=True):
            action, state = controller.predict(table, state, begins)
            together.append(action)
        for i in range(2):
            state = None
            for k, (table, begins) in enumerate(zip(tables[:, i], fresh[:, i], strict=True)):
                action, state = controller.predict(table, state, np.array([begins]))
                np.testing.assert_array_equal(action, together[k][i])

    def test_it_leads_parcels_that_were_there_before_it(self) -> None:
        config = gated(CROWD)
        controller = Scheduler(config)
        table = np.zeros((1, config.stream_task.rows, 29), dtype=np.float32)
        table[0, 3, COLUMN.present.place] = 1.0
        table[0, 3, [3, 13, 14]] = 0.5, 3.0, 1.0
        action, _ = controller.predict(table, None)
        assert action[0, 6] == find_orientation(config, -0.25 * np.pi)

    def test_a_row_may_pass_to_the_entered_parcel_without_being_empty(self) -> None:
        config = gated(CROWD)
        controller = Scheduler(config)
        time, rows = COLUMN.time.place, config.stream_task.max_parcels
        table = np.zeros((1, config.stream_task.rows, 29), dtype=np.float32)
        table[0, [0, rows], COLUMN.present.place] = 1.0
        table[0, 0, time] = 1.0
        _, state = controller.predict(table, None)
        before = state.rows[0, 0]
        assert state.pending[0]
        booked = (before + 1) % len(controller.library.maneuvers.kind)
        state.booked[0, 0] = booked  # another maneuver than the row's
        for seconds, expected in ((1.0, before), (0.02, booked)):
            table[0, rows] = 0.0
            table[0, 0, time] = seconds / COLUMN.time.scale
            _, after = controller.predict(table, state)
            assert after.rows[0, 0] == expected


class TestTrial:
    @pytest.mark.parametrize("first", range(5))
    def test_the_first_quiet_one_is_found(self, monkeypatch, first) -> None:
        config = gated(duration=2.0)

        def trial(_config, place, most):
            assert most == pytest.approx(0.1 * entrance_bound(config) / 3600.0 * 16 * 20.0)
            return module.Trial(90, 40, 10, 10 if place >= first else 11, 0)

        monkeypatch.setattr(module, "run_trial", trial)
        place, right = module.find_quiet(config, lambda place: place, 4, 0.1)
        assert (place, right) == ((first, 40) if first < 4 else (3, 0))

    def test_a_jam_is_never_quiet(self, monkeypatch) -> None:
        monkeypatch.setattr(
            module, "run_trial", lambda *_: module.Trial(9, 4, 0, touches=0, jams=1)
        )
        assert module.find_quiet(gated(), lambda place: place, 3) == (2, 0)

    def test_it_ends_once_too_many_touch(self) -> None:
        config = gated(Stream(Steady(9000.0), speeds=1.5), duration=6.0)
        made = make_library(config, place_count=2)
        close = Scheduler(config, replace(made, gaps=np.full_like(made.gaps, 0.05)))
        few, many = (module.run_trial(config, close, most).touches for most in (5.0, 1e9))
        assert 5 < few < many


class Everybody:
    """Lets in whoever finds room, and lets all roll straight on."""

    def predict(self, observation, state=None, *_, **__):
        action = np.full((len(observation), 49), 3)
        action[:, -1] = 1
        return action, state


@pytest.mark.parametrize(
    ("stream", "rate"),
    [
        (Stream(Steady(20000.0), parcels=("S",), speeds=1.5), 20000.0),
        (Stream(Steady(20000.0), parcels=("S", "B"), speeds=1.0), 3600.0 / 0.37),
    ],
    ids=["S", "S and B"],
)
def test_no_more_come_through_an_entrance_and_nearly_as_many_do(stream, rate) -> None:
    config = gated(stream, duration=20.0, max_parcels=24)
    assert entrance_bound(config) == pytest.approx(rate)
    straight = config.replace(
        stream=Stream(stream.arrivals, stream.parcels, {"straight": 1.0}, stream.speeds)
    )
    count = counts(Everybody(), straight, num_envs=8)
    delivered = 3600.0 * count["right"] / (8 * (20.0 - 2.0 / 1.5))
    assert 0.85 * rate < delivered < 1.03 * rate


def test_odds_count() -> None:
    config = gated(Stream(Steady(1000.0), parcels=("S", "B"), speeds=1.5))
    only_small = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    assert entrance_bound(config, only_small) == pytest.approx(20000.0)


def test_the_shortest_path_is_found() -> None:
    library = make_library(gated(Stream(Steady(1000.0), speeds=1.5)), place_count=2)
    bound = clairvoyant_bound(library, np.ones(3), parcels=4, seed=3)
    kinds = np.random.default_rng(3).choice(3, size=4, p=np.ones(3) / 3.0)
    own = [library.options[kind][library.options[kind] >= 0] for kind in kinds]
    least = min(
        library.gaps[a, b] + library.gaps[b, c] + library.gaps[c, d]
        for a in own[0] for b in own[1] for c in own[2] for d in own[3]
    )  # fmt: skip
    assert bound == pytest.approx(3600.0 * 3 / least)
