"""Independent jobs in parallel, on processes of this machine or on a Ray cluster.

`map_jobs` submits jobs to an executor, passes on their reports, and submits a job again if its
process or node dies. Results do not depend on the number of workers.
"""

import os
import pickle
import signal
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol, TypeVar

from surface_gym import checks

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)
Report = Callable[[Any], None]  # called by a job with its progress
OnReport = Callable[[int, Any], None]  # called with a job's index and its report
Message = tuple[str, Any]  # its kind, and the report, the result, the error, or the loss
Event = tuple[int, str, Any]  # a job's index, and its message

REPORTED, DONE, FAILED, LOST = "reported", "done", "failed", "lost"
MAX_LOSSES = 10  # processes that one job may cost without a report in between
POLL = 0.2  # [s] that an executor waits for events at most
GRACE = 60.0  # [s] for interrupted jobs to write their files and to report

# Spawned, not forked: a fork copies the locks of threads of libraries that are loaded here.
_SPAWN = get_context("spawn")


class WorkError(Exception):
    """Work that could not be done, independent of the job."""


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster that this machine has joined."""

    address: str  # host:port of its head, or "auto" for the joined cluster
    files: tuple[Path, ...] = ()  # files below the working folder that nodes need: custom tasks

    def __post_init__(self) -> None:
        if not self.address or self.address.startswith("ray://"):
            raise ValueError(
                "cluster must be host:port, or auto, of a cluster that this machine has joined by "
                f"`ray start --address=...`, got {self.address!r}"
            )


Workers = int | Cluster  # number of processes on this machine, or a cluster


class Job(Protocol[Result_co]):
    """A module's function or a `functools.partial` of it, which other processes can import."""

    def __call__(self, report: Report, /) -> Result_co:
        """Do the work; call `report` with progress from time to time."""


def map_jobs(
    jobs: Iterable[Job[Result]],
    workers: Workers,
    on_report: OnReport = lambda *_: None,
    grace: float = GRACE,
) -> Iterator[tuple[int, Result]]:
    """Run jobs, and yield index and result of each when it is finished, in any order.

    A job whose process or node dies is restarted, from the beginning or from its files. An
    interrupt, or any other end of this iteration, interrupts the running jobs and waits for their
    last reports.

    Args:
        jobs: each called with one argument, `report`. The next one is taken from the iterable only
            when a worker is free.
        workers: number of processes, or a cluster; with one process, jobs run in this process.
        on_report: called with a job's index and its report.
        grace: [s] for which interrupted jobs may go on.

    Raises:
        WorkFailed: a job has cost `MAX_LOSSES` processes without a report, or a node has another
            version of the package.
        ValueError: there is no cluster at the address.
    """
    executor: Any  # `Processes`, or the same on other machines
    if isinstance(workers, Cluster):
        from surface_gym.ray_executor import RayExecutor

        executor = RayExecutor(workers)
    else:
        known = len(jobs) if isinstance(jobs, Sized) else workers
        if min(check_count("workers", workers), known) <= 1:
            for index, job in enumerate(jobs):
                yield index, job(partial(on_report, index))
            return
        executor = Processes(workers)
    try:
        yield from _map(enumerate(jobs), executor, on_report)
    except BaseException:
        executor.interrupt()
        deadline = time.monotonic() + grace
        while executor.running and time.monotonic() < deadline:
            for index, kind, value in executor.events():
                if kind == REPORTED:
                    on_report(index, value)
        raise
    finally:
        executor.close()


def _map(
    jobs: Iterator[tuple[int, Job[Result]]], executor: Any, on_report: OnReport
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
                    raise WorkError(f"a job has cost {MAX_LOSSES} processes; the last: {value}")
                lost.append(index)
            else:
                error, where = value
                raise error from RemoteTraceback(where)


def without_report(job: Callable[[], Result], report: Report) -> Result:
    """Run a job without reports, with the signature for `map_jobs`."""
    del report
    return job()


def check_workers(workers: Workers) -> Workers:
    """Check workers: a cluster, or an allowed number of processes."""
    return workers if isinstance(workers, Cluster) else check_count("workers", workers)


def check_count(name: str, value: Any) -> int:
    """Check a number of processes or threads: 1 to `checks.PER_CORE` per core."""
    count, cores = checks.integer(name, value, least=1), usable_cores()
    if count > checks.PER_CORE * cores:
        raise ValueError(
            f"{name} must be at most {checks.PER_CORE} for each usable core, "
            f"{checks.PER_CORE * cores} here, got {value!r}"
        )
    return count


def choose_workers(cluster: str | None, processes: int, files: tuple[Path, ...] = ()) -> Workers:
    """Return the workers for a command's options: a cluster (with an address) or processes."""
    checked = check_workers(processes)
    return checked if cluster is None else Cluster(cluster, files)


def usable_cores() -> int:
    """Return the number of usable cores reported by the system."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class RemoteTraceback(Exception):
    """The traceback of an error from another process."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


def run_packed(packed: bytes, report: Report) -> Message:
    """Run a received job in this process, and return its last message."""
    try:
        return DONE, pickle.loads(packed)(report)
    except BaseException as error:
        where = traceback.format_exc()
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            return FAILED, (RuntimeError(f"{type(error).__name__}: {error}"), where)
        return FAILED, (error, where)


class Processes:
    """An executor of processes of this machine, started as they are needed."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._idle: list[Any] = []  # a process and the pipe to it
        self._busy: dict[Any, tuple[Any, int]] = {}  # by pipe: the process and the job's index

    @property
    def free(self) -> int:
        """Number of jobs that can be submitted now."""
        return self._count - len(self._busy)

    @property
    def running(self) -> int:
        """Number of jobs that were submitted and are not over."""
        return len(self._busy)

    def submit(self, index: int, job: Job[Any]) -> None:
        process, pipe = self._idle.pop() if self._idle else _start_process()
        self._busy[pipe] = process, index
        with suppress(OSError):  # it died while idle, which `events` reports
            pipe.send_bytes(pickle.dumps(job))

    def events(self) -> Iterator[Event]:
        """Yield the messages of jobs; wait for one for `POLL` at most."""
        ready: list[Any] = wait(list(self._busy), POLL)
        for pipe in ready:
            process, index = self._busy[pipe]
            try:
                kind, value = pipe.recv()
            except (EOFError, OSError):
                process.join()
                kind, value = LOST, f"exit code {process.exitcode}"
            if kind != REPORTED:
                del self._busy[pipe]
            if kind in (DONE, FAILED):
                self._idle.append((process, pipe))
            yield index, kind, value

    def interrupt(self) -> None:
        """Interrupt all running jobs, as Ctrl-C would."""
        if os.name == "posix":  # elsewhere Ctrl-C has reached them already
            for process, _ in self._busy.values():
                os.kill(process.pid, signal.SIGINT)

    def close(self) -> None:
        """End all running jobs, and the processes."""
        for process, _ in self._busy.values():
            process.terminate()
        busy = [(process, pipe) for pipe, (process, _) in self._busy.items()]
        for process, pipe in [*self._idle, *busy]:
            pipe.close()
            process.join()


def _start_process() -> tuple[Any, Any]:
    """Start a process that handles interrupts from its first job on."""
    ours, theirs = _SPAWN.Pipe()
    process = _SPAWN.Process(target=_work, args=(theirs,), daemon=True)
    if os.name == "posix":
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    process.start()
    if os.name == "posix":
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    theirs.close()
    return process, ours


def _work(pipe: "Connection[Any, Any]") -> None:
    """Run jobs until the submitting process closes the pipe or ends."""
    with suppress(EOFError, BrokenPipeError, ConnectionResetError, KeyboardInterrupt):
        if os.name == "posix":
            os.setpgid(0, 0)  # so that Ctrl-C comes from the submitting process alone, once
            # A process that a shell starts in the background ignores SIGINT.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        while True:
            packed = pipe.recv_bytes()
            pipe.send(run_packed(packed, lambda value: pipe.send((REPORTED, value))))
