"""The policy on a schedule: it weighs time against touches, and its weights serve any line."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from surface_gym.agents import schedule_policy
from surface_gym.agents.library import PolicyCard
from surface_gym.agents.schedule_policy import (
    PRICES,
    NetworkScheduler,
    ScheduleNetwork,
    SchedulePolicy,
)
from surface_gym.agents.scheduling.decisions import USUAL, Decisions
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.exits import Exit, Exits
from surface_gym.flow.stream import Stream
from tests.agents.rules.runs import counts, gated
from tests.environments import FLOW

THREE = Exits((Exit("a", 1, 0.5, 1.4), Exit("b", 1, 1.6, 2.9), Exit("c", -1, 0.8, 2.9)))
CARD = PolicyCard(FLOW, "schedule", "parcels", 0.04, (8, 8))


def random_network() -> ScheduleNetwork:
    torch.manual_seed(0)
    network = ScheduleNetwork(CARD.hidden)
    torch.nn.init.normal_(network.last.weight)
    return network


def test_the_dearer_a_touch_the_more_clearance(monkeypatch) -> None:
    config = gated(Stream(Steady(12000.0), parcels=("S",), speeds=1.5), queue=4)
    scheduler = NetworkScheduler(config, ScheduleNetwork(CARD.hidden))
    choose, seen = scheduler.choose, []

    def watched(decisions: Decisions) -> tuple[np.ndarray, np.ndarray]:
        option, level = choose(decisions)
        cost = decisions.cost[np.arange(len(option)), option, USUAL]
        seen.extend(zip(cost, level, strict=True))
        return option, level

    monkeypatch.setattr(scheduler, "choose", watched)
    levels = []
    for scheduler.price in (0.1, 10.0):
        seen.clear()
        found = counts(scheduler, config)
        assert found["right"] > 8
        assert found["wrong"] == 0
        cost, level = np.array(seen).T
        assert cost.min() == 0.0
        levels.append(level.mean())
    assert levels[0] < levels[1]


SIX = tuple(np.radians([0, 45, -45, 90, 80, -80]))


@pytest.mark.parametrize("given", [{}, {"exits": THREE}, {"orientations": SIX}])
def test_one_set_of_weights_serves_any_line(given) -> None:
    config = gated(queue=3, **given)
    policy = SchedulePolicy(random_network(), CARD, config)
    found = counts(policy, config)
    assert found["right"] > 5
    assert found["wrong"] == 0


@pytest.mark.parametrize("most", [0.0, 0.05])
def test_it_never_delivers_less_than_one_clearance_for_all(monkeypatch, most) -> None:
    learned = {"right": 0}

    def quiet(_config, make, count, most_touches):
        assert most_touches == most
        assert make(count - 1).price == PRICES[-1]
        return "learned", learned["right"]

    monkeypatch.setattr(schedule_policy, "find_quiet", quiet)
    monkeypatch.setattr(schedule_policy, "find_plain", lambda *_: ("plain", 1000))
    for learned["right"], expected in ((0, "plain"), (1005, "plain"), (1015, "learned")):
        policy = SchedulePolicy(random_network(), CARD, gated(), most)
        assert policy.scheduler == expected


def test_it_is_for_a_line_with_a_gate() -> None:
    with pytest.raises(ValueError, match="gate must be True for a policy on a schedule, got False"):
        SchedulePolicy(random_network(), CARD, gated(gate=False))
    assert replace(CARD, hidden=(4,)).env_kwargs["gate"]
