"""The event rule for each parcel, and what all such rules share."""

import math

import numpy as np
import pytest

from agents.flow.event import EventRule
from agents.flow.parcel_rule import OPEN, PAST_START, SIDE
from surface_gym.flow.features import FEATURES, PRESENT, WAITS
from tests.agents.flow.lines import counts, gated, line

LEFT, RIGHT, ROLL = 2, 1, 3  # of the default orientations: -45, 45 and 90 deg


def table(rows: int, *parcels: tuple[float, float]) -> np.ndarray:
    """Some parcels, by how far each is past its start and the side of its exit."""
    seen = np.zeros((rows, len(FEATURES)), dtype=np.float32)
    for row, (past, side) in zip(seen, parcels, strict=False):
        row[[PRESENT, PAST_START, SIDE]] = 1.0, past, side
    return seen


def test_each_rolls_until_it_is_past_its_exits_start() -> None:
    settings = line(places=5)
    seen = table(5, (-0.1, 1.0), (0.1, 1.0), (0.1, -1.0), (0.1, 0.0))
    action, state = EventRule(settings).predict(seen)
    assert action.reshape(5, 2).tolist() == [
        [ROLL, ROLL], [LEFT, LEFT], [RIGHT, RIGHT], [ROLL, ROLL], [ROLL, ROLL],
    ]  # fmt: skip
    assert state is None


def test_many_lanes_are_decided_as_each_alone() -> None:
    rule = EventRule(line(places=2))
    lanes = np.stack([table(2, (0.1, 1.0)), table(2, (0.1, -1.0), (0.1, 1.0)), table(2)])
    actions, _ = rule.predict(lanes)
    assert actions.tolist() == [rule.predict(lane)[0].tolist() for lane in lanes]


def test_a_gate_is_opened_at_once_and_who_waits_there_has_no_halves() -> None:
    settings = gated(places=2)
    seen = table(3, (0.1, 1.0))
    seen[-1, [PRESENT, WAITS, PAST_START, SIDE]] = 1.0, 1.0, 5.0, 1.0
    action, _ = EventRule(settings).predict(seen)
    assert action.tolist() == [LEFT, LEFT, ROLL, ROLL, OPEN]
    assert settings.action_space().contains(action)


def test_a_thin_stream_is_sorted() -> None:
    settings = line(line().stream.with_rate(900.0))
    found = counts(EventRule(settings), settings)
    assert found["right"] >= 4
    assert (found["wrong"], found["touches"]) == (0, 0)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"actions": "modules"}, "actions must be one of 'parcels', got 'modules'"),
        ({"orientations": "any"}, "orientations must be some on offer, got 'any'"),
        ({"orientations": (0.0, math.pi / 2)}, "orientations must hold 45 deg|-45 deg"),
    ],
)
def test_what_it_cannot_act_in_is_refused(settings: dict[str, object], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        EventRule(line(**settings))
