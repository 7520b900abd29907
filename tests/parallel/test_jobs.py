"""Jobs in processes and on a Ray cluster of two nodes: the same to the bit, whatever dies."""

import itertools
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ray
from ray.cluster_utils import Cluster as TwoNodes
from rich.console import Console

from surface_gym import checks, executors, parallel
from surface_gym.agents.evaluation.method import policy_folders, rules, trained
from surface_gym.agents.evaluation.results import compute
from surface_gym.agents.evaluation.scenario import make_jobs, start_scenarios
from surface_gym.agents.learning.algorithms import ModulesConfig, PPOConfig
from surface_gym.agents.learning.runs import CARD as CARD_FILE, CURVE, make_folder, train_seeds
from surface_gym.agents.library import WEIGHTS, task_files
from surface_gym.agents.tuning import run_trial
from surface_gym.design import Case, SortPurpose, least_speed
from surface_gym.executors import Cluster, Processes, WorkError, describe_error
from surface_gym.parallel import choose_workers, map_jobs
from surface_gym.parcel import Parcel, Rectangle
from tests.agents.searches import searched
from tests.agents.test_tuning import SWEEP
from tests.parallel import jobs

ROOT = Path(__file__).parents[2]
TINY = {"num_envs": 8, "n_steps": 16, "batch_size": 64, "n_epochs": 1, "hidden": (8,)}
SMALL = ModulesConfig(seeds=2, steps=2_560, checkpoint_every=1_024, **TINY)


class Nodes:
    """A head without a processor, and two nodes with one each."""

    def __init__(self) -> None:
        head = {"num_cpus": 0, "include_dashboard": False}
        self.cluster = TwoNodes(initialize_head=True, head_node_args=head)
        self.nodes = [self.cluster.add_node(num_cpus=1) for _ in range(2)]

    def replace_one(self) -> None:
        self.cluster.remove_node(self.nodes.pop(0), allow_graceful=False)
        self.nodes.append(self.cluster.add_node(num_cpus=1))


@pytest.fixture(scope="module")
def nodes():
    logging.getLogger("ray").setLevel(logging.ERROR)
    nodes = Nodes()
    yield nodes
    ray.shutdown()
    nodes.cluster.shutdown()


@pytest.fixture
def cluster(nodes):
    return Cluster(nodes.cluster.address)


@pytest.fixture(params=["processes", "a cluster"])
def workers(request):
    return 2 if request.param == "processes" else request.getfixturevalue("cluster")


def test_results_and_reports_do_not_depend_on_who_works(workers):
    work = [partial(jobs.draws, seed) for seed in range(5)]

    def carried_out(workers: Any) -> tuple[dict[int, float], list[Any]]:
        heard = []
        return dict(map_jobs(work, workers, lambda *said: heard.append(said))), heard

    (alone, said), (found, heard) = carried_out(1), carried_out(workers)
    assert found == alone
    assert sorted(heard) == sorted(said)
    for index in range(5):
        assert [value[0] for where, value in heard if where == index] == list(range(5))


def test_two_share_what_there_is_and_are_used_again(workers):
    found = [pid for _, pid in map_jobs([jobs.own_process] * 6, workers)]
    assert len(found) == 6
    assert len(set(found)) == 2 if workers == 2 else len(set(found)) >= 2
    assert os.getpid() not in found


def test_a_job_whose_process_dies_is_done_again_and_only_that(workers, tmp_path):
    lost = partial(jobs.dies_at_first, tmp_path, "lost")
    whole = partial(jobs.counts_beginnings, tmp_path, "whole")
    assert dict(map_jobs([lost, whole], workers)) == {0: 2, 1: 1}


def test_a_job_that_always_dies_ends_the_work(workers, monkeypatch):
    monkeypatch.setattr("surface_gym.parallel.MAX_LOSSES", 3)
    last = "exit code -9" if workers == 2 else "WorkerCrashed"
    with pytest.raises(WorkError, match=f"job 0 has cost 3 processes; the last: {last}"):
        dict(map_jobs([jobs.always_dies, partial(jobs.draws, 0)], workers))


def test_an_error_is_raised_here_and_says_where_it_came_from(workers):
    with pytest.raises(ValueError, match="seven") as raised:
        dict(map_jobs([partial(jobs.fails, "seven"), jobs.own_process], workers))
    assert "in fails" in str(raised.value.__cause__)
    for count in (1, workers):
        with pytest.raises(ValueError, match="seven") as raised:
            dict(map_jobs([partial(jobs.fails, "seven")], count, name="seed {}".format))
        assert describe_error(raised.value) == "seven (in seed 0)"


@pytest.mark.parametrize("by", [KeyboardInterrupt, OSError])
def test_whatever_ends_the_work_interrupts_the_jobs_and_hears_them_out(workers, by, tmp_path):
    heard = []

    def hear(*said: Any) -> None:
        heard.append(said)
        if len(heard) == 2:
            raise by

    with pytest.raises(by):
        dict(map_jobs([partial(jobs.waits, tmp_path / f"{k}") for k in range(2)], workers, hear))
    assert sorted(heard[2:]) == [(0, "interrupted"), (1, "interrupted")]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["0", "1"]


def test_a_job_whose_node_dies_is_done_again_and_only_that(nodes, cluster, tmp_path):
    begun: list[int] = []

    def heard(index: int, _: Any) -> None:
        begun.append(index)
        if len(begun) == 2:  # one on each node
            nodes.replace_one()
            (tmp_path / "sign").touch()

    work = [partial(jobs.waits_for, tmp_path, str(k), "sign") for k in range(4)]
    found = dict(map_jobs(work, cluster, heard))
    assert sorted(found) == [0, 1, 2, 3]
    assert sorted(found.values()) == [1, 1, 1, 2]


def test_a_node_with_another_version_is_refused_and_both_are_named(cluster, monkeypatch):
    other = "version 0.0.1 (files c0de)"
    monkeypatch.setattr(executors, "own_build", lambda: other)
    named = r"has surface_gym version .* \(files .*version 0\.0\.1 \(files c0de\)"
    with pytest.raises(WorkError, match=named):
        dict(map_jobs([partial(jobs.draws, 0)], cluster))


def test_without_ray_it_says_what_to_install_and_addresses_that_cannot_be_used(monkeypatch):
    for address in ("", "ray://head:10001"):
        with pytest.raises(ValueError, match="cluster must be host:port, or auto, of a cluster"):
            Cluster(address)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=r"pip install 'surface_gym\[cluster\]'"):
        dict(map_jobs([partial(jobs.draws, 0)], Cluster("auto")))


def assert_same_files(local: Path, elsewhere: Path) -> None:
    for name in (f"seed-{seed}/{file}" for seed in range(2) for file in (WEIGHTS, CURVE)):
        assert (elsewhere / name).read_bytes() == (local / name).read_bytes(), name


def test_seeds_with_nodes_dying_come_to_the_same_files_as_in_processes(nodes, cluster, tmp_path):
    folders = [tmp_path / "local", tmp_path / "cluster"]
    for folder in folders:
        folder.mkdir()
    train_seeds(SMALL, folders[0], Console(quiet=True), 2)
    usual, words = executors.RayExecutor.events, itertools.count(1)

    def events(executor: executors.RayExecutor) -> Iterator[Any]:
        for word in usual(executor):
            if next(words) in (6, 20):
                nodes.replace_one()
            yield word

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executors.RayExecutor, "events", events)
        learned = train_seeds(SMALL, folders[1], Console(quiet=True), cluster)
    assert next(words) > 21
    assert [each.interrupted for each in learned] == [False] * 2
    assert_same_files(*folders)
    assert not list(folders[1].rglob("*.part"))
    assert not list(folders[1].rglob(CARD_FILE))


def test_results_are_the_same_those_of_a_runs_policies_too(cluster, tmp_path):
    one = PPOConfig(task="slow", steps=512, **TINY)
    train_seeds(one, tmp_path, Console(quiet=True), 1)
    run = replace(trained(policy_folders(tmp_path)), presets=("exact",), most=6)
    methods = [replace(rules("slow")[0], presets=("exact", "stuck"), most=6), run]
    work = make_jobs(start_scenarios("slow"), methods)
    local, elsewhere = (
        compute(work, workers).drop(columns="decision_time") for workers in (1, cluster)
    )
    assert elsewhere.equals(local)


def test_a_design_s_answer_is_the_same(cluster):
    case = Case(Parcel(Rectangle(0.3, 0.3)), SortPurpose(), speed=1.5, draws=20)
    local, elsewhere = (least_speed(case, 6, workers=workers) for workers in (2, cluster))
    for here, there in zip(local.spans, elsewhere.spans, strict=True):
        np.testing.assert_array_equal(there.share, here.share)


def test_a_command_that_was_killed_goes_on_with_a_custom_task(cluster, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    task = "examples/reach.py:Reach"
    learner = TINY | {"n_steps": 32, "checkpoint_every": 4_096}
    config = PPOConfig(task=task, seeds=2, steps=12_288, out=tmp_path, name="run", **learner)
    folders = [tmp_path / "local", make_folder(config, ["--task", task])]
    folders[0].mkdir()
    train_seeds(config, folders[0], Console(quiet=True), 1)
    own = ["--resume", str(folders[1]), "--task", task, "--cluster", cluster.address]
    command = [sys.executable, "train.py", *own]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as broken:
        for _ in range(3_000):
            if broken.poll() is not None or any(folders[1].rglob(CURVE)):
                break
            time.sleep(0.1)
        broken.kill()
    assert broken.returncode == -signal.SIGKILL
    assert any(folders[1].rglob(CURVE))
    assert not any(folders[1].rglob(WEIGHTS))
    ray.shutdown()  # a custom task is sent when the cluster is joined
    workers = choose_workers(cluster.address, 1, task_files(task))
    train_seeds(config, folders[1], Console(quiet=True), workers)
    assert_same_files(*folders)
    ray.shutdown()


def test_a_search_has_trials_of_the_nodes(cluster, tmp_path):
    sweep = replace(SWEEP, trials=2, startup_trials=2)
    found = []
    for name, workers in (("local", 1), ("cluster", cluster)):
        (tmp_path / name).mkdir()
        trials = searched(sweep, tmp_path / name, run_trial, workers)
        found.append([(each.params, each.values, each.intermediate_values) for each in trials])
    assert found[0] == found[1]


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


class TestProcesses:
    def test_one_worker_or_one_job_needs_no_process(self):
        assert dict(map_jobs([jobs.own_process], 8)) == {0: os.getpid()}
        assert dict(map_jobs([jobs.own_process] * 2, 1)) == {0: os.getpid(), 1: os.getpid()}
        assert list(map_jobs([], 2)) == []

    def test_processes_that_have_loaded_serve_calls_until_they_are_closed(self):
        with closing(Processes(2)) as processes:
            processes.load(jobs.fails_stubbornly, most=2)  # whatever becomes of it
            first = set(dict(map_jobs([jobs.own_process] * 4, processes)).values())
            again = set(dict(map_jobs([jobs.own_process] * 4, processes)).values())
            assert os.getpid() not in first | again
            assert len(first | again) <= 2
        assert not any(map(is_there, first | again))

    def test_an_error_that_cannot_be_pickled_keeps_its_text(self):
        with pytest.raises(RuntimeError, match="Stubborn: 1 and 2"):
            dict(map_jobs([jobs.fails_stubbornly, jobs.own_process], 2))

    def test_closing_the_iteration_ends_the_jobs(self, tmp_path):
        work = [partial(jobs.draws, 0), partial(jobs.waits, tmp_path / "file")]
        some = map_jobs(work, 2)
        assert next(some)[0] == 0
        assert isinstance(some, Generator)
        some.close()
        assert not list(tmp_path.glob("*")) or (tmp_path / "file").read_text() == "interrupted\n"

    def test_jobs_end_when_the_submitting_process_is_killed(self, tmp_path):
        code = (
            "from functools import partial\nfrom pathlib import Path\n"
            "from surface_gym.parallel import map_jobs\nfrom tests.parallel import jobs\n"
            "if __name__ == '__main__':\n"
            f"    job = partial(jobs.reports_for_ever, Path({str(tmp_path)!r}))\n"
            "    dict(map_jobs([job] * 2, 2))\n"
        )
        file = tmp_path / "driver.py"
        file.write_text(code)
        own = {**os.environ, "PYTHONPATH": str(ROOT)}
        driver = subprocess.Popen([sys.executable, str(file)], env=own)
        until(lambda: len(list(tmp_path.glob("*.pid"))) == 2)
        driver.kill()
        driver.wait()
        until(lambda: not any(is_there(int(file.stem)) for file in tmp_path.glob("*.pid")))

    def test_a_job_without_reports_and_less_than_one_worker(self):
        assert parallel.without_report(lambda: 5, pytest.fail) == 5
        for workers in (0, -1, 1.5, True):
            with pytest.raises(ValueError, match="workers must be a whole number of at least 1"):
                parallel.check_workers(workers)

    def test_workers_are_bounded_by_the_cores(self):
        most = checks.PER_CORE * parallel.usable_cores()
        assert parallel.choose_workers(None, most) == most
        for call in (parallel.check_workers, lambda n: list(map_jobs([], n))):
            with pytest.raises(
                ValueError, match=f"^workers must be .* core, {most} here, got 1000"
            ):
                call(100_000)

    def test_the_next_job_is_taken_when_a_worker_is_free(self):
        done, seen = [], []

        def work() -> Any:
            for seed in range(4):
                seen.append(len(done))
                yield partial(jobs.draws, seed)

        for index, _ in map_jobs(work(), 2):
            done.append(index)
        assert sorted(done) == [0, 1, 2, 3]
        assert seen[:2] == [0, 0]
        assert seen[2] >= 1
