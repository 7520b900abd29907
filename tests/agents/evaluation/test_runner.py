"""The runner: each job once, in any number of processes, and a broken-off run goes on."""

import io
import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd
import pytest
from rich.console import Console

from surface_gym.agents.evaluation import runner
from surface_gym.agents.evaluation.method import Method, all_methods, rules
from surface_gym.agents.evaluation.results import FILE, read_results
from surface_gym.agents.evaluation.runner import compute
from surface_gym.agents.evaluation.scenario import (
    WHOLE,
    Row,
    Scenario,
    ScenarioJob,
    make_jobs,
    start_scenarios,
)

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
    alone, shared = compute(jobs, 1), compute(jobs, 2, tmp_path / FILE)
    pd.testing.assert_frame_equal(apart_from_time(alone), apart_from_time(shared), check_exact=True)
    assert list(alone.groupby(["method", "preset"], sort=False).size()) == [2] * 6
    assert list(dict.fromkeys(alone["method"])) == [each.name for each in FEW]


def test_what_is_kept_is_not_computed_again(tmp_path) -> None:
    played, file = tmp_path / "played", tmp_path / FILE
    first = compute(counted_jobs(played, "a"), 1, file)
    with file.open("a") as kept:
        kept.write("slow,counted,exact,b,0,rule,0,1.0")  # a line broken off
    seen: list[tuple[int, int, str]] = []
    jobs = counted_jobs(played, "abc")
    whole = compute(jobs, 1, file, lambda *given: seen.append(given))
    assert [each[:2] for each in seen] == [(k, 6) for k in (2, 3, 3, 4, 4, 5, 5, 6)]
    phases = [each[2].split()[0] for each in seen]
    assert phases == ["compiling", "finished", *["running", "finished"] * 3]
    assert played.read_text().split() == [*"aa", *"bb", *"cc"]
    pd.testing.assert_frame_equal(whole[:4][list(first)], first)
    # A job that was broken off in its midst is computed anew, and no other.
    file.write_text("".join(file.read_text().splitlines(keepends=True)[:-1]))
    again = compute(jobs, 1, file)
    assert played.read_text().split() == [*"aabbcc", "c"]
    pd.testing.assert_frame_equal(again, whole)
    pd.testing.assert_frame_equal(read_results(file), whole)
    # What others asked for stays.
    compute(counted_jobs(played, "a"), 1, file)
    assert len(read_results(file)) == len(whole)
    assert compute([], 1, file).empty


def test_a_job_is_sent_to_other_processes() -> None:
    job = make_jobs(start_scenarios("slow"), FEW)[0]
    again = pickle.loads(pickle.dumps(job))
    assert (again.key, again.episodes) == (job.key, 2)


def test_slow_jobs_come_neither_first_nor_last() -> None:
    """Quick results show that it works; a slow job at the end would keep processes waiting."""
    jobs = make_jobs(start_scenarios("slow"), all_methods("slow"))
    ordered = runner.order_jobs(jobs)
    slow = [k for k, job in enumerate(ordered) if runner._is_slow(job.method)]
    assert {job.key for job in ordered} == {job.key for job in jobs}
    assert slow
    assert slow[0] > 1
    assert slow[-1] < len(jobs) - 2
    assert runner.order_jobs(ordered[:1]) == ordered[:1]
    assert runner.order_jobs([ordered[slow[0]]]) == [ordered[slow[0]]]


def test_lines_of_progress_have_a_total_from_the_beginning(tmp_path) -> None:
    screen = io.StringIO()
    jobs = counted_jobs(tmp_path / "played", "ab")
    with runner.show_progress(Console(file=screen, width=60), "comparing", len(jobs)) as advance:
        assert screen.getvalue() == "comparing: 0/4\n"
        compute(jobs, 1, advance=advance)
    lines = screen.getvalue().splitlines()
    assert lines[1] == "comparing: 0/4, compiling slow, a, exact, counted"
    assert lines[-1] == "comparing: 4/4, finished slow, b, exact, counted"


def test_an_interrupt_leaves_what_is_done(tmp_path) -> None:
    played, file = tmp_path / "played", tmp_path / FILE

    def stop(done: int, *_: object) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compute(counted_jobs(played, "ab"), 1, file, stop)
    assert len(read_results(file)) == 4
