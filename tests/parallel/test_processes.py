"""Jobs in processes: each done once, lost ones again, errors and Ctrl-C passed on."""

import os
import subprocess
import sys
import time
from collections.abc import Generator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from surface_gym.parallel import WorkFailed, check_workers, map_jobs, without_report
from tests.parallel import jobs


def test_results_and_reports_do_not_depend_on_processes():
    heard: dict[int, list[tuple[Any, ...]]] = {1: [], 2: []}
    work = [partial(jobs.draws, seed) for seed in range(5)]
    found = {
        workers: dict(map_jobs(work, workers, partial(kept, heard[workers]))) for workers in heard
    }
    assert found[1] == found[2]
    assert sorted(heard[1]) == sorted(heard[2])
    assert len(heard[2]) == 25
    for index in range(5):
        assert [each[1] for each in heard[2] if each[0] == index] == list(range(5))


def kept(heard: list[tuple[Any, ...]], index: int, value: Any) -> None:
    heard.append((index, *value))


def test_two_processes_share_what_there_is_and_are_used_again():
    found = [pid for _, pid in map_jobs([jobs.own_process] * 5, 2)]
    assert len(found) == 5
    assert len(set(found)) == 2
    assert os.getpid() not in found


def test_one_worker_or_one_job_needs_no_process():
    assert dict(map_jobs([jobs.own_process], 8)) == {0: os.getpid()}
    assert dict(map_jobs([jobs.own_process] * 2, 1)) == {0: os.getpid(), 1: os.getpid()}
    assert list(map_jobs([], 2)) == []


def test_a_job_whose_process_dies_is_done_again_and_only_that(tmp_path):
    work = [
        partial(jobs.dies_at_first, tmp_path, "lost"),
        partial(jobs.counts_beginnings, tmp_path, "whole"),
    ]
    assert dict(map_jobs(work, 2)) == {0: 2, 1: 1}


def test_a_job_that_always_dies_ends_the_work(monkeypatch):
    monkeypatch.setattr("surface_gym.parallel.MAX_LOSSES", 3)
    with pytest.raises(WorkFailed, match=r"a job has cost 3 processes; the last: exit code -9"):
        dict(map_jobs([jobs.always_dies, partial(jobs.draws, 0)], 2))


def test_an_error_is_raised_here_and_says_where_it_came_from():
    with pytest.raises(ValueError, match="seven") as raised:
        dict(map_jobs([partial(jobs.fails, "seven"), jobs.own_process], 2))
    assert "in fails" in str(raised.value.__cause__)


def test_an_error_that_cannot_be_pickled_keeps_its_text():
    with pytest.raises(RuntimeError, match="Stubborn: 1 and 2"):
        dict(map_jobs([jobs.fails_stubbornly, jobs.own_process], 2))


@pytest.mark.parametrize("by", [KeyboardInterrupt, OSError])
def test_whatever_ends_the_work_interrupts_the_jobs_and_hears_them_out(by, tmp_path):
    heard: list[tuple[int, Any]] = []

    def hear(index: int, value: Any) -> None:
        heard.append((index, value))
        if len(heard) == 2:
            raise by

    with pytest.raises(by):
        dict(map_jobs([partial(jobs.waits, tmp_path / f"{k}") for k in range(2)], 2, hear))
    assert sorted(heard[2:]) == [(0, "interrupted"), (1, "interrupted")]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["0", "1"]


def test_closing_the_iteration_ends_the_jobs(tmp_path):
    work = [partial(jobs.draws, 0), partial(jobs.waits, tmp_path / "file")]
    some = map_jobs(work, 2)
    assert next(some)[0] == 0
    assert isinstance(some, Generator)
    some.close()
    assert not list(tmp_path.glob("*")) or (tmp_path / "file").read_text() == "interrupted\n"


def test_jobs_end_when_the_submitting_process_is_killed(tmp_path):
    code = (
        "from functools import partial\nfrom pathlib import Path\n"
        "from surface_gym.parallel import map_jobs\nfrom tests.parallel import jobs\n"
        "if __name__ == '__main__':\n"
        f"    dict(map_jobs([partial(jobs.reports_for_ever, Path({str(tmp_path)!r}))] * 2, 2))\n"
    )
    (tmp_path / "driver.py").write_text(code)
    driver = subprocess.Popen(
        [sys.executable, str(tmp_path / "driver.py")],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    until(lambda: len(list(tmp_path.glob("*.pid"))) == 2)
    driver.kill()
    driver.wait()
    until(lambda: not any(is_there(int(file.stem)) for file in tmp_path.glob("*.pid")))


def until(condition: Any) -> None:
    for _ in range(600):
        if condition():
            return
        time.sleep(0.1)
    raise AssertionError("it did not happen within a minute")


def is_there(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    # A process that has ended but was not asked for its end is none.
    return "State:\tZ" not in Path(f"/proc/{process}/status").read_text()


def test_a_job_without_reports():
    assert without_report(lambda: 5, pytest.fail) == 5


@pytest.mark.parametrize("workers", [0, -1, 1.5, True])
def test_workers_are_at_least_one(workers):
    with pytest.raises(ValueError, match="workers must be a whole number of at least 1"):
        check_workers(workers)


def test_the_next_job_is_taken_when_a_worker_is_free():
    """So that a job may be made by results of those before."""
    done: list[int] = []
    seen: list[int] = []

    def work() -> Any:
        for seed in range(4):
            seen.append(len(done))
            yield partial(jobs.draws, seed)

    for index, _ in map_jobs(work(), 2):
        done.append(index)
    assert sorted(done) == [0, 1, 2, 3]
    assert seen[:2] == [0, 0]
    assert seen[2] >= 1
