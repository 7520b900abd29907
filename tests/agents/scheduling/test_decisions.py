"""When each candidate may enter and what it costs, held against trying everything by hand."""

import numpy as np
import pytest

from surface_gym.agents.scheduling import decisions
from surface_gym.agents.scheduling.decisions import (
    LEVELS,
    find_costs,
    find_entries,
    make_model_library,
)
from surface_gym.agents.scheduling.leading import make_workspace, search
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera
from tests.agents.rules.runs import gated

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
