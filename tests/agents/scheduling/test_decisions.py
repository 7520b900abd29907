"""Decisions: when each candidate may enter and what it costs, and what a network is shown."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.schedule_policy import NetworkScheduler, ScheduleNetwork
from surface_gym.agents.scheduling import decisions
from surface_gym.agents.scheduling.decisions import (
    ABOUT,
    DEVIATION,
    LEVELS,
    OPTION,
    TOKEN,
    TOKENS,
    find_costs,
    find_entries,
    make_model_library,
)
from surface_gym.agents.scheduling.leading import make_workspace, search
from surface_gym.config import EnvConfig
from surface_gym.flow import task
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from surface_gym.layouts import box
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera
from surface_gym.state import RUNNING
from tests.agents.rules.runs import gated
from tests.environments import begun

NOW = 5.0


@pytest.fixture(params=range(3))
def rng(request) -> np.random.Generator:
    return np.random.default_rng(request.param)


def test_entries_keep_every_booked_parcel_clear(rng) -> None:
    tight = rng.uniform(0.1, 0.5, (6, 6))
    wide = tight + rng.uniform(0.0, 0.3, (6, 6))
    options = np.array([0, 3, 5, -1])
    booked, entered = rng.integers(6, size=4), NOW - rng.uniform(0.0, 0.6, 4)
    entry, binding = np.empty((4, len(LEVELS))), np.empty((4, len(LEVELS)), dtype=np.int64)
    find_entries(tight, wide, LEVELS, options, booked, entered, NOW, entry, binding)
    for o, option in enumerate(options[:3]):
        for k, level in enumerate(LEVELS):
            gaps = tight[booked, option] + level * (wide - tight)[booked, option]
            assert entry[o, k] == pytest.approx(max(NOW, *(entered + gaps)))
            after = entered + gaps > NOW
            expected = (entered + gaps).argmax() if after.any() else -1
            assert binding[o, k] == expected


def test_costs_are_those_of_the_search_with_one_option_alone(rng) -> None:
    gaps, delay = rng.uniform(0.1, 0.5, (6, 6)), rng.uniform(0.0, 0.1, 6)
    options = np.array([[0, 1, 2], [3, 4, -1], [5, -1, -1]])
    queue = np.array([0, 1, 2, 0])
    booked, entered = rng.integers(6, size=4), NOW - rng.uniform(0.0, 0.6, 4)
    padded = np.pad(options, ((0, 1), (0, 0)), constant_values=-1)
    space, cost = make_workspace(), np.empty(3)
    find_costs(gaps, delay, padded, queue.copy(), booked, entered, NOW, space, cost)
    for o in range(3):
        alone = np.vstack([options, [[options[0, o], -1, -1]]])
        search(gaps, delay, alone, np.array([3, 1, 2, 0]), booked, entered, NOW, space)
        assert cost[o] == pytest.approx(space.cost[3, 0])
    chosen, _ = search(gaps, delay, options, queue, booked, entered, NOW, space)
    assert chosen == cost.argmin()
    find_costs(gaps, delay, padded, np.array([1, 2]), booked, entered, NOW, space, cost)
    assert np.isinf(cost[2])  # a kind with two options


def test_a_model_has_nothing_that_errs(monkeypatch) -> None:
    monkeypatch.setattr(decisions, "make_library", lambda *given, **named: (given, named))
    varied = gated(
        sensors=Camera(),
        randomisation=Randomisation(friction=0.2),
        actuators=Actuators(axis_speed=30.0, stuck_share=0.1),
    )
    plain = gated(actuators=Actuators(axis_speed=30.0))
    assert make_model_library(varied) == ((plain,), {"margin": 0.0, "slack": 0.0})


S_BOXES = Stream(Steady(9000.0), parcels=("S",), speeds=1.5)


class Watching(NetworkScheduler):
    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ScheduleNetwork((8, 8)))
        self.shown: list[Any] = []

    def choose(self, decisions):
        self.shown.append(decisions)
        return super().choose(decisions)


def run(scheduler: NetworkScheduler, config: EnvConfig) -> Iterator[tuple[Any, np.ndarray]]:
    """Run an episode, and yield what the scheduler remembers and saw after each decision."""
    batch, state = begun(config, seed=4), None
    while (batch.outcome == RUNNING).any():
        table = batch.observation.copy()
        action, state = scheduler.predict(table, state)
        yield state, table
        batch.step(config.action_kind.commands(action, 1))


@pytest.fixture(scope="module")
def config() -> EnvConfig:
    return gated(S_BOXES, queue=3, duration=8.0)


@pytest.fixture(scope="module")
def watching(config) -> Watching:
    found = Watching(config)
    for _ in run(found, config):
        pass
    return found


def test_a_parcel_that_meets_nobody_keeps_to_its_trajectory(config) -> None:
    seldom = config.replace(stream=Stream(Steady(900.0), parcels=("S",), speeds=1.5))
    watched = np.concatenate([state[1].seen[0] for state, _ in run(Watching(seldom), seldom)])
    assert np.abs(watched).max() > 0.0
    assert np.abs(watched[:, 0] * DEVIATION[0]).max() < 1.5 * config.control_period
    assert np.abs(watched[:, 1] * DEVIATION[1]).max() < 1.5 * config.control_period


def test_all_numbers_have_their_shapes(watching) -> None:
    for each in watching.shown:
        count, options = each.cost.shape[:2]
        assert each.cost.shape == (count, options, len(LEVELS))
        assert each.option.shape == (count, options, OPTION)
        assert each.token.shape == (count, TOKENS, TOKEN)
        assert each.about.shape == (count, ABOUT)
        assert all(np.isfinite(part).all() for part in each)


def test_those_that_wait_and_roll_are_shown(config) -> None:
    scheduler = Watching(config)
    for (_, watched, _), table in run(scheduler, config):
        if not scheduler.shown:
            continue
        (each,) = scheduler.shown
        scheduler.shown.clear()
        present = table[0, :, task.COLUMN.present.place] > 0.5
        parcels = config.stream_task.max_parcels
        kinds = each.token[0][each.shown[0]][:, :3].sum(axis=0)
        gone = (watched.gone[0] >= 0).sum()
        assert kinds.tolist() == [present[:parcels].sum(), gone, present[parcels:].sum()]


def test_left_and_right_are_alike(watching) -> None:
    scheduler, library = watching, watching.library
    names = [name for _, _, name in library.lead.kinds]
    left, right = (library.options[names.index(side)] for side in ("left", "right"))
    own = scheduler._features._static
    np.testing.assert_allclose(own[left[left >= 0]], own[right[right >= 0]], atol=1e-3)


def test_the_wider_the_later(watching) -> None:
    assert (np.diff(LEVELS) > 0.0).all()
    assert (watching.wide >= watching.tight).all()
    for each in watching.shown:
        assert (np.diff(each.cost, axis=2) >= -1e-6).all()


def test_sizes_tell_parcels_apart() -> None:
    both = gated(Stream(Steady(3000.0), parcels=(box("S"), box("B")), speeds=1.5), duration=1.0)
    scheduler = Watching(both)
    first = scheduler.library.options[:, 0]
    sizes = scheduler._features._static[first][:, 4:6]
    assert len(np.unique(sizes, axis=0)) == 2
