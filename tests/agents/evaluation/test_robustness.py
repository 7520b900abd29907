"""The sweep: one thing differs, unknown to controllers where they could not know it."""

import csv
import io
import json
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents.evaluation import robustness, robustness_report as report
from surface_gym.agents.evaluation.benchmark import find_benchmark, interval
from surface_gym.agents.evaluation.methods import PLANNER, Method, all_methods, rules, shipped
from surface_gym.agents.evaluation.robustness import TRAINED, Change, situation, sweep_jobs
from surface_gym.agents.rollout import run_episodes
from surface_gym.config import EnvConfig
from surface_gym.lines import Line
from surface_gym.parcel import Disc, Rectangle
from surface_gym.tasks import TASKS, Slow
from tests.agents.evaluation.made import STARTS, sweep_result, sweep_results

FIXED = rules("slow")[0]
BENCHMARK = find_benchmark("slow")
EVERYTHING_EXACT = Change().preset


def true_of(change: Change, method: Method = FIXED) -> EnvConfig:
    return situation(method, find_benchmark(method.task), change).true


@pytest.mark.parametrize("task", TASKS)
def test_no_change_is_as_trained(task) -> None:
    method = next(each for each in all_methods(task) if each.starts is None)
    benchmark = find_benchmark(task)
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
        assumed, true = situation(modules, find_benchmark("sort"), Change(zone_columns=columns))
        starts = [{"speed": 1.5, "parcel": "S", "side": side} for side in (1, -1)]
        assert run_episodes(modules.make(assumed, 0), true, starts, 0).success.all()


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


@pytest.fixture
def two_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {
        TRAINED: robustness.FACTORS[TRAINED],
        "square": replace(robustness.FACTORS["square"], levels=(0.2, 0.4), shown=(0.4,)),
    }
    monkeypatch.setattr(robustness, "FACTORS", few)


class TestComputing:
    @pytest.mark.usefixtures("two_factors")
    def test_finished_results_are_kept(self, tmp_path, monkeypatch) -> None:
        rows = robustness.compute_sweep([FIXED], 6, 1, tmp_path)
        levels = [(row.factor, row.levels) for row in rows]
        assert levels == [(TRAINED, [TRAINED]), ("square", [0.2, 0.4])]
        assert all(len(line) == row.starts == 6 for row in rows for line in row.success)
        monkeypatch.setattr(robustness, "run_episodes", None)  # nothing is left to compute
        assert robustness.compute_sweep([FIXED], 6, 1, tmp_path) == rows
        assert len((tmp_path / robustness.FILE).read_text().splitlines()) == 2

    def test_other_starts_make_other_results_and_slow_methods_run_on_fewer(self) -> None:
        jobs = sweep_jobs([FIXED], 6)
        assert not jobs.keys() & sweep_jobs([FIXED], 7).keys()
        assert pickle.loads(pickle.dumps(jobs)).keys() == jobs.keys()  # sent to other processes
        planner = all_methods("slow")[-1]
        given = ((planner, 240), (planner, 5), (FIXED, 240))
        assert [robustness.starts_for(*each) for each in given] == [40, 1, 240]
        assert next(iter(sweep_jobs([FIXED, planner], 240)))[1] == PLANNER

    def test_the_planner_sees_the_truth(self) -> None:
        """By observation it takes squares of 0.5 m, partly on supports, to brake as boxes do."""
        planner = all_methods("stop")[-1]
        assert planner.name == PLANNER
        row = robustness.compute_factor(planner, 0, "square", (0.5,), 3)
        assert row.success == ["111"]
        assert row.error[0] < 1e-3  # [m]

    @pytest.mark.parametrize("task", TASKS)
    def test_methods_that_run_on_any_parcel(self, task) -> None:
        chosen = robustness.can_sweep(all_methods(task))
        names = {each.name for each in chosen}
        assert not names & set(robustness.LEFT_OUT)
        assert {"fixed layout", "PPO", "DQN", PLANNER} <= names
        factors = robustness.FACTORS
        wanted = set(factors) - ({"zone"} if task == "track" else set())
        for method in chosen:
            tried = {name for name in factors if robustness.levels_for(method, factors[name])}
            assert tried == (set(robustness.PLANNED) if method.name == PLANNER else wanted)


SQUARE = robustness.FACTORS["square"]
ROWS = [
    *sweep_results("slow", {"fixed layout": 0.25, "PPO": 0.5, "PPO, lab": 1.0}, seeds=2),
    *sweep_results("track", {"PPO": 0.75}),
    sweep_result("slow", PLANNER, robustness.FACTORS[TRAINED], 1.0, starts=6),
    sweep_result("slow", PLANNER, SQUARE, 1.0, levels=SQUARE.shown, starts=6),
]
SWEEP = robustness.Sweep(tuple(ROWS))


class TestReport:
    def test_rates_have_the_interval_of_their_seeds_and_starts(self) -> None:
        success = SWEEP.success("slow", "PPO", "load", 1)
        assert success.shape == (2, STARTS)
        rate = SWEEP.rate("slow", "PPO", "load", 1)
        assert (rate.value, rate.low, rate.high) == (success.mean(), *interval(success))
        # The level that is as trained is the same for every factor.
        trained = SWEEP.rate("slow", "PPO", TRAINED, TRAINED)
        for factor in robustness.FACTORS.values():
            if factor.trained is not None:
                assert SWEEP.rate("slow", "PPO", factor.name, factor.trained) == trained
        assert SWEEP.rate("slow", "nobody", TRAINED, TRAINED) is None
        assert SWEEP.rate("track", "PPO", "zone", 8) is None

    def test_a_row_for_each_method_and_a_column_for_each_factor(self) -> None:
        table = report.factor_table(SWEEP, "slow")
        assert [row[0] for row in table.rows] == ["fixed layout", "PPO", "PPO, lab", PLANNER]
        squares = "square: 0.15 / 0.2 / 0.3 / 0.35 / 0.4 / 0.5 m"
        assert table.header[1:3] == ("as trained", squares)
        fixed = dict(zip(table.header, table.rows[0], strict=True))
        assert (fixed["as trained"], fixed["stuck modules: 2 / 10 %"]) == ("0.25", "0.25 / 0.12")
        assert table.rows[-1][-1] == "-"
        assert "24 starts (planner: 6)" in table.caption
        assert not any("zone" in name for name in report.factor_table(SWEEP, "track").header)

    def test_squares_beside_the_planners(self) -> None:
        rows = {row[0]: row[1:] for row in report.square_table(SWEEP, "slow").rows}
        assert (rows["PPO, lab"][0], rows[PLANNER][2]) == ("0.50 at 0.49", "1.00")
        shares = []
        for level in SQUARE.shown:
            own, best = (SWEEP.success("slow", name, "square", level) for name in ("PPO", PLANNER))
            assert best.shape == (1, 6)
            shares.append(own[:, :6].mean() / best.mean())
        assert rows["PPO"][2] == f"{min(shares):.2f}"
        assert report.square_table(SWEEP, "track").rows[0][-1] == "-"

    def test_the_lab_by_shape(self) -> None:
        shapes = robustness.lab_shapes("slow", STARTS)
        success = SWEEP.success("slow", "PPO", robustness.LAB, robustness.LAB)
        found = SWEEP.by_shape("slow", "PPO")
        assert set(found) == set(shapes)
        for shape, rate in found.items():
            assert rate.value == success[:, np.array(shapes) == shape].mean()
        table = report.shape_table(SWEEP, "slow")
        assert table.header[2:] == robustness.SHAPES
        assert PLANNER not in [row[0] for row in table.rows]
        bases = (Rectangle(0.2, 0.2), Rectangle(0.2, 0.3), Disc(0.2))
        assert [*map(robustness.name_shape, bases)] == ["square", "rectangle", "disc"]
        assert set(robustness.lab_shapes("sort", 64)) == set(robustness.SHAPES)

    def test_files_agree(self, tmp_path) -> None:
        report.write_sweep(ROWS, tmp_path, Console(file=io.StringIO(), width=160))
        numbers = json.loads((tmp_path / "robustness.json").read_text())
        with (tmp_path / "robustness.csv").open(newline="") as file:
            lines = list(csv.DictReader(file))
        assert [line["success"] for line in lines] == [str(each["success"]) for each in numbers]
        key, wanted = ("task", "controller", "factor"), ["slow", "PPO", "square"]
        squares = [each["level"] for each in numbers if [each[name] for name in key] == wanted]
        assert squares == list(SQUARE.levels)
        text = (tmp_path / "robustness.md").read_text()
        assert "## Slow: lab" in text
        assert "## Track: squares" in text
        assert (tmp_path / report.PICTURE).read_bytes().startswith(b"\x89PNG")
