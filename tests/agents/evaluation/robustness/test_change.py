"""Changes: one thing differs, and controllers are not told what they could not know."""

import math
from dataclasses import replace

import numpy as np
import pytest

from agents.episodes import run_episodes
from agents.evaluation.contenders import Contender, contenders, rules, shipped
from agents.evaluation.robustness.change import Change, situation
from agents.evaluation.robustness.factors import FACTORS, TRAINED
from agents.evaluation.trials import make_trial
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.lines import Line
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS, Slow

SLOW = rules("slow")[0]
TRIAL = make_trial("slow")


def true_of(change: Change, contender: Contender = SLOW) -> Settings:
    return situation(contender, make_trial(contender.task), change).true


def starts_of(settings: Settings, count: int = 64) -> np.ndarray:
    """(count, 3) poses that an environment begins at."""
    env = SmartSurfaceVectorEnv(
        count, task=settings.task, actions=settings.actions, plant=settings.plant
    )
    return env.reset(seed=1)[1]["pose"]


@pytest.mark.parametrize("task", TASKS)
def test_no_change_is_as_trained(task: str) -> None:
    contender = next(each for each in contenders(task) if each.starts is None)
    trial = make_trial(task)
    told, true = situation(contender, trial, FACTORS[TRAINED].change(TRAINED))
    assert told == true
    settings = contender.settings(trial, Change().condition)
    for name in ("sensors", "control_period", "zone", "actuators", "randomisation", "actions"):
        assert getattr(true, name) == getattr(settings, name)
    assert true.chosen_plant == settings.chosen_plant
    assert true.chosen_task.periods == settings.chosen_task.periods
    assert true.task_name == task


def test_an_unchanged_environment_plays_the_same() -> None:
    settings = SLOW.settings(TRIAL, Change().condition)
    (first, second) = (
        run_episodes(SLOW.make(each, 0), each, [{}] * 8, 3)
        for each in (settings, true_of(Change()))
    )
    np.testing.assert_array_equal(first.pose, second.pose)


def test_friction_is_not_told() -> None:
    told, true = situation(SLOW, TRIAL, Change(drag=1.2, rolling=0.5))
    plant = true.chosen_plant
    assert (plant.mu_max, plant.mu_min, plant.mu_support) == pytest.approx((0.6, 0.005, 0.0025))
    assert (told.chosen_plant.mu_max, told.chosen_plant.mu_min) == (0.5, 0.01)


def test_a_zone_has_as_many_columns_behind_it_as_ever() -> None:
    for columns in (8, 24):
        told, true = situation(SLOW, TRIAL, Change(zone_columns=columns))
        assert told == true
        plant = true.chosen_plant
        assert isinstance(plant, Line)
        assert true.action_kind.columns == plant.zone_columns == columns
        assert plant.columns - plant.zone_columns == Line().columns - Line().zone_columns


def test_an_episode_may_last_the_longer_where_the_zone_is() -> None:
    periods = [true_of(Change(zone_columns=n)).chosen_task.periods for n in (8, 16, 24)]
    assert periods == [Slow.periods, Slow.periods, 1.5 * Slow.periods]


def test_an_episode_may_last_as_long_whatever_the_period() -> None:
    for period in (0.02, 0.06, 0.12):
        settings = true_of(Change(control_period=period))
        assert settings.control_period == period
        lasts = settings.control_period * settings.chosen_task.periods
        assert lasts == pytest.approx(0.04 * Slow.periods, abs=0.5 * period)
    assert Slow.periods == 100


@pytest.mark.parametrize("task", TASKS)
def test_entries_are_aside_and_turned_by_just_so_much(task: str) -> None:
    contender = rules(task)[0]
    straight = starts_of(true_of(Change(), contender))
    moved = starts_of(true_of(Change(aside=0.03, turned=0.1), contender))
    off = moved - straight
    np.testing.assert_allclose(np.abs(off[:, 1]), 0.03, atol=1e-12)
    np.testing.assert_allclose(off[:, 2], off[:, 1] / 0.3, atol=1e-12)
    np.testing.assert_allclose(off[:, 0], 0.0, atol=1e-12)
    assert 0.25 < np.mean(off[:, 1] > 0.0) < 0.75


def test_modules_that_share_weights_run_on_any_zone() -> None:
    modules = next(each for each in shipped("sort") if each.name == "PPO per module")
    for columns in (8, 20):
        told, true = situation(modules, make_trial("sort"), Change(zone_columns=columns))
        starts = [{"speed": 1.5, "parcel": "S", "side": side} for side in (1, -1)]
        assert run_episodes(modules.make(told, 0), true, starts, 0).success.all()


def test_loads_lie_off_centre_in_every_direction_and_boxes_are_drawn_as_ever() -> None:
    parcels = FACTORS["load"].change(5).condition.parcels
    offsets = np.array([parcel.com_offset for parcel in parcels])
    np.testing.assert_allclose(np.hypot(*offsets.T), 0.05)
    np.testing.assert_allclose(offsets.sum(axis=0), 0.0, atol=1e-12)
    half = len(parcels) // 2
    assert {parcel.rear for parcel in parcels[:half]} == {0.125}
    assert {parcel.rear for parcel in parcels[half:]} == {0.225}


def test_axes_turn_by_90_deg_in_the_time_said() -> None:
    for told in (25, 200):
        speed = true_of(FACTORS["axis"].change(told)).actuators.axis_speed
        assert 0.5 * math.pi / speed == pytest.approx(1e-3 * told)
    assert true_of(FACTORS["axis"].change(0)) == true_of(Change())


@pytest.mark.parametrize("name", FACTORS)
def test_each_level_makes_an_environment(name: str) -> None:
    factor = FACTORS[name]
    assert set(factor.told) <= set(factor.swept)
    assert factor.trained is None or factor.trained in factor.levels
    for task in TASKS:
        if factor.of_lines and task == "track":
            continue
        for level in (factor.levels[0], factor.levels[-1]):
            settings = true_of(factor.change(level), rules(task)[0])
            assert settings.observation_space().shape


@pytest.mark.parametrize(
    "name", [name for name, each in FACTORS.items() if each.trained is not None]
)
def test_the_trained_level_changes_nothing(name: str) -> None:
    factor = FACTORS[name]
    trained, task = true_of(factor.change(factor.trained)), Slow()
    assert set(trained.chosen_task.parcels) == set(task.parcels)  # some more often than once
    assert replace(trained, task=task) == replace(true_of(Change()), task=task)
