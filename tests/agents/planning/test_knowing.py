"""What can be reached, by who knows a start: it is what an environment does by the same actions."""

import math
from typing import Any

import numpy as np
import pytest

from agents.episodes import run_episodes
from agents.planning.knowing import Knowing, play_knowing, reachable
from surface_gym import Parcel, Rectangle
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.settings import Settings
from surface_gym.tasks import Slow, Stop

SEED = 11
WIDE = Parcel(Rectangle(0.5, 0.5))
HARD = Settings(
    task=Slow(parcels=(Parcel(Rectangle(0.3, 0.22), com_offset=(0.03, -0.02)), WIDE)),
    actions="halves",
    actuators=Actuators(axis_speed=0.5 * math.pi / 0.05, stuck_share=0.02),
    randomisation=Randomisation(friction=0.15, rolling=0.15, lateral=0.01, heading=0.05),
)


class Given:
    """Gives each lane the actions it is to be given, one after the other."""

    def __init__(self, actions: list[tuple[int, ...]]) -> None:
        self._actions = actions

    def predict(
        self,
        observation: np.ndarray,
        state: int | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, int]:
        del observation, episode_start, deterministic
        period = 0 if state is None else state
        chosen = [actions[min(period, len(actions) - 1)] for actions in self._actions]
        return np.array(chosen), period + 1


def test_what_is_found_happens_in_the_environment() -> None:
    found = reachable(HARD, [{}] * 3, SEED, budget=8)
    episodes = run_episodes(Given([each.actions for each in found]), HARD, [{}] * 3, SEED)
    assert [each.success for each in found] == episodes.success.tolist()
    assert [each.outcome for each in found] == list(episodes.outcome)
    assert episodes.success.any()
    for lane, each in enumerate(found):
        np.testing.assert_array_equal(each.poses, episodes.path(lane))
        np.testing.assert_array_equal(each.velocity, episodes.velocity[lane])
        assert each.time == episodes.time[lane]
        assert each.figures == (episodes.figures["ratio_error"][lane],)


def test_it_is_told_as_the_episodes_of_a_controller() -> None:
    starts = [{"speed": 1.0}, {"speed": 2.0, "ratio": 0.5}]
    found = reachable(HARD, starts, SEED, budget=8)
    episodes = play_knowing(HARD, starts, SEED, budget=8)
    assert episodes.success.tolist() == [each.success for each in found]
    assert episodes.outcome == ("success", "success")
    assert set(episodes.figures) == {"ratio_error"}
    for lane, each in enumerate(found):
        np.testing.assert_array_equal(episodes.path(lane), each.poses)
        assert episodes.time[lane] == each.time
    assert episodes.decision_time > 0.0


def test_each_start_is_found_as_if_it_were_alone() -> None:
    settings = Settings(task="stop", actions="halves", condition="stuck")
    together = reachable(settings, [{}] * 7, SEED, budget=2)
    for place in (0, 6):
        alone = Knowing(settings, budget=2).find({}, SEED + place)
        assert alone.actions == together[place].actions


def test_processes_find_the_same() -> None:
    settings = Settings(task="stop", actions="halves")
    alone, shared = (reachable(settings, [{}] * 6, SEED, 1, workers) for workers in (1, 2))
    assert [each.actions for each in alone] == [each.actions for each in shared]


def test_more_lanes_are_followed_only_where_fewer_find_no_success() -> None:
    """Who enters at 2.7 m/s and is to stop where the zone begins cannot be stopped."""
    settings = Settings(task="stop", actions="halves")
    within, beyond = reachable(
        settings, [{"speed": 1.0}, {"speed": 2.7, "position": 0.5}], SEED, 24
    )
    assert (within.success, within.width) == (True, 8)
    assert (beyond.success, beyond.width) == (False, 24)
    assert beyond.outcome == "passed the asked x"


def test_wide_parcels_are_stopped_though_supports_bear_some_of_them() -> None:
    settings = Settings(task=Stop(parcels=(WIDE,)), actions="halves")
    found = reachable(settings, [{}] * 3, SEED, budget=8)
    assert max(abs(each.figures[0]) for each in found) < 1e-3


def test_a_path_in_a_lab_is_followed_to_its_end() -> None:
    settings = Settings(task="track", actions="halves", condition="lab")
    start = {"tilt": 0.22, "speed": 0.8, "path": [(0.5, 1.0), (1.5, 1.05)]}
    (found,) = reachable(settings, [start], SEED, budget=4)
    assert found.success
    assert found.figures[0] < 0.015


def test_running_out_of_time_is_no_success() -> None:
    """The limit is the task's own, in decisions: here a second."""
    settings = Settings(task="slow", actions="halves", control_period=0.01)
    (found,) = reachable(settings, [{"speed": 0.9, "ratio": 0.3}], SEED, budget=1)
    assert found.outcome == "out of time"
    assert found.time == pytest.approx(1.0)
    assert len(found.actions) == 100


@pytest.mark.parametrize("budget", [0, -1, 1.5])
def test_a_budget_is_at_least_one_lane(budget: Any) -> None:
    with pytest.raises(ValueError, match="budget must be a whole number of at least 1"):
        Knowing(HARD, budget)


def test_other_actions_are_an_error() -> None:
    with pytest.raises(ValueError, match="actions must be one of 'halves'"):
        Knowing(Settings(task="slow", actions="modules"))


def test_any_angle_is_an_error() -> None:
    with pytest.raises(ValueError, match="orientations must be some to choose from, got 'any'"):
        Knowing(Settings(task="slow", actions="halves", orientations="any"))


def test_no_process_is_an_error() -> None:
    with pytest.raises(ValueError, match="workers must be a whole number of at least 1"):
        reachable(HARD, [{}], SEED, workers=0)
