"""Rules that decide parcel by parcel."""

import math
from functools import partial

import numpy as np
import pytest

from surface_gym.agents import library
from surface_gym.agents.rules import sorting
from surface_gym.agents.rules.sorting import StreamEventRule
from surface_gym.flow.task import COLUMN, FEATURES
from tests.agents.rules.runs import counts, gated, line
from tests.environments import begun
from tests.flow.flows import trace

LEFT, RIGHT, ROLL = 2, 1, 3  # of the default orientations: -45, 45 and 90 deg

SHOWN = [each.place for each in (COLUMN.present, COLUMN.past_the_exit_s_start, COLUMN.side)]


def table(rows: int, *parcels: tuple[float, float]) -> np.ndarray:
    """Show parcels, by how far each is past its start and the side of its exit."""
    seen = np.zeros((rows, len(FEATURES)), dtype=np.float32)
    for row, (past, side) in zip(seen, parcels, strict=False):
        row[SHOWN] = 1.0, past, side
    return seen


def test_a_gate_is_opened_at_once_and_a_parcel_that_waits_there_has_no_halves() -> None:
    config = gated(max_parcels=2)
    seen = table(3, (0.1, 1.0))
    seen[-1, [*SHOWN, COLUMN.waits.place]] = 1.0, 5.0, 1.0, 1.0
    action, _ = StreamEventRule(config).predict(seen)
    assert action.tolist() == [LEFT, LEFT, ROLL, ROLL, sorting.OPEN]
    assert config.action_space().contains(action)


@pytest.mark.parametrize(("make", "touches"), [(StreamEventRule, 0), (sorting.SortEach, None)])
def test_a_thin_stream_is_sorted(make, touches) -> None:
    config = line(line().stream_task.stream.with_rate(900.0))
    found = counts(make(config), config)
    assert found["right"] >= 4
    assert found["wrong"] == 0
    assert touches in (None, found["touches"])


def test_for_each_parcel_the_agent_of_sort_decides_by_its_row() -> None:
    config = line(trace((0.0, "right"), (0.4, "left"), (0.8, "straight")), max_parcels=4)
    each, agent = sorting.SortEach(config), library.load("sort-ppo", 0)
    batch = begun(config)
    met = set()
    for _ in range(30):
        seen = batch.observation[0]
        action, _ = each.predict(seen)
        for row, halves in zip(seen, action.reshape(4, 2), strict=True):
            if row[COLUMN.present.place] == 0.0 or row[COLUMN.side.place] == 0.0:
                assert halves.tolist() == [ROLL, ROLL]
            else:
                assert halves.tolist() == list(divmod(int(agent.predict(row[: sorting.OWN])[0]), 4))
                met.add(row[COLUMN.side.place])
        batch.step(config.action_kind.commands(action[np.newaxis], 1))
    assert met == {1.0, -1.0}


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (StreamEventRule, {"actions": "modules"}, "actions must be one of 'parcels', got"),
        (StreamEventRule, {"orientations": "any"}, "orientations must be some on offer, got 'any'"),
        (StreamEventRule, {"orientations": (0.0, math.pi / 2)}, "must hold 45 deg|-45 deg"),
        (partial(sorting.SortEach, name="nobody"), {}, "name must be one of"),
    ],
)
def test_what_they_cannot_act_in_is_refused(make, arguments, message) -> None:
    with pytest.raises(ValueError, match=message):
        make(line(**arguments))


def test_each_rolls_until_it_is_past_its_exits_start() -> None:
    seen = table(5, (-0.1, 1.0), (0.1, 1.0), (0.1, -1.0), (0.1, 0.0))
    rule = StreamEventRule(line(max_parcels=5))
    action, state = rule.predict(seen)
    assert action.reshape(5, 2).tolist() == [
        [ROLL, ROLL], [LEFT, LEFT], [RIGHT, RIGHT], [ROLL, ROLL], [ROLL, ROLL],
    ]  # fmt: skip
    assert state is None
    tables = np.stack([seen, table(5, (0.1, -1.0), (0.1, 1.0)), table(5)])
    assert rule.predict(tables)[0].tolist() == [rule.predict(each)[0].tolist() for each in tables]
