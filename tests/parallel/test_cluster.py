"""Work on a Ray cluster of two nodes: as in local processes to the bit, whatever dies."""

import logging
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ray
from ray.cluster_utils import Cluster as TwoNodes
from rich.console import Console

from surface_gym import ray_executor
from surface_gym.agents.evaluation.benchmark import compute_results
from surface_gym.agents.evaluation.methods import policy_folders, rules, trained
from surface_gym.agents.learning.config import ModulesConfig, PPOConfig
from surface_gym.agents.learning.runs import CARD as CARD_FILE
from surface_gym.agents.learning.runs import CURVE, make_folder, train_seeds
from surface_gym.agents.library import WEIGHTS, task_files
from surface_gym.agents.tuning.study import run_trial
from surface_gym.design import Case, Sort, success_map
from surface_gym.parallel import Cluster, WorkFailed, choose_workers, map_jobs
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.ray_executor import Build
from tests.agents.tuning.cheap import searched
from tests.agents.tuning.test_study import SWEEP
from tests.parallel import jobs

ROOT = Path(__file__).parents[2]
SMALL = ModulesConfig(
    seeds=2, num_envs=8, steps=2_560, n_steps=16, batch_size=64, n_epochs=1, hidden=(8,),
    checkpoint_every=1_024,
)  # fmt: skip


class Nodes:
    """A head without a processor, and two nodes with one each."""

    def __init__(self) -> None:
        self.cluster = TwoNodes(
            initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False}
        )
        self.nodes = [self.cluster.add_node(num_cpus=1) for _ in range(2)]

    def replace_one(self) -> None:
        """Kill the node that has been there longest; another one joins."""
        self.cluster.remove_node(self.nodes.pop(0), allow_graceful=False)
        self.nodes.append(self.cluster.add_node(num_cpus=1))


@pytest.fixture(scope="module")
def nodes() -> Iterator[Nodes]:
    logging.getLogger("ray").setLevel(logging.ERROR)
    nodes = Nodes()
    yield nodes
    ray.shutdown()
    nodes.cluster.shutdown()


@pytest.fixture
def cluster(nodes: Nodes) -> Cluster:
    return Cluster(nodes.cluster.address)


def test_results_and_reports_are_those_of_processes(cluster) -> None:
    work = [partial(jobs.draws, seed) for seed in range(5)]
    heard: list[tuple[int, Any]] = []
    found = dict(map_jobs(work, cluster, lambda *each: heard.append(each)))
    assert found == dict(map_jobs(work, 1))
    for index in range(5):
        assert [value[0] for where, value in heard if where == index] == list(range(5))


def test_both_nodes_work(cluster) -> None:
    assert len({pid for _, pid in map_jobs([jobs.own_process] * 6, cluster)}) >= 2


def test_a_job_whose_process_dies_is_done_again(cluster, tmp_path) -> None:
    work = [
        partial(jobs.dies_at_first, tmp_path, "lost"),
        partial(jobs.counts_beginnings, tmp_path, "whole"),
    ]
    assert dict(map_jobs(work, cluster)) == {0: 2, 1: 1}


def test_a_job_whose_node_dies_is_done_again_and_only_that(nodes, cluster, tmp_path) -> None:
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


def test_errors_are_raised_here_and_tell_where_they_came_from(cluster) -> None:
    with pytest.raises(ValueError, match="seven") as raised:
        dict(map_jobs([partial(jobs.fails, "seven")], cluster))
    assert "in fails" in str(raised.value.__cause__)


def test_a_job_that_always_dies_ends_the_work(cluster, monkeypatch) -> None:
    monkeypatch.setattr("surface_gym.parallel.MAX_LOSSES", 3)
    with pytest.raises(WorkFailed, match="a job has cost 3 processes; the last: WorkerCrashed"):
        dict(map_jobs([jobs.always_dies], cluster))


def test_ctrl_c_interrupts_the_jobs_on_the_nodes_too(cluster, tmp_path) -> None:
    heard: list[tuple[int, Any]] = []

    def hear(index: int, value: Any) -> None:
        heard.append((index, value))
        if len(heard) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dict(map_jobs([partial(jobs.waits, tmp_path / f"{k}") for k in range(2)], cluster, hear))
    assert sorted(heard[2:]) == [(0, "interrupted"), (1, "interrupted")]


def test_a_node_with_another_version_is_refused_and_both_are_named(cluster, monkeypatch) -> None:
    monkeypatch.setattr(ray_executor, "own_build", lambda: Build("0.0.1", "c0de", "9a9e"))
    named = r"has surface_gym version .* \(code .*version 0\.0\.1 \(code c0de, policies 9a9e\)"
    with pytest.raises(WorkFailed, match=named):
        dict(map_jobs([partial(jobs.draws, 0)], cluster))


@pytest.mark.parametrize("address", ["", "ray://head:10001"])
def test_addresses_that_cannot_be_used_are_refused(address) -> None:
    with pytest.raises(ValueError, match="cluster must be host:port, or auto, of a cluster that"):
        Cluster(address)


def test_without_ray_it_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=r"pip install 'surface_gym\[cluster\]'"):
        dict(map_jobs([partial(jobs.draws, 0)], Cluster("auto")))


def test_seeds_with_nodes_dying_come_to_the_same_files_as_in_processes(
    nodes, cluster, tmp_path
) -> None:
    folders = [tmp_path / "local", tmp_path / "cluster"]
    for folder in folders:
        folder.mkdir()
    train_seeds(SMALL, folders[0], Console(quiet=True), 2)
    usual = ray_executor.RayExecutor.events
    words = 0

    def events(executor: ray_executor.RayExecutor) -> Iterator[Any]:
        nonlocal words
        for word in usual(executor):
            words += 1
            if words in (6, 20):
                nodes.replace_one()
            yield word

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ray_executor.RayExecutor, "events", events)
        learned = train_seeds(SMALL, folders[1], Console(quiet=True), cluster)
    assert words > 20
    assert [each.interrupted for each in learned] == [False] * 2
    for seed in range(2):
        for name in (WEIGHTS, CURVE):
            local, elsewhere = (folder / f"seed-{seed}" / name for folder in folders)
            assert elsewhere.read_bytes() == local.read_bytes(), (seed, name)
    assert not list(folders[1].rglob("*.part"))
    assert not list(folders[1].rglob(CARD_FILE))


def test_results_are_the_same_those_of_a_runs_policies_too(cluster, tmp_path) -> None:
    one = PPOConfig(
        task="slow", steps=512, num_envs=8, n_steps=16, batch_size=64, n_epochs=1, hidden=(8,)
    )
    train_seeds(one, tmp_path, Console(quiet=True), 1)
    run = replace(trained(policy_folders(tmp_path)), presets=("exact",), starts=6)
    methods = [replace(rules("slow")[0], presets=("exact", "stuck"), starts=6), run]
    local, elsewhere = (
        [replace(result, decision_time=0.0) for result in compute_results(methods, workers)]
        for workers in (1, cluster)
    )
    assert elsewhere == local


def test_a_design_map_is_the_same(cluster) -> None:
    case = Case(Parcel(Rectangle(0.3, 0.3)), Sort(), speed=1.5, draws=20)
    asked = {"columns": 6, "speeds": [0.8, 1.2, 1.5, 2.0], "sizes": [0.9, 1.0]}
    local, elsewhere = (success_map(case, workers=workers, **asked) for workers in (2, cluster))
    np.testing.assert_array_equal(elsewhere.share, local.share)
    np.testing.assert_array_equal(elsewhere.nominal, local.nominal)


def test_a_command_that_was_killed_goes_on_with_a_custom_task(
    cluster, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(ROOT)
    task = "examples/reach.py:Reach"
    config = PPOConfig(
        task=task, seeds=2, num_envs=8, steps=12_288, n_steps=32, batch_size=64, n_epochs=1,
        hidden=(8,), checkpoint_every=4_096, out=tmp_path, name="run",
    )  # fmt: skip
    folders = [tmp_path / "local", make_folder(config)]
    folders[0].mkdir()
    train_seeds(config, folders[0], Console(quiet=True), 1)
    command = [
        sys.executable, "train.py", "--resume", str(folders[1]), "--task", task,
        "--cluster", cluster.address,
    ]  # fmt: skip
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
    train_seeds(
        config,
        folders[1],
        Console(quiet=True),
        choose_workers(cluster.address, 1, task_files(task)),
    )
    for name in ("seed-0", "seed-1"):
        for file in (WEIGHTS, CURVE):
            local, elsewhere = (folder / name / file for folder in folders)
            assert elsewhere.read_bytes() == local.read_bytes(), (name, file)
    ray.shutdown()


def test_a_search_has_trials_of_the_nodes(cluster, tmp_path) -> None:
    sweep = replace(SWEEP, trials=2, startup_trials=2, sampler="random", pruner="none")
    found = []
    for name, workers in (("local", 1), ("cluster", cluster)):
        (tmp_path / name).mkdir()
        trials = searched(sweep, tmp_path / name, run_trial, workers)
        found.append([(each.params, each.values, each.intermediate_values) for each in trials])
    assert found[0] == found[1]
