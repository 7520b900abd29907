"""Independent jobs in parallel, on processes of this machine or on a Ray cluster.

`map_jobs` submits jobs to an executor, passes on their reports, and submits a job again if its
process or node dies. Results do not depend on the number of workers.
"""

import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sized
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from surface_gym import checks
from surface_gym.executors import (
    DONE,
    LOST,
    REPORTED,
    Cluster,
    Job,
    Processes,
    RayExecutor,
    RemoteTraceback,
    Report,
    WorkError,
)  # fmt: skip

Result = TypeVar("Result")
OnReport = Callable[[int, Any], None]  # called with a job's index and its report

MAX_LOSSES = 10  # maximum successive losses of a job's process without a report
GRACE = 60.0  # [s] for interrupted jobs to write files and report

# Number of processes on this machine, or processes that others started and close, or a cluster.
Workers = int | Processes | Cluster


def map_jobs(
    jobs: Iterable[Job[Result]],
    workers: Workers,
    on_report: OnReport = lambda *_: None,
    grace: float = GRACE,
    name: Callable[[int], str] = "job {}".format,
) -> Iterator[tuple[int, Result]]:
    """Run jobs; yield index and result of each finished job, in any order.

    If a job's process or node dies, the job starts again. The job may continue from its own
    files. If the iteration ends early, e.g. by Ctrl-C, running jobs are interrupted, and
    `on_report` still gets their last reports.

    Args:
        jobs: functions of one argument, `report`. The next job is taken from the iterable only when
            a worker is free.
        workers: see `Workers`. If `workers` is the number 1, jobs run in this process.
        on_report: called with a job's index and its report.
        grace: [s] time for interrupted jobs to finish.
        name: function from a job's index to its name, for a note on the job's error.

    Raises:
        WorkError: a job has lost `MAX_LOSSES` processes in a row without a report, or a node has
            another version of the package.
        ValueError: there is no Ray cluster at the address in `workers`.
    """
    executor: Any  # `Processes` or `RayExecutor`
    if isinstance(workers, Cluster):
        executor = RayExecutor(workers)
    elif isinstance(workers, Processes):
        executor = workers
        executor.finish_loading()
    else:
        known = len(jobs) if isinstance(jobs, Sized) else workers
        if min(check_count("workers", workers), known) <= 1:
            for index, job in enumerate(jobs):
                try:
                    result = job(partial(on_report, index))
                except Exception as error:
                    error.add_note(f"in {name(index)}")
                    raise
                yield index, result
            return
        executor = Processes(workers)
    try:
        yield from _map(enumerate(jobs), executor, on_report, name)
    except BaseException:
        executor.interrupt()
        deadline = time.monotonic() + grace
        while executor.running and time.monotonic() < deadline:
            for index, kind, value in executor.events():
                if kind == REPORTED:
                    on_report(index, value)
        raise
    finally:
        if executor is not workers:
            executor.close()


def _map(
    jobs: Iterator[tuple[int, Job[Result]]],
    executor: Any,
    on_report: OnReport,
    name: Callable[[int], str],
) -> Iterator[tuple[int, Result]]:
    running: dict[int, Job[Result]] = {}
    lost: deque[int] = deque()
    losses = Counter[int]()
    while True:
        for _ in range(executor.free):
            if lost:
                index = lost.popleft()
            elif (following := next(jobs, None)) is not None:
                index, running[following[0]] = following
            else:
                break
            executor.submit(index, running[index])
        if not running:
            return
        for index, kind, value in executor.events():
            if kind == REPORTED:
                losses[index] = 0
                on_report(index, value)
            elif kind == DONE:
                del running[index]
                yield index, value
            elif kind == LOST:
                losses[index] += 1
                if losses[index] == MAX_LOSSES:
                    raise WorkError(
                        f"{name(index)} has cost {MAX_LOSSES} processes; the last: {value}"
                    )
                lost.append(index)
            else:
                error, where = value
                error.add_note(f"in {name(index)}")
                raise error from RemoteTraceback(where)


def without_report(job: Callable[[], Result], report: Report) -> Result:
    """Call the function `job`, which takes no arguments, and ignore `report`.

    `map_jobs` can run the partial function `partial(without_report, job)`.
    """
    del report
    return job()


def check_workers(workers: Workers) -> Workers:
    """Return `workers`, a cluster or a number of processes. `check_count` checks the number."""
    return workers if isinstance(workers, Cluster) else check_count("workers", workers)


def check_count(name: str, value: Any) -> int:
    """Return a number of processes or threads. Refuse more than `PER_CORE` per usable core."""
    count, cores = checks.integer(name, value, least=1), usable_cores()
    if count > checks.PER_CORE * cores:
        raise ValueError(
            f"{name} must be at most {checks.PER_CORE} for each usable core, "
            f"{checks.PER_CORE * cores} here, got {value!r}"
        )
    return count


def choose_workers(cluster: str | None, processes: int, files: tuple[Path, ...] = ()) -> Workers:
    """Return `Cluster(cluster, files)`, or `processes` if `cluster` is None."""
    checked = check_workers(processes)
    return checked if cluster is None else Cluster(cluster, files)


def usable_cores() -> int:
    """Return the number of usable cores reported by the system."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
