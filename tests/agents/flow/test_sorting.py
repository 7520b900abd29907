"""The agent of Sort for each parcel of a flow."""

import numpy as np
import pytest

from agents import library
from agents.flow.sorting import SortEach
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.features import OWN, PRESENT
from tests.agents.flow.lines import counts, line
from tests.flow.flows import trace

ROLL = 3


def test_it_says_for_a_parcel_what_the_agent_says_of_its_row() -> None:
    settings = line(trace((0.0, "right"), (0.4, "left"), (0.8, "straight")), places=4)
    each, agent = SortEach(settings), library.load("sort-ppo", 0)
    batch = FlowBatch(settings, 1)
    batch.seed(0, np.random.default_rng(0))
    batch.start(np.array([0]))
    met = set()
    for _ in range(30):
        table = batch.observation[0]
        action, _ = each.predict(table)
        for row, halves in zip(table, action.reshape(4, 2), strict=True):
            if row[PRESENT] == 0.0 or row[14] == 0.0:
                assert halves.tolist() == [ROLL, ROLL]
            else:
                assert halves.tolist() == list(divmod(int(agent.predict(row[:OWN])[0]), 4))
                met.add(row[14])
        batch.advance(settings.flow_actions.commands(action[np.newaxis], 1))
    assert met == {1.0, -1.0}


def test_a_thin_stream_is_sorted() -> None:
    settings = line(line().stream.with_rate(900.0))
    found = counts(SortEach(settings), settings)
    assert found["right"] >= 4
    assert found["wrong"] == 0


def test_an_unknown_agent_is_refused() -> None:
    with pytest.raises(ValueError, match="name must be one of"):
        SortEach(line(), name="nobody")
