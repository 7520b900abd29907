"""The rule of Park: its model beside the simulator, and what it reaches."""

import math

import numpy as np
import pytest

from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.rules import parking
from surface_gym.agents.rules.decoding import see_park
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from tests.agents.rules.runs import run_rule
from tests.environments import batch_with
from tests.tasks.test_park import START

CONFIG = EnvConfig("park", actions="quadrants", observe=("parcel", "load"))


@pytest.mark.parametrize("option", [0, 1, 6, 9, 12, 15])
def test_the_model_moves_a_parcel_as_the_simulator_does(option):
    batch: Batch = batch_with(START, task="park", actions="quadrants", observe=("parcel", "load"))
    rule = parking.ParkingRule(CONFIG)
    arguments = rule.arguments(
        batch.parcels.observation[:1], rule.make_memory(1), np.zeros((1, 4), dtype=np.int64)
    )
    _, sight, model, _, _, scratch, _, _ = arguments
    seen = see_park(batch.parcels.observation[0], sight)
    body, node, after = parking.find_body(seen), scratch.node[0], scratch.tried[0]
    parking.begin(seen, body, node)
    node[parking.AXES :] = math.pi / 2
    count = parking.place_under(seen, body, node, sight, scratch)
    theirs = batch.config.chosen_line.pitch_x  # as many as fit under the base, give or take an edge
    assert abs(count - (0.25 / theirs) ** 2) < 4
    parking.advance(1.0, body.gyration, node, after, option, count, model, scratch)
    goal = batch.parcels.goal[0]
    batch.step(model.options[option][np.newaxis])
    truth = batch.parcels.truth[0]
    apart = np.abs(goal - after[:3] - truth[:3])
    assert (apart <= (2e-3, 2e-3, 0.02)).all()
    np.testing.assert_allclose(after[3:5], truth[3:5], atol=0.06)
    assert after[5] == pytest.approx(truth[5], abs=0.6)


def test_it_parks_where_a_fixed_layout_does_not():
    rule = parking.ParkingRule(CONFIG)
    episodes = run_episodes(rule, CONFIG, [{}] * 20, 700)
    assert episodes.success.mean() >= 0.85
    fixed = run_rule("park", "fixed layout", [{"aside": 0.0, "angle": 0.0}] * 20)
    assert fixed.success.mean() <= 0.5
    assert np.median(fixed.metrics["distance"]) < 0.05  # it stops near the goal's x
