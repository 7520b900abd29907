"""Executors: processes of this machine that do jobs, and what every executor has in common.

An executor is given jobs, and yields their messages: reports, then a result, an error or a loss.
"""

import os
import pickle
import signal
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol, TypeVar

Result_co = TypeVar("Result_co", covariant=True)
Report = Callable[[Any], None]  # called by a job with its progress
Message = tuple[str, Any]  # its kind, and the report, the result, the error, or the loss
Event = tuple[int, str, Any]  # a job's index, and its message

REPORTED, DONE, FAILED, LOST = "reported", "done", "failed", "lost"
POLL = 0.2  # [s] that an executor waits for events at most

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


class Job(Protocol[Result_co]):
    """A module's function or a `functools.partial` of it, which other processes can import."""

    def __call__(self, report: Report, /) -> Result_co:
        """Do the work; call `report` with progress from time to time."""


def describe_error(error: BaseException) -> str:
    """Describe an error in one line, with its notes, which name the job."""
    return " ".join([str(error), *(f"({note})" for note in getattr(error, "__notes__", ()))])


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
