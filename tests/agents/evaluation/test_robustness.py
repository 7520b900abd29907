"""The sweep: one thing differs, unknown to controllers where they could not know it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents.evaluation import scenario as robustness
from surface_gym.agents.evaluation.method import (
    PLANNER,
    Method,
    all_methods,
    rules,
    shipped,
    start_benchmark,
)
from surface_gym.agents.evaluation.results import Sample, make_rows
from surface_gym.agents.evaluation.scenario import (
    TRAINED,
    WHOLE,
    Change,
    ChangedScenario,
    Extent,
    ScenarioJob,
    changed_scenarios,
    make_jobs,
    situation,
)
from surface_gym.agents.rollout import run_episodes
from surface_gym.config import EnvConfig
from surface_gym.core.batch import BaseBatch
from surface_gym.lines import Line
from surface_gym.parcel import Disc, Rectangle
from surface_gym.tasks import TASKS, Slow
from tests.conftest import only_begin

FIXED = rules("slow")[0]
BENCHMARK = start_benchmark("slow")
EVERYTHING_EXACT = Change().preset


def true_of(change: Change, method: Method = FIXED) -> EnvConfig:
    return situation(method, start_benchmark(method.task), change).true


@pytest.mark.parametrize("task", TASKS)
def test_no_change_is_as_trained(task) -> None:
    method = next(each for each in all_methods(task) if each.most is None)
    benchmark = start_benchmark(task)
    assumed, true = situation(method, benchmark, robustness.FACTORS[TRAINED].change(TRAINED))
    assert assumed == true
    config = method.config(benchmark.task, EVERYTHING_EXACT)
    for name in ("sensors", "control_period", "zone", "actuators", "randomisation", "actions"):
        assert getattr(true, name) == getattr(config, name)
    assert (true.chosen_line, true.task.periods) == (config.chosen_line, config.task.periods)
    assert true.task_name == task


def test_friction_is_unknown_and_axes_turn_by_90_deg_in_the_time_said() -> None:
    assumed, true = situation(FIXED, BENCHMARK, Change(drag=1.2, rolling=0.5))
    line = true.chosen_line
    assert (line.mu_max, line.mu_min, line.mu_support) == pytest.approx((0.6, 0.005, 0.0025))
    assert (assumed.chosen_line.mu_max, assumed.chosen_line.mu_min) == (0.5, 0.01)
    change = robustness.FACTORS["axis"].change
    for asked in (25, 200):
        speed = true_of(change(asked)).actuators.axis_speed
        assert 0.5 * math.pi / speed == pytest.approx(1e-3 * asked)
    assert true_of(change(0)) == true_of(Change())
    for period in (0.02, 0.06, 0.12):  # an episode may last as long whatever the period
        config = true_of(Change(control_period=period))
        assert config.control_period == period
        assert period * config.task.periods == pytest.approx(0.04 * 100, abs=0.5 * period)


@pytest.mark.parametrize(("columns", "longer"), [(8, 1.0), (16, 1.0), (24, 1.5)])
def test_a_zone_has_as_many_columns_behind_it_and_an_episode_may_last_longer(
    columns, longer
) -> None:
    assumed, true = situation(FIXED, BENCHMARK, Change(zone_columns=columns))
    assert assumed == true
    line = true.chosen_line
    assert isinstance(line, Line)
    assert true.action_kind.columns == line.zone_columns == columns
    assert line.columns - line.zone_columns == Line().columns - Line().zone_columns
    assert true.task.periods == longer * Slow.periods


@pytest.mark.parametrize("task", TASKS)
def test_entries_are_aside_and_turned_by_just_so_much(task) -> None:
    poses = []
    for change in (Change(), Change(offset=0.03, turn=0.1)):
        true = true_of(change, rules(task)[0])
        env = SmartSurfaceVectorEnv(64, task=true.task, actions=true.actions, line=true.line)
        poses.append(env.reset(seed=1)[1]["pose"])
    off = poses[1] - poses[0]
    np.testing.assert_allclose(np.abs(off[:, 1]), 0.03, atol=1e-12)
    np.testing.assert_allclose(off[:, 2], off[:, 1] / 0.3, atol=1e-12)
    np.testing.assert_allclose(off[:, 0], 0.0, atol=1e-12)
    assert 0.25 < np.mean(off[:, 1] > 0.0) < 0.75


def test_modules_that_share_weights_run_on_any_zone() -> None:
    modules = next(each for each in shipped("sort") if each.name == "PPO per module")
    for columns in (8, 20):
        assumed, true = situation(modules, start_benchmark("sort"), Change(zone_columns=columns))
        starts = [{"speed": 1.5, "parcel": "S", "side": side} for side in (1, -1)]
        assert run_episodes(modules.controller(assumed, 0), true, starts, 0).success.all()


def test_loads_lie_off_centre_in_every_direction_and_boxes_are_drawn_as_ever() -> None:
    parcels = robustness.FACTORS["load"].change(5).preset.parcels
    offsets = np.array([parcel.com_offset for parcel in parcels])
    np.testing.assert_allclose(np.hypot(*offsets.T), 0.05)
    np.testing.assert_allclose(offsets.sum(axis=0), 0.0, atol=1e-12)
    half = len(parcels) // 2
    assert {parcel.rear for parcel in parcels[:half]} == {0.125}
    assert {parcel.rear for parcel in parcels[half:]} == {0.225}


@pytest.mark.parametrize("factor", robustness.FACTORS.values(), ids=robustness.FACTORS)
def test_each_level_makes_an_environment_and_the_trained_one_changes_nothing(factor) -> None:
    assert set(factor.shown) <= set(factor.swept)
    assert list(factor.levels) == sorted(factor.levels) or isinstance(factor.levels[0], str)
    for task in TASKS:
        if factor.of_lines and task == "track":
            continue
        for level in (factor.levels[0], factor.levels[-1]):
            config = true_of(factor.change(level), rules(task)[0])
            assert config.observation_space().shape
    if factor.trained is not None:
        assert factor.trained in factor.levels
        trained, task = true_of(factor.change(factor.trained)), Slow()
        assert set(trained.task.parcels) == set(task.parcels)  # some more often than once
        assert replace(trained, task=task) == replace(true_of(Change()), task=task)


def test_other_starts_make_other_results_and_slow_methods_run_on_fewer() -> None:
    planner = all_methods("slow")[-1]
    counts = [
        ChangedScenario("slow", "exact", Extent(level_starts=starts), "lab", "lab").episodes(method)
        for method, starts in ((planner, 240), (planner, 5), (FIXED, 240))
    ]
    assert counts == [40, 1, 240]


def test_the_planner_sees_the_truth() -> None:
    """By observation it takes squares of 0.5 m, partly on supports, to brake as boxes do."""
    planner = all_methods("stop")[-1]
    at = ChangedScenario("stop", "exact", Extent(level_starts=18), "square", 0.5)
    found = Sample(make_rows(ScenarioJob(at, planner, 0)()))
    assert found.success.tolist() == [[True] * 3]
    metric = start_benchmark("stop").task.metrics[0]
    assert np.median(found.metric(metric)) < 1e-3  # [m]


@pytest.mark.parametrize("task", TASKS)
def test_methods_that_run_on_any_parcel(task) -> None:
    jobs = make_jobs(changed_scenarios(task, WHOLE), all_methods(task))
    assert len({job.key for job in jobs}) == len(jobs)
    tried: dict[str, set[str]] = {}
    for job in jobs:
        assert isinstance(job.scenario, ChangedScenario)
        tried.setdefault(job.method.name, set()).add(job.scenario.factor)
    assert not tried.keys() & set(robustness.LEFT_OUT)
    assert {"fixed layout", "PPO", "DQN", PLANNER} <= tried.keys()
    wanted = set(robustness.FACTORS) - ({"zone"} if task == "track" else set())
    for name, factors in tried.items():
        assert factors == (set(robustness.PLANNED) if name == PLANNER else wanted)


@pytest.mark.usefixtures("uncompiled")
def test_shapes_of_the_lab() -> None:
    bases = (Rectangle(0.2, 0.2), Rectangle(0.2, 0.3), Disc(0.2))
    assert [*map(robustness.name_shape, bases)] == ["square", "rectangle", "disc"]
    assert set(robustness.lab_shapes("sort", 64)) == set(robustness.SHAPES)


def test_rows_name_the_shapes_of_the_lab(monkeypatch) -> None:
    with monkeypatch.context() as patch:  # they are kept, and drawing them needs no kernel
        patch.setattr(BaseBatch, "_compile", lambda _: only_begin)
        shapes = list(robustness.lab_shapes("slow", 6))
    at = ChangedScenario("slow", "lab", Extent(level_starts=6), "lab", "lab")
    rows = ScenarioJob(at, shipped("slow")[0], 0)()
    assert [row["shape"] for row in rows] == shapes
