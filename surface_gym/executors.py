"""Executors: processes of this machine that run jobs, and common parts of all executors.

An executor takes jobs, and yields their messages: reports, then a result, an error or a loss.
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
Message = tuple[str, Any]  # kind, and content: report, result, error or loss
Event = tuple[int, str, Any]  # a job's index, and its message's kind and content

REPORTED, DONE, FAILED, LOST = "reported", "done", "failed", "lost"
_LOADING = -1  # index of jobs whose results nobody takes
POLL = 0.2  # [s] maximum wait of an executor for events

# Processes are spawned, since a fork would copy locks of other libraries' threads.
_SPAWN = get_context("spawn")


class WorkError(Exception):
    """An error that prevents work on jobs, independent of a job."""


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster joined by this machine."""

    address: str  # host:port of its head, or "auto" for the joined cluster
    files: tuple[Path, ...] = ()  # files of custom tasks for nodes, below the working folder

    def __post_init__(self) -> None:
        if not self.address or self.address.startswith("ray://"):
            raise ValueError(
                "cluster must be host:port, or auto, of a cluster that this machine has joined by "
                f"`ray start --address=...`, got {self.address!r}"
            )


class Job(Protocol[Result_co]):
    """A job: a module's function or its `functools.partial`, which other processes can import."""

    def __call__(self, report: Report, /) -> Result_co:
        """Run the job; call `report` with progress from time to time."""


def describe_error(error: BaseException) -> str:
    """Describe an error in one line, with its notes, which contain the job's name."""
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
    """Processes of this machine, started on demand."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._idle: list[Any] = []  # a process and the pipe to it
        self._busy: dict[Any, tuple[Any, int]] = {}  # by pipe: a process and its job's index

    @property
    def free(self) -> int:
        """Number of free workers."""
        return self._count - len(self._busy)

    @property
    def running(self) -> int:
        """Number of unfinished jobs."""
        return len(self._busy)

    def load(self, job: Job[Any], most: int) -> None:
        """Start up to `most` processes with a job that only loads what later jobs need."""
        for _ in range(min(most, self.free)):
            self.submit(_LOADING, job)

    def finish_loading(self) -> None:
        """Wait for the jobs of `load`."""
        while self._busy:
            for _ in self.events():
                pass

    def submit(self, index: int, job: Job[Any]) -> None:
        process, pipe = self._idle.pop() if self._idle else _start_process()
        self._busy[pipe] = process, index
        with suppress(OSError):  # an idle process died, which `events` reports
            pipe.send_bytes(pickle.dumps(job))

    def events(self) -> Iterator[Event]:
        """Yield messages of jobs; wait at most `POLL` for the first."""
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
        """Interrupt all running jobs like Ctrl-C."""
        if os.name == "posix":  # on other systems, Ctrl-C has reached them already
            for process, _ in self._busy.values():
                os.kill(process.pid, signal.SIGINT)

    def close(self) -> None:
        """End all jobs and processes."""
        busy = [(process, pipe) for pipe, (process, _) in self._busy.items()]
        started = [*self._idle, *busy]
        for process, pipe in started:  # idle ones too: what they loaded takes a second to unload
            process.terminate()
            pipe.close()
        for process, _ in started:
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
            os.setpgid(0, 0)  # so that only the submitting process passes on Ctrl-C
            # A process that a shell starts in the background ignores SIGINT.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        while True:
            packed = pipe.recv_bytes()
            pipe.send(run_packed(packed, lambda value: pipe.send((REPORTED, value))))
