"""The table of results: samples, intervals, its file, and jobs that fill it, each once."""

import io
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from scipy.stats import binomtest

from surface_gym.agents.evaluation import results as res
from surface_gym.agents.evaluation.method import Method, all_methods, rules, start_benchmark
from surface_gym.agents.evaluation.results import Sample
from surface_gym.agents.evaluation.scenario import (
    STARTS,
    WHOLE,
    Row,
    Scenario,
    ScenarioJob,
    make_jobs,
    start_scenarios,
)
from surface_gym.agents.evaluation.views import column_value
from tests.agents.evaluation.made import GRID, results, slow_rows, sort_rows, stream_rows

FIXED = Sample(sort_rows("fixed layout", {"S": 0.72, "B": 1.0}))
KEY = ("merge", "three lines", "exact", "one")


class TestStarts:
    def test_the_minimum_is_that_of_the_worst_seed(self) -> None:
        """One failure above moves it beyond that."""
        rows = sort_rows("a", {"S": 0.36, "B": 0.52})
        two = Sample(pd.concat([rows, sort_rows("a", {"S": 0.4, "B": 0.52}, seed=1)]))
        assert (GRID.minimum_speed(two, "S"), GRID.minimum_speed(two, "B")) == (0.4, 0.52)
        success = rows["success"].to_numpy().reshape(GRID.shape).copy()
        success[0, 60, 1] = 0.0  # the S-box at 1.5 m/s, to y < 0
        holed = Sample(rows.assign(success=success.ravel()))
        assert (GRID.minimum_speed(holed, "S"), GRID.minimum_speed(holed, "B")) == (1.52, 0.52)
        assert np.isinf(GRID.slower_time(holed, "S")[0, 60])
        success[0, -1] = 0.0
        assert math.isnan(GRID.minimum_speed(Sample(rows.assign(success=success.ravel())), "S"))

    def test_time_is_divided_by_the_fixed_layouts_where_that_one_sorts(self) -> None:
        faster = Sample(sort_rows("a", {"S": 0.36, "B": 0.52}, time=0.9))
        assert GRID.worst_time(faster, FIXED, "S") == pytest.approx(0.9)
        less_able = Sample(sort_rows("a", {"S": 1.0, "B": 0.52}))
        assert GRID.worst_time(less_able, FIXED, "S") == np.inf

    def test_rates_columns_and_throughput(self) -> None:
        columns = {each.name: each for each in start_benchmark("sort").columns}
        speeds = GRID.speeds
        assert GRID.success_rate(FIXED, "B") == np.mean(speeds >= 1.0 - 1e-9)
        assert column_value(columns["columns"], FIXED, FIXED) == 4.0
        sorted_at = np.concatenate([speeds[speeds > 0.71], speeds[speeds > 0.99]])
        assert column_value(columns["parcels_an_hour"], FIXED, FIXED) == pytest.approx(
            3600.0 / (1.0 / sorted_at).mean()
        )
        # On other parcels, columns of both boxes have no value.
        lab = Sample(sort_rows("a", {"S": 0.36, "B": 0.52}, preset="lab"))
        values = {name: column_value(each, lab, FIXED) for name, each in columns.items()}
        assert [math.isnan(v) for k, v in values.items() if k[-2:] in ("_S", "_B")] == [True] * 6
        # Nor have they on a few of the starts, as of a quick comparison.
        few = Sample(FIXED.rows[::40])
        values = {name: column_value(each, few, few) for name, each in columns.items()}
        assert [math.isnan(v) for k, v in values.items() if k[-2:] in ("_S", "_B")] == [True] * 6

    def test_all_seeds_are_one_sample(self) -> None:
        made = results(
            *(slow_rows("a", [0.001, -0.02], seed=seed) for seed in (0, 1)),
            slow_rows("b", [0.0, 0.0]),
        )
        assert list(made.samples) == [("slow", STARTS, "exact", name) for name in "ab"]
        first = made.samples["slow", STARTS, "exact", "a"]
        assert (first.rate, first.success.shape, first.seeds) == (0.5, (2, 2), (0, 1))
        np.testing.assert_array_equal(first.metric("ratio_error"), [[0.001, 0.02]] * 2)
        assert np.isnan(first.values("nothing")).all()
        assert made.methods("slow") == ["a", "b"]
        assert made.at("slow", STARTS, "lab") == {}


class TestStreams:
    def test_figures_are_those_of_all_replications(self) -> None:
        found = Sample(
            stream_rows(
                KEY, [10, 12], counted=20.0, delivered=[10, 15],
                touches_per_1000=[100.0, 0.0],
            )
        )  # fmt: skip
        assert (found.rates.tolist(), found.throughput) == ([1800.0, 2160.0], pytest.approx(1980.0))
        assert found.share_correct == pytest.approx(22 / 25)
        assert found.touches == pytest.approx(1.0)
        # Two values: half the interval is 12.706 of the mean's standard error.
        assert found.margin == pytest.approx(12.706 * 180.0, rel=1e-4)
        assert found.mean("touches_per_1000") == pytest.approx(40.0)  # by the parcels delivered
        assert math.isnan(found.mean("correct_gaps"))

    def test_of_several_seeds_each_counts_alike(self) -> None:
        one = stream_rows(KEY, [10, 20], jam=[1, 0], squeeze_most=[5.0, 9.0])
        other = stream_rows(KEY, [20, 40], seed=1, squeeze_most=[7.0, 1.0])
        found = Sample(pd.concat([one, other]))
        assert found.of_seeds.mean(axis=1).tolist() == [1500.0, 3000.0]
        assert found.rates.tolist() == [1500.0, 3000.0]
        assert (found.jams, found.most("squeeze_most")) == (0.5, 9.0)

    def test_no_rate_is_sustained(self) -> None:
        found = Sample(stream_rows(KEY, [math.nan] * 2))
        assert (found.is_sustained, found.throughput) == (False, 0.0)


@pytest.mark.parametrize(("successes", "count"), [(0, 20), (7, 20), (20, 20), (480, 500)])
def test_one_seed_has_wilsons_interval(successes, count) -> None:
    known = binomtest(successes, count).proportion_ci(method="wilson")
    wilson = res.wilson(successes / count, count)
    assert wilson == pytest.approx((known.low, known.high), abs=1e-12)
    found = res.interval(np.arange(count)[np.newaxis] < successes)
    # A sample's spread counts one start less.
    assert found == pytest.approx((known.low, known.high), abs=0.01)
    assert res.half_interval(np.arange(3.0)) == pytest.approx(4.302653 / 3**0.5)  # Student's t
    assert math.isnan(res.half_interval(np.ones(1)))
    # Round-off takes it not beyond what a share can be.
    for size in range(1, 100):
        low, high = res.wilson(successes / count, size)
        assert 0.0 <= low <= high <= 1.0


def test_seeds_alike_are_no_surer_than_one_and_a_seed_that_fails_widens_it() -> None:
    one = np.random.default_rng(0).random((1, 400)) < 0.9
    assert res.interval(np.repeat(one, 3, axis=0)) == pytest.approx(res.interval(one), abs=1e-12)
    low, high = res.interval(np.repeat([[True], [True], [False]], 500, axis=1))
    assert low < 0.2
    assert high > 0.9


def test_it_holds_the_truth_about_as_often_as_it_says() -> None:
    """Seeds and starts of their own difficulty, drawn anew many times."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(400):
        chance = 0.8 + 0.05 * rng.standard_normal((5, 1)) + 0.1 * rng.standard_normal((1, 200))
        low, high = res.interval(rng.random((5, 200)) < chance)
        held += low <= 0.8 <= high
    assert held / 400 > 0.88


class TestFile:
    ROWS = pd.concat([stream_rows(KEY, [10, 12]), slow_rows("a <b>", [0.1 + 0.2, 1e-300])])

    def test_numbers_come_back_to_the_bit(self, tmp_path) -> None:
        res.write_results(self.ROWS, tmp_path / "a.csv")
        again = res.read_results(tmp_path / "a.csv")
        pd.testing.assert_frame_equal(again, self.ROWS.reset_index(drop=True), check_exact=True)

    def test_a_last_line_that_was_broken_off_is_left_out(self, tmp_path) -> None:
        file = tmp_path / "a.csv"
        res.write_results(self.ROWS, file)
        file.write_bytes(file.read_bytes()[:-4])
        assert len(res.read_results(file)) == len(self.ROWS) - 1
        assert res.read_results(tmp_path / "none.csv").empty

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (
                "a,b\n1,2\n",
                "columns must include task, scenario, preset, method, seed, got no task",
            ),
            ("task,scenario,preset,method,seed,episode\na,b,c,d,e,0\n", "'e'"),
            ("task,scenario,preset,method,seed,time\na,b,c,d,0,inf\n", "time must be .* line 2"),
            ("task,scenario,preset,method,seed\na,b,c,d,-1\n", "seed must be .* line 2"),
        ],
    )
    def test_another_file_is_refused(self, tmp_path, text, message) -> None:
        (tmp_path / "a.csv").write_text(text)
        with pytest.raises(ValueError, match=rf"a\.csv holds something else .*{message}"):
            res.read_results(tmp_path / "a.csv")


FEW = [replace(each.under("exact", "stuck"), most=2) for each in rules("slow")]


def apart_from_time(table: pd.DataFrame) -> pd.DataFrame:
    return table.drop(columns="decision_time")


@dataclass(frozen=True)
class CountingScenario(Scenario):
    """Two episodes that say how often they were played."""

    file: Path

    @property
    def name(self) -> str:
        return "counted"

    def episodes(self, _: Method) -> int:
        return 2

    def play(self, method: Method, seed: int) -> list[Row]:
        with self.file.open("a") as file:
            file.write(f"{method.name}\n")
        more = {"own": 0.5} if method.name == "c" else {}
        return [{"success": k, "time": 0.1 + seed, **more} for k in range(2)]


def counted_jobs(file: Path, names: str) -> list[ScenarioJob]:
    methods = [Method(name, "slow", lambda *_: None, seeds=(0, 1)) for name in names]
    return make_jobs([CountingScenario("slow", "exact", WHOLE, file)], methods)


def test_processes_make_no_difference(tmp_path) -> None:
    jobs = make_jobs(start_scenarios("slow"), FEW)
    alone, shared = res.compute(jobs, 1), res.compute(jobs, 2, tmp_path / res.FILE)
    pd.testing.assert_frame_equal(apart_from_time(alone), apart_from_time(shared), check_exact=True)
    assert list(alone.groupby(["method", "preset"], sort=False).size()) == [2] * 6
    assert list(dict.fromkeys(alone["method"])) == [each.name for each in FEW]


def test_what_is_kept_is_not_computed_again(tmp_path) -> None:
    played, file = tmp_path / "played", tmp_path / res.FILE
    first = res.compute(counted_jobs(played, "a"), 1, file)
    with file.open("a") as kept:
        kept.write("slow,counted,exact,b,0,rule,0,1.0")  # a line broken off
    seen: list[tuple[int, int, str]] = []
    jobs = counted_jobs(played, "abc")
    whole = res.compute(jobs, 1, file, lambda *given: seen.append(given))
    assert [each[:2] for each in seen] == [(k, 6) for k in (2, 3, 3, 4, 4, 5, 5, 6)]
    phases = [each[2].split()[0] for each in seen]
    assert phases == ["compiling", "finished", *["running", "finished"] * 3]
    assert played.read_text().split() == [*"aa", *"bb", *"cc"]
    pd.testing.assert_frame_equal(whole[:4][list(first)], first)
    # A job that was broken off in its midst is computed anew, and no other.
    file.write_text("".join(file.read_text().splitlines(keepends=True)[:-1]))
    again = res.compute(jobs, 1, file)
    assert played.read_text().split() == [*"aabbcc", "c"]
    pd.testing.assert_frame_equal(again, whole)
    pd.testing.assert_frame_equal(res.read_results(file), whole)
    # What others asked for stays.
    res.compute(counted_jobs(played, "a"), 1, file)
    assert len(res.read_results(file)) == len(whole)
    assert res.compute([], 1, file).empty


def test_slow_jobs_come_neither_first_nor_last() -> None:
    """Quick results show that it works; a slow job at the end would keep processes waiting."""
    jobs = make_jobs(start_scenarios("slow"), all_methods("slow"))
    ordered = res.order_jobs(jobs)
    slow = [k for k, job in enumerate(ordered) if job.is_slow]
    assert {job.key for job in ordered} == {job.key for job in jobs}
    assert slow
    assert slow[0] > 1
    assert slow[-1] < len(jobs) - 2
    assert res.order_jobs(ordered[:1]) == ordered[:1]
    assert res.order_jobs([ordered[slow[0]]]) == [ordered[slow[0]]]


def test_lines_of_progress_have_a_total_from_the_beginning(tmp_path) -> None:
    screen = io.StringIO()
    jobs = counted_jobs(tmp_path / "played", "ab")
    with res.show_progress(Console(file=screen, width=60), "comparing", len(jobs)) as advance:
        assert screen.getvalue() == "comparing: 0/4\n"
        res.compute(jobs, 1, advance=advance)
    lines = screen.getvalue().splitlines()
    assert lines[1] == "comparing: 0/4, compiling slow, a, exact, counted"
    assert lines[-1] == "comparing: 4/4, finished slow, b, exact, counted"


def test_an_interrupt_leaves_what_is_done(tmp_path) -> None:
    played, file = tmp_path / "played", tmp_path / res.FILE

    def stop(done: int, *_: object) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        res.compute(counted_jobs(played, "ab"), 1, file, stop)
    assert len(res.read_results(file)) == 4
