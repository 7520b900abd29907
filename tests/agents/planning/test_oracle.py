"""The oracle: what it finds is what an environment does by the same actions."""

import math
from typing import Any

import numpy as np
import pytest

from surface_gym import Parcel, Rectangle
from surface_gym.agents.planning.planner import Oracle, OracleResult, run_oracle
from surface_gym.agents.rollout import run_episodes
from surface_gym.config import EnvConfig
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.tasks import Slow, Stop
from tests.agents.rules.runs import Scripted

SEED = 11
PATH = {"tilt": 0.22, "speed": 0.8, "path": [(0.5, 1.0), (1.5, 1.05)]}
BRAKED = {"speed": 0.9, "ratio": 0.3}
WIDE = Parcel(Rectangle(0.5, 0.5))
HALVES = EnvConfig(task="stop", actions="halves")
HARD = EnvConfig(
    task=Slow(parcels=(Parcel(Rectangle(0.3, 0.22), com_offset=(0.03, -0.02)), WIDE)),
    actions="halves",
    actuators=Actuators(axis_speed=0.5 * math.pi / 0.05, stuck_share=0.02),
    randomisation=Randomisation(friction=0.15, rolling=0.15, lateral=0.01, heading=0.05),
)


def found_by_oracle(config: EnvConfig, starts: list[Any], budget: int) -> list[OracleResult]:
    oracle = Oracle(config, budget)
    return [oracle.find(start, SEED + k) for k, start in enumerate(starts)]


def test_what_is_found_happens_in_the_environment() -> None:
    found = found_by_oracle(HARD, [{}] * 3, 8)
    episodes = run_episodes(Scripted([each.actions for each in found]), HARD, [{}] * 3, SEED)
    assert [each.success for each in found] == episodes.success.tolist()
    assert [each.outcome for each in found] == list(episodes.outcome)
    assert episodes.success.any()
    for i, each in enumerate(found):
        np.testing.assert_array_equal(each.poses, episodes.path(i))
        np.testing.assert_array_equal(each.velocity, episodes.velocity[i])
        assert each.time == episodes.time[i]
        assert each.metrics == (episodes.metrics["ratio_error"][i],)


def test_its_episodes_are_like_a_controllers() -> None:
    starts = [{"speed": 1.0}, {"speed": 2.0, "ratio": 0.5}]
    found = found_by_oracle(HARD, starts, 8)
    episodes = run_oracle(HARD, starts, SEED, budget=8)
    assert episodes.success.tolist() == [each.success for each in found]
    assert episodes.outcome == ("success", "success")
    assert set(episodes.metrics) == {"ratio_error"}
    assert episodes.time.tolist() == [each.time for each in found]
    for i, each in enumerate(found):
        np.testing.assert_array_equal(episodes.path(i), each.poses)
    assert episodes.decision_time > 0.0


def test_each_start_is_found_as_if_it_were_alone() -> None:
    env_config = EnvConfig(task="stop", actions="halves", preset="stuck")
    together = found_by_oracle(env_config, [{}] * 7, 2)
    for place in (0, 6):
        alone = Oracle(env_config, budget=2).find({}, SEED + place)
        assert alone.actions == together[place].actions


def test_more_nodes_are_followed_only_where_fewer_find_no_success() -> None:
    """A parcel that enters at 2.7 m/s cannot be stopped where the zone begins."""
    starts = [{"speed": 1.0}, {"speed": 2.7, "position": 0.5}]
    within, beyond = found_by_oracle(HALVES, starts, 24)
    assert (within.success, within.width, beyond.success, beyond.width) == (True, 8, False, 24)
    assert beyond.outcome == "passed the asked x"


@pytest.mark.parametrize(
    ("settings", "start", "budget", "outcome", "most"),
    [
        ({"task": Stop(parcels=(WIDE,))}, {}, 8, "success", 1e-3),  # though partly on supports
        ({"task": "track", "preset": "lab"}, PATH, 4, "success", 0.015),
        # The limit is the task's own, in decisions: here a second.
        ({"task": "slow", "control_period": 0.01}, BRAKED, 1, "out of time", 1.0),
    ],
    ids=["wide", "path", "time"],
)
def test_it_stops_wide_parcels_and_follows_paths_but_not_beyond_its_time(
    settings, start, budget, outcome, most
) -> None:
    config = EnvConfig(actions="halves", **settings)
    (found,) = found_by_oracle(config, [start], budget)
    assert (found.outcome, found.success) == (outcome, outcome == "success")
    assert abs(found.metrics[0]) < most
    if outcome == "out of time":
        assert (found.time, len(found.actions)) == (pytest.approx(1.0), 100)


@pytest.mark.parametrize(
    ("settings", "budget", "message"),
    [
        ({}, 0, "budget must be a whole number of at least 1"),
        ({}, 1.5, "budget must be a whole number of at least 1"),
        ({"actions": "modules"}, 1, "actions must be one of 'halves'"),
        ({"orientations": "any"}, 1, "orientations must be some to choose from, got 'any'"),
    ],
)
def test_what_it_cannot_search_is_refused(settings, budget, message) -> None:
    with pytest.raises(ValueError, match=message):
        Oracle(EnvConfig(**{"task": "slow", "actions": "halves", **settings}), budget)
