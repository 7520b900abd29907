"""What it costs to share work: on a Ray cluster of two nodes of one core each, and in processes."""

import importlib.util
import logging
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figure import Figure
from surface_gym.agents.learning.config import TrainConfig, defaults
from surface_gym.agents.learning.runs import CHECKPOINT
from surface_gym.agents.learning.train import put_files, read_files, train
from surface_gym.design.runs import line_for, make_runs, run_all
from surface_gym.layouts import box
from surface_gym.parallel import Cluster, Workers, map_jobs, without_report

RAY = importlib.util.find_spec("ray") is not None
CELLS = 500
RUNS = 10_000  # of a design
ROUNDS = 7  # of either side, in turn; the medians count

# What the project asks of itself.
MOST_OF_A_CELL = 20.0  # [ms] to hand it out
LEAST_OF_LOCAL = 0.9  # of the local rate, small design runs


def sharing_figures() -> list[Figure]:
    """The cost of a cell, the rate of a design's runs, and what a run of PPO and DQN leaves."""
    with _two_nodes() as cluster:
        figures = [
            Figure("handing out a cell, two processes", _each(2), "ms"),
            Figure("handing out a cell, two nodes", _each(cluster), "ms", most=MOST_OF_A_CELL),
        ]
        local, elsewhere = _rates(cluster)
    figures += [
        Figure("10 000 design runs a second, two threads", local, "1/s"),
        Figure(
            "10 000 design runs, two nodes over two threads", elsewhere / local, "",
            least=LEAST_OF_LOCAL,
        ),
    ]  # fmt: skip
    for algo in ("ppo", "dqn"):
        figures += _run(algo)
    return figures


@contextmanager
def _two_nodes() -> Iterator[Cluster]:
    import ray
    from ray.cluster_utils import Cluster as Nodes

    logging.getLogger("ray").setLevel(logging.ERROR)
    nodes = Nodes(True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    for _ in range(2):
        nodes.add_node(num_cpus=1)
    try:
        yield Cluster(nodes.address)
    finally:
        ray.shutdown()
        nodes.shutdown()


def _nothing() -> None:
    """The least cell there is."""


def _each(workers: Workers) -> float:
    """[ms] a cell that takes no time, processes warm."""
    jobs = [partial(without_report, _nothing)] * (CELLS + 1)
    answers = iter(map_jobs(jobs, workers))
    next(answers)  # processes are there
    begin = time.perf_counter()
    for _ in answers:
        pass
    return 1e3 * (time.perf_counter() - begin) / CELLS


def _rates(cluster: Cluster) -> tuple[float, float]:
    """Runs a second on two threads and on two nodes, in turn."""
    parcel = box("S")
    line = line_for(parcel, 10)
    axes = np.full((1, line.rows, line.columns), np.pi / 4)
    runs = make_runs(np.linspace(0.5, 2.7, RUNS))
    taken: dict[Any, list[float]] = {2: [], cluster: []}
    for _ in range(ROUNDS + 1):  # the first warms up
        for workers, times in taken.items():
            begin = time.perf_counter()
            run_all(line, axes, [parcel], runs, workers=workers)
            times.append(time.perf_counter() - begin)
    local, elsewhere = (RUNS / float(np.median(times[1:])) for times in taken.values())
    return local, elsewhere


def _run(algo: str) -> list[Figure]:
    """A run of Sort, one core: its rate, and the checkpoint it leaves."""
    config: TrainConfig = replace(defaults("sort", algo), steps=60_000)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        told: list[tuple[int, float]] = []
        train(config, folder, lambda steps, _: told.append((steps, time.perf_counter())))
        size = (folder / CHECKPOINT).stat().st_size
        begin = time.perf_counter()
        put_files(read_files(folder), folder)
        taken = time.perf_counter() - begin
    (first, begin), (last, end) = told[0], told[-1]
    rate = (last - first) / (end - begin)
    return [
        Figure(f"{algo}: control periods learned from, one core", rate, "1/s"),
        Figure(f"{algo}: checkpoint after 60 000 of them", 1e-6 * size, "MB"),
        Figure(f"{algo}: to read and write its folder", 1e3 * taken, "ms"),
    ]
