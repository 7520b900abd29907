"""Benchmarks: starts, results that are kept, and the summaries that they make."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents import library
from surface_gym.agents.evaluation import benchmark as runs
from surface_gym.agents.evaluation.methods import Method, all_methods, of_run, rules, shipped
from surface_gym.agents.learning.algorithms import PPOConfig
from surface_gym.agents.learning.runs import CONFIG, write_config
from surface_gym.agents.library import PolicyCard, save_policy
from surface_gym.agents.policy import make_network
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS
from tests.agents.evaluation.made import GRID, slow_result, sort_result

LAB = PRESETS["lab"]
PARCELS_ALONE = Preset("parcels", "parcels", "The lab's parcels.", parcels=LAB.parcels)
FIXED = runs.Summary((sort_result("fixed layout", {"S": 0.72, "B": 1.0}),))


def few() -> list[Method]:
    return [replace(each.under("exact", "stuck"), starts=2) for each in rules("slow")]


def apart_from_time(results: list[runs.Result]) -> list[runs.Result]:
    return [replace(result, decision_time=0.0) for result in results]


class TestComputing:
    def test_processes_make_no_difference(self, tmp_path) -> None:
        alone = runs.compute_results(few(), 1)
        shared = runs.compute_results(few(), 2, tmp_path)
        assert apart_from_time(alone) == apart_from_time(shared)
        names = ("fixed layout", "best fixed layout", "braking rule")
        assert [each.method for each in alone] == [name for name in names for _ in range(2)]
        assert [each.preset for each in alone] == ["exact", "stuck"] * 3

    def test_finished_results_are_kept(self, tmp_path, monkeypatch) -> None:
        first = runs.compute_results(few()[:1], 1, tmp_path)
        with (tmp_path / runs.FILE).open("a") as file:
            file.write('{"task": "slow", "method"')  # a line broken off
        assert runs.read_kept(tmp_path / runs.FILE, runs.Result) == first
        seen: list[tuple[int, int]] = []
        again = runs.compute_results(few(), 1, tmp_path, lambda *given: seen.append(given[:2]))
        assert (again[:2], seen) == (first, [(3, 6), (4, 6), (5, 6), (6, 6)])
        monkeypatch.setattr(runs, "run_episodes", None)  # nothing is left to compute
        assert runs.compute_results(few(), 1, tmp_path) == again

    @pytest.mark.parametrize("task", TASKS)
    def test_methods_of_a_task(self, task) -> None:
        methods = all_methods(task)
        names = [method.name for method in methods]
        assert (names[:2], names[-1]) == (["fixed layout", "best fixed layout"], "planner")
        assert {"PPO", "DQN"} < set(names)
        assert ("fixed layout, any angle" in names, len(set(names))) == (task == "sort", len(names))
        assert all(len(each.seeds) >= 3 for each in methods if each.name in ("PPO", "DQN"))
        jobs = runs.list_jobs(methods)
        assert [preset for each, _, preset in jobs if each.name == "planner"] == ["exact"]
        searching = [method.starts is not None for method, _, _ in jobs]
        assert searching == sorted(searching, reverse=True)  # the slowest first


class TestStarts:
    @pytest.mark.parametrize("task", TASKS)
    def test_a_preset_with_parcels_leaves_them_open_and_keeps_the_rest(self, task) -> None:
        benchmark = runs.find_benchmark(task)
        assert runs.choose_starts(benchmark, None, PRESETS["camera"]) is benchmark.starts
        opened = runs.choose_starts(benchmark, None, LAB)
        assert len(opened) == len(benchmark.starts) > 480
        for before, after in zip(benchmark.starts, opened, strict=True):
            assert {**after, "parcel": before.get("parcel")} == {"parcel": None, **before}
            assert "parcel" not in after

    def test_some_are_spread_evenly(self) -> None:
        benchmark = runs.find_benchmark("sort")
        some = runs.choose_starts(benchmark, 3, PRESETS["exact"])
        assert [start["parcel"] for start in some] == ["S", "B", "B"]
        assert (some[0], some[-1]) == (benchmark.starts[0], benchmark.starts[-1])

    def test_parcels_are_those_that_the_environment_draws(self) -> None:
        """A parcel enters with its rear at x = 0; a start that names its parcel has it."""
        starts = runs.choose_starts(runs.find_benchmark("sort"), None, LAB)[::7]
        drawn = runs.drawn_parcels(EnvConfig(preset=PARCELS_ALONE), starts, runs.SEED)
        env = SmartSurfaceVectorEnv(len(starts), preset=PARCELS_ALONE)
        _, info = env.reset(seed=runs.SEED, options=list(starts))
        from_rear = [parcel.base.centroid[0] - parcel.base.outline[:, 0].min() for parcel in drawn]
        np.testing.assert_allclose(info["pose"][:, 0], from_rear, atol=1e-12)
        assert len(set(drawn)) > 0.3 * len(starts)
        named = runs.drawn_parcels(EnvConfig("sort", preset=LAB), [{"parcel": "S"}] * 3, runs.SEED)
        assert [parcel.rear for parcel in named] == [0.125] * 3


def test_sort_in_the_lab() -> None:
    event = next(rule for rule in rules("sort") if rule.name == "event rule")
    result, _ = runs.play(event, 0, "lab")
    assert len(result.success) == len(runs.find_benchmark("sort").starts)
    assert np.mean(result.success) > 0.9
    assert min(result.metrics["columns"]) >= 0
    summary = runs.Summary((result,))
    columns = runs.find_benchmark("sort").columns
    values = {column.name: summary.value(column, summary) for column in columns}
    of_boxes = [value for name, value in values.items() if name[-2:] in ("_S", "_B")]
    assert [math.isnan(value) for value in of_boxes] == [True] * 6
    assert 3.0 < values["columns"] < 16.0
    assert values["parcels_an_hour"] > 1000.0


def _leave(folder: Path, task: str, observe: tuple[str, ...] = ()) -> None:
    """A policy that has learned nothing."""
    card = PolicyCard(env_id(task), "ppo", "halves", 0.04, (8,), observe)
    folder.mkdir(parents=True)
    save_policy(make_network(card, card.env_config()).state_dict(), card, folder)


def test_agents_of_a_preset_are_found_among_the_shipped(tmp_path, monkeypatch) -> None:
    """And a run is named by its preset."""
    for name, observe in (("slow-ppo-lab", ("parcel", "rotors")), ("slow-ppo", ())):
        for seed in (0, 1):
            _leave(tmp_path / name / f"seed-{seed}", "slow", observe)
        (tmp_path / name / "card.yaml").touch()
    monkeypatch.setattr(library, "SHELF", tmp_path)
    nominal, lab = shipped("slow")
    assert (nominal.name, nominal.observe) == ("PPO", ())
    assert (lab.name, lab.observe, lab.seeds) == ("PPO, lab", ("parcel", "rotors"), (0, 1))
    config = lab.config(TASKS["slow"](), LAB)
    env = SmartSurfaceVectorEnv(2, "slow", actions="halves", observe=config.observe, preset=LAB)
    observation, _ = env.reset(seed=0)
    assert lab.make(config, 1).predict(observation)[0] in env.action_space

    run = tmp_path / "slow-ppo-lab" / "seed-0"
    assert of_run(run).name == "PPO"
    write_config(PPOConfig(task="slow", preset="lab", observe=("parcel", "rotors")), run / CONFIG)
    assert (of_run(run).name, of_run(run).observe) == ("PPO, lab", ("parcel", "rotors"))


class TestSummaries:
    def test_the_minimum_is_that_of_the_worst_seed(self) -> None:
        """One failure above moves it beyond that."""
        result = sort_result("a", {"S": 0.36, "B": 0.52})
        two = runs.Summary((result, sort_result("a", {"S": 0.4, "B": 0.52}, seed=1)))
        assert (GRID.minimum_speed(two, "S"), GRID.minimum_speed(two, "B")) == (0.4, 0.52)
        success = np.array(result.success).reshape(GRID.shape)
        success[0, 60, 1] = False  # the S-box at 1.5 m/s, to y < 0
        holed = runs.Summary((replace(result, success=success.ravel().tolist()),))
        assert (GRID.minimum_speed(holed, "S"), GRID.minimum_speed(holed, "B")) == (1.52, 0.52)
        assert np.isinf(GRID.slower_time(holed, "S")[0, 60])
        success[0, -1] = False
        never = runs.Summary((replace(result, success=success.ravel().tolist()),))
        assert math.isnan(GRID.minimum_speed(never, "S"))

    def test_time_is_divided_by_the_fixed_layouts_where_that_one_sorts(self) -> None:
        faster = runs.Summary((sort_result("a", {"S": 0.36, "B": 0.52}, time=0.9),))
        assert GRID.worst_time(faster, FIXED, "S") == pytest.approx(0.9)
        less_able = runs.Summary((sort_result("a", {"S": 1.0, "B": 0.52}),))
        assert GRID.worst_time(less_able, FIXED, "S") == np.inf

    def test_rates_columns_and_throughput(self) -> None:
        columns = {each.name: each for each in runs.find_benchmark("sort").columns}
        speeds = GRID.speeds
        assert GRID.success_rate(FIXED, "B") == np.mean(speeds >= 1.0 - 1e-9)
        assert FIXED.value(columns["columns"], FIXED) == 4.0
        sorted_at = np.concatenate([speeds[speeds > 0.71], speeds[speeds > 0.99]])
        assert FIXED.value(columns["parcels_an_hour"], FIXED) == pytest.approx(
            3600.0 / (1.0 / sorted_at).mean()
        )

    def test_all_seeds_are_one_summary(self) -> None:
        results = [slow_result("a", [0.001, -0.02], seed=seed) for seed in (0, 1)]
        results.append(slow_result("b", [0.0, 0.0]))
        summaries = runs.summarise(results)
        assert list(summaries) == [("slow", "a", "exact"), ("slow", "b", "exact")]
        first = summaries["slow", "a", "exact"]
        assert first.rate == 0.5
        assert first.success.shape == (2, 2)
        np.testing.assert_array_equal(first.metric("ratio_error"), [[0.001, 0.02]] * 2)


@pytest.mark.parametrize(("successes", "count"), [(0, 20), (7, 20), (20, 20), (480, 500)])
def test_one_seed_has_wilsons_interval(successes, count) -> None:
    known = binomtest(successes, count).proportion_ci(method="wilson")
    wilson = runs.wilson(successes / count, count)
    assert wilson == pytest.approx((known.low, known.high), abs=1e-12)
    found = runs.interval(np.arange(count)[np.newaxis] < successes)
    # A sample's spread counts one start less.
    assert found == pytest.approx((known.low, known.high), abs=0.01)
    assert runs.half_interval(np.arange(3.0)) == pytest.approx(4.302653 / 3**0.5)  # Student's t
    # Round-off takes it not beyond what a share can be.
    for size in range(1, 100):
        low, high = runs.wilson(successes / count, size)
        assert 0.0 <= low <= high <= 1.0


def test_seeds_alike_are_no_surer_than_one_and_a_seed_that_fails_widens_it() -> None:
    one = np.random.default_rng(0).random((1, 400)) < 0.9
    assert runs.interval(np.repeat(one, 3, axis=0)) == pytest.approx(runs.interval(one), abs=1e-12)
    low, high = runs.interval(np.repeat([[True], [True], [False]], 500, axis=1))
    assert low < 0.2
    assert high > 0.9


def test_it_holds_the_truth_about_as_often_as_it_says() -> None:
    """Seeds and starts of their own difficulty, drawn anew many times."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(400):
        chance = 0.8 + 0.05 * rng.standard_normal((5, 1)) + 0.1 * rng.standard_normal((1, 200))
        low, high = runs.interval(rng.random((5, 200)) < chance)
        held += low <= 0.8 <= high
    assert held / 400 > 0.88
