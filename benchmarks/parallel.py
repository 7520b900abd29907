"""Cost of parallel work in processes, and on a Ray cluster of two nodes with one core each."""

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
from surface_gym.agents.learning.runs import CHECKPOINT, put_files, read_files, train
from surface_gym.design.runs import line_for, make_runs, run_all
from surface_gym.executors import Cluster
from surface_gym.layouts import box
from surface_gym.parallel import Workers, map_jobs, without_report

RAY = importlib.util.find_spec("ray") is not None
JOBS = 500
RUNS = 10_000  # of a design
ROUNDS = 7  # of both sides in turn; the medians count

# Requirements.
MOST_PER_JOB = 20.0  # [ms] to submit a job and get its result
LEAST_OF_LOCAL = 0.9  # over the local rate, of small design runs


def parallel_figures() -> list[Figure]:
    """Measure the time of an empty job, the rate of a design's runs, and training (PPO, DQN)."""
    with _two_nodes() as cluster:
        figures = [
            Figure("job without work, two processes", _job_time(2), "ms"),
            Figure("job without work, two nodes", _job_time(cluster), "ms", most=MOST_PER_JOB),
        ]
        local, remote = _design_rates(cluster)
    figures += [
        Figure("10 000 design runs a second, two threads", local, "1/s"),
        Figure(
            "10 000 design runs, two nodes over two threads", remote / local, "",
            least=LEAST_OF_LOCAL,
        ),
    ]  # fmt: skip
    for algo in ("ppo", "dqn"):
        figures += _training_figures(algo)
    return figures


@contextmanager
def _two_nodes() -> Iterator[Cluster]:
    """Yield a Ray cluster of two nodes on this machine, which ends with the context."""
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


def _job_time(workers: Workers) -> float:
    """Return the mean time [ms] of a job without work, after the processes have started."""
    jobs = [partial(without_report, int)] * (JOBS + 1)
    results = iter(map_jobs(jobs, workers))
    next(results)  # processes have started
    begin = time.perf_counter()
    for _ in results:
        pass
    return 1e3 * (time.perf_counter() - begin) / JOBS


def _design_rates(cluster: Cluster) -> tuple[float, float]:
    """Return a design's runs per second [1/s] on two threads and on two nodes, timed in turn."""
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
    local, remote = (RUNS / float(np.median(times[1:])) for times in taken.values())
    return local, remote


def _training_figures(algo: str) -> list[Figure]:
    """Train on Sort on one core, and measure the speed and the cost of a checkpoint."""
    config: TrainConfig = replace(defaults("sort", algo), steps=60_000)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        progress: list[tuple[int, float]] = []
        train(config, folder, lambda steps, _: progress.append((steps, time.perf_counter())))
        size = (folder / CHECKPOINT).stat().st_size
        begin = time.perf_counter()
        put_files(read_files(folder), folder)
        taken = time.perf_counter() - begin
    (first, begin), (last, end) = progress[0], progress[-1]
    rate = (last - first) / (end - begin)
    return [
        Figure(f"{algo}: control periods learned from, one core", rate, "1/s"),
        Figure(f"{algo}: checkpoint after 60 000 of them", 1e-6 * size, "MB"),
        Figure(f"{algo}: to read and write its folder", 1e3 * taken, "ms"),
    ]
