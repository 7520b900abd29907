"""The runner: each job once, in any number of processes, and a broken-off run goes on."""

import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd
import pytest

from surface_gym.agents.evaluation import runner
from surface_gym.agents.evaluation.method import Method, rules
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
class Counted(Scenario):
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
    return make_jobs([Counted("slow", "exact", WHOLE, file)], methods)


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
    seen: list[tuple[int, int]] = []
    jobs = counted_jobs(played, "abc")
    whole = compute(jobs, 1, file, lambda *given: seen.append(given[:2]))
    assert seen == [(2, 6), *((k, 6) for k in range(3, 7))]
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


def test_the_slowest_go_first() -> None:
    jobs = make_jobs(start_scenarios("slow"), rules("slow"))
    first = [job.method.most is not None for job in sorted(jobs, key=runner._place)]
    assert first == sorted(first, reverse=True)


def test_an_interrupt_leaves_what_is_done(tmp_path) -> None:
    played, file = tmp_path / "played", tmp_path / FILE

    def stop(done: int, *_: object) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compute(counted_jobs(played, "ab"), 1, file, stop)
    assert len(read_results(file)) == 4
