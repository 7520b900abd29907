"""The sweep: one thing differs, unknown to controllers where they could not know it."""

import csv
import io
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents.evaluation import robustness
from surface_gym.agents.evaluation.benchmark import compute_kept, find_benchmark, interval
from surface_gym.agents.evaluation.methods import PLANNER, Method, all_methods, rules, shipped
from surface_gym.agents.evaluation.robustness import (
    FACTORS,
    FILE,
    LAB,
    LEFT_OUT,
    PLANNED,
    SHAPES,
    TRAINED,
    Change,
    Sweep,
    SweepResult,
    can_sweep,
    compute_factor,
    compute_sweep,
    lab_shapes,
    levels_for,
    name_shape,
    situation,
    starts_for,
    sweep_jobs,
)
from surface_gym.agents.evaluation.robustness_report import (
    PICTURE,
    STYLES,
    draw_sweep,
    factor_table,
    find_style,
    shape_table,
    square_table,
    write_sweep,
)
from surface_gym.agents.rollout import run_episodes
from surface_gym.config import EnvConfig
from surface_gym.lines import Line
from surface_gym.parcel import Disc, Rectangle
from surface_gym.tasks import TASKS, Slow
from tests.agents.evaluation.made import STARTS, sweep_result, sweep_results

SLOW = rules("slow")[0]
BENCHMARK = find_benchmark("slow")
EVERYTHING_EXACT = Change().preset


def true_of(change: Change, method: Method = SLOW) -> EnvConfig:
    return situation(method, find_benchmark(method.task), change).true


def starts_of(settings: EnvConfig, count: int = 64) -> np.ndarray:
    """(count, 3) poses that an environment begins at."""
    env = SmartSurfaceVectorEnv(
        count, task=settings.task, actions=settings.actions, line=settings.line
    )
    return env.reset(seed=1)[1]["pose"]


@pytest.mark.parametrize("task", TASKS)
def test_no_change_is_as_trained(task: str) -> None:
    method = next(each for each in all_methods(task) if each.starts is None)
    benchmark = find_benchmark(task)
    assumed, true = situation(method, benchmark, FACTORS[TRAINED].change(TRAINED))
    assert assumed == true
    settings = method.config(benchmark.task, EVERYTHING_EXACT)
    for name in ("sensors", "control_period", "zone", "actuators", "randomisation", "actions"):
        assert getattr(true, name) == getattr(settings, name)
    assert true.chosen_line == settings.chosen_line
    assert true.task.periods == settings.task.periods
    assert true.task_name == task


def test_an_unchanged_environment_plays_the_same() -> None:
    settings = SLOW.config(BENCHMARK.task, EVERYTHING_EXACT)
    (first, second) = (
        run_episodes(SLOW.make(each, 0), each, [{}] * 8, 3)
        for each in (settings, true_of(Change()))
    )
    np.testing.assert_array_equal(first.pose, second.pose)


def test_friction_is_unknown() -> None:
    assumed, true = situation(SLOW, BENCHMARK, Change(drag=1.2, rolling=0.5))
    line = true.chosen_line
    assert (line.mu_max, line.mu_min, line.mu_support) == pytest.approx((0.6, 0.005, 0.0025))
    assert (assumed.chosen_line.mu_max, assumed.chosen_line.mu_min) == (0.5, 0.01)


def test_a_zone_has_as_many_columns_behind_it_as_ever() -> None:
    for columns in (8, 24):
        assumed, true = situation(SLOW, BENCHMARK, Change(zone_columns=columns))
        assert assumed == true
        line = true.chosen_line
        assert isinstance(line, Line)
        assert true.action_kind.columns == line.zone_columns == columns
        assert line.columns - line.zone_columns == Line().columns - Line().zone_columns


def test_an_episode_may_last_the_longer_where_the_zone_is() -> None:
    periods = [true_of(Change(zone_columns=n)).task.periods for n in (8, 16, 24)]
    assert periods == [Slow.periods, Slow.periods, 1.5 * Slow.periods]


def test_an_episode_may_last_as_long_whatever_the_period() -> None:
    for period in (0.02, 0.06, 0.12):
        settings = true_of(Change(control_period=period))
        assert settings.control_period == period
        lasts = settings.control_period * settings.task.periods
        assert lasts == pytest.approx(0.04 * Slow.periods, abs=0.5 * period)
    assert Slow.periods == 100


@pytest.mark.parametrize("task", TASKS)
def test_entries_are_aside_and_turned_by_just_so_much(task: str) -> None:
    method = rules(task)[0]
    straight = starts_of(true_of(Change(), method))
    moved = starts_of(true_of(Change(offset=0.03, turn=0.1), method))
    off = moved - straight
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
    parcels = FACTORS["load"].change(5).preset.parcels
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
    assert set(factor.shown) <= set(factor.swept)
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
    assert set(trained.task.parcels) == set(task.parcels)  # some more often than once
    assert replace(trained, task=task) == replace(true_of(Change()), task=task)


FIXED = rules("slow")[0]


@pytest.fixture
def two_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {
        TRAINED: FACTORS[TRAINED],
        "square": replace(FACTORS["square"], levels=(0.2, 0.4), shown=(0.4,)),
    }
    monkeypatch.setattr(robustness, "FACTORS", few)


class TestComputing:
    @pytest.mark.usefixtures("two_factors")
    def test_finished_results_are_kept(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        rows = compute_sweep([FIXED], 6, 1, tmp_path)
        assert [(row.factor, row.levels) for row in rows] == [
            (TRAINED, [TRAINED]),
            ("square", [0.2, 0.4]),
        ]
        assert all(len(line) == row.starts == 6 for row in rows for line in row.success)
        monkeypatch.setattr(robustness, "run_episodes", None)  # nothing is left to compute
        assert compute_sweep([FIXED], 6, 1, tmp_path) == rows
        assert len((tmp_path / FILE).read_text().splitlines()) == 2

    @pytest.mark.usefixtures("two_factors")
    def test_other_starts_make_other_results(self) -> None:
        assert not sweep_jobs([FIXED], 6).keys() & sweep_jobs([FIXED], 7).keys()

    def test_processes_make_no_difference(self, tmp_path: Path) -> None:
        (few,) = (each for each in rules("stop") if each.name == "fixed layout")
        factors = ("trained", "aside")
        alone = [compute_factor(few, 0, name, FACTORS[name].swept, 4) for name in factors]
        jobs = {key: job for key, job in sweep_jobs([few], 4).items() if key[2] in factors}
        shared = compute_kept(jobs, SweepResult, 2, tmp_path / FILE, lambda *_: None)
        assert list(shared.values()) == alone

    def test_the_planner_sees_the_truth(self) -> None:
        """By observation it takes squares of 0.5 m, partly on supports, to brake as boxes do."""
        planner = all_methods("stop")[-1]
        assert planner.name == PLANNER
        row = compute_factor(planner, 0, "square", (0.5,), 3)
        assert row.success == ["111"]
        assert row.error[0] < 1e-3  # [m]

    @pytest.mark.parametrize("task", TASKS)
    def test_methods_that_run_on_any_parcel(self, task: str) -> None:
        chosen = can_sweep(all_methods(task))
        names = {each.name for each in chosen}
        assert not names & set(LEFT_OUT)
        assert {"fixed layout", "PPO", "DQN", PLANNER} <= names
        for method in chosen:
            tried = {name for name, factor in FACTORS.items() if levels_for(method, factor)}
            wanted = set(FACTORS) - ({"zone"} if task == "track" else set())
            assert tried == (set(PLANNED) if method.name == PLANNER else wanted)

    def test_slow_methods_run_on_fewer_starts(self) -> None:
        planner = all_methods("slow")[-1]
        assert starts_for(planner, 240) == 40
        assert starts_for(planner, 5) == 1
        assert starts_for(FIXED, 240) == 240
        first = next(iter(sweep_jobs([FIXED, planner], 240)))
        assert first[1] == PLANNER


SQUARE = FACTORS["square"]
ROWS = [
    *sweep_results("slow", {"fixed layout": 0.25, "PPO": 0.5, "PPO, lab": 1.0}, seeds=2),
    *sweep_results("track", {"PPO": 0.75}),
    sweep_result("slow", PLANNER, FACTORS[TRAINED], 1.0, starts=6),
    sweep_result("slow", PLANNER, SQUARE, 1.0, levels=SQUARE.shown, starts=6),
]
SWEEP = Sweep(tuple(ROWS))


class TestReport:
    def test_rates_have_the_interval_of_their_seeds_and_starts(self) -> None:
        success = SWEEP.success("slow", "PPO", "load", 1)
        assert success is not None
        assert success.shape == (2, STARTS)
        rate = SWEEP.rate("slow", "PPO", "load", 1)
        assert rate is not None
        assert (rate.value, rate.low, rate.high) == (success.mean(), *interval(success))

    def test_the_level_that_is_as_trained_is_the_same_for_every_factor(self) -> None:
        trained = SWEEP.rate("slow", "PPO", TRAINED, TRAINED)
        for factor in FACTORS.values():
            if factor.trained is not None:
                assert SWEEP.rate("slow", "PPO", factor.name, factor.trained) == trained
        assert SWEEP.rate("slow", "nobody", TRAINED, TRAINED) is None
        assert SWEEP.rate("track", "PPO", "zone", 8) is None

    def test_a_row_for_each_method_and_a_column_for_each_factor(self) -> None:
        table = factor_table(SWEEP, "slow")
        assert [row[0] for row in table.rows] == ["fixed layout", "PPO", "PPO, lab", PLANNER]
        squares = "square: 0.15 / 0.2 / 0.3 / 0.35 / 0.4 / 0.5 m"
        assert table.header[1:3] == ("as trained", squares)
        fixed = dict(zip(table.header, table.rows[0], strict=True))
        assert fixed["as trained"] == "0.25"
        assert fixed["stuck modules: 2 / 10 %"] == "0.25 / 0.12"
        assert table.rows[-1][-1] == "-"
        assert "24 starts (planner: 6)" in table.caption
        assert not any("zone" in name for name in factor_table(SWEEP, "track").header)

    def test_squares_beside_the_planners(self) -> None:
        rows = {row[0]: row[1:] for row in square_table(SWEEP, "slow").rows}
        assert rows["PPO, lab"][0] == "0.50 at 0.49"
        assert rows[PLANNER][2] == "1.00"
        shares = []
        for level in SQUARE.shown:
            own, best = (SWEEP.success("slow", name, "square", level) for name in ("PPO", PLANNER))
            assert own is not None
            assert best is not None
            assert best.shape == (1, 6)
            shares.append(own[:, :6].mean() / best.mean())
        assert rows["PPO"][2] == f"{min(shares):.2f}"
        assert square_table(SWEEP, "track").rows[0][-1] == "-"

    def test_the_lab_by_shape(self) -> None:
        shapes = lab_shapes("slow", STARTS)
        success = SWEEP.success("slow", "PPO", LAB, LAB)
        assert success is not None
        found = SWEEP.by_shape("slow", "PPO")
        assert set(found) == set(shapes)
        for shape, rate in found.items():
            assert rate.value == success[:, np.array(shapes) == shape].mean()
        table = shape_table(SWEEP, "slow")
        assert table.header[2:] == SHAPES
        assert PLANNER not in [row[0] for row in table.rows]

    def test_shapes_have_names(self) -> None:
        assert name_shape(Rectangle(0.2, 0.2)) == "square"
        assert name_shape(Rectangle(0.2, 0.3)) == "rectangle"
        assert name_shape(Disc(0.2)) == "disc"
        assert set(lab_shapes("sort", 64)) == set(SHAPES)

    def test_files_agree(self, tmp_path: Path) -> None:
        write_sweep(ROWS, tmp_path, Console(file=io.StringIO(), width=160))
        numbers = json.loads((tmp_path / "robustness.json").read_text())
        with (tmp_path / "robustness.csv").open(newline="") as file:
            lines = list(csv.DictReader(file))
        assert [line["success"] for line in lines] == [str(each["success"]) for each in numbers]
        squares = [
            number["level"]
            for number in numbers
            if (number["task"], number["controller"], number["factor"]) == ("slow", "PPO", "square")
        ]
        assert squares == list(SQUARE.levels)
        text = (tmp_path / "robustness.md").read_text()
        assert "## Slow: lab" in text
        assert "## Track: squares" in text
        assert (tmp_path / PICTURE).read_bytes().startswith(b"\x89PNG")

    def test_the_picture_is_the_same_each_time(self, tmp_path: Path) -> None:
        small = Sweep(tuple(row for row in ROWS if row.task == "track"))
        for name in ("a.png", "b.png"):
            draw_sweep(small, tmp_path / name)
        assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()

    def test_an_agent_of_the_lab_has_its_algorithms_colour(self) -> None:
        nominal, lab = find_style("PPO"), find_style("PPO, lab")
        assert nominal.colour == lab.colour
        assert lab.width > nominal.width
        assert lab.label == "PPO, trained for the lab"
        assert find_style("all at 45").label == "all at 45"
        assert len({style.colour for style in STYLES.values()}) == 8  # rules of a task share one
