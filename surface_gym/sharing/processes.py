"""A crew of processes on this machine."""

import os
import pickle
import signal
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any

from surface_gym.sharing.crew import LOST, POLL, TOLD, Heard, Job, Tell, as_raised, attempt

# Spawned, not forked: a fork copies the threads' locks of whatever is loaded here.
_SPAWN = get_context("spawn")
READY = "ready"  # a word of a worker


class _Worker:
    """A process that does one job after the other."""

    def __init__(self) -> None:
        self.is_ready = False  # it has read its first job, with all that this imports
        self.pipe, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_work, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()


class Processes:
    """So many processes at most, started as they are needed."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._idle: list[_Worker] = []
        self._busy: dict[Any, tuple[_Worker, int]] = {}  # by pipe, with the job's place

    @property
    def free(self) -> int:
        return self._count - len(self._busy)

    @property
    def running(self) -> int:
        return len(self._busy)

    def hand(self, place: int, job: Job[Any]) -> None:
        worker = self._idle.pop() if self._idle else _Worker()
        self._busy[worker.pipe] = worker, place
        with suppress(OSError):  # it has died while idle, which listening tells
            worker.pipe.send_bytes(pickle.dumps(job))

    def listen(self) -> Iterator[Heard]:
        for pipe in wait(list(self._busy), POLL):
            worker, place = self._busy[pipe]
            try:
                word = worker.pipe.recv()
            except (EOFError, OSError):
                del self._busy[pipe]
                worker.process.join()
                yield place, LOST, f"exit code {worker.process.exitcode}"
                continue
            worker.is_ready = True
            if word[0] not in (TOLD, READY):
                del self._busy[pipe]
                self._idle.append(worker)
            if word[0] != READY:
                yield place, *as_raised(word)

    def interrupt(self) -> None:
        if os.name == "posix":  # elsewhere Ctrl-C has reached them already
            for worker, _ in self._busy.values():
                if worker.is_ready and worker.process.pid is not None:
                    os.kill(worker.process.pid, signal.SIGINT)
                else:
                    worker.process.terminate()

    def close(self) -> None:
        for worker, _ in self._busy.values():
            worker.process.terminate()
        for worker in [*self._idle, *(worker for worker, _ in self._busy.values())]:
            worker.pipe.close()
            worker.process.join()


def _work(pipe: "Connection[Any, Any]") -> None:
    """What a worker does until whoever hands it jobs closes the pipe, or is no more."""
    if os.name == "posix":
        os.setpgid(0, 0)  # so that Ctrl-C comes from whoever hands out, and only once
    try:
        while True:
            pipe.send(attempt(partial(_unpacked, pipe.recv_bytes(), pipe), partial(_tell, pipe)))
    except (EOFError, BrokenPipeError, ConnectionResetError, KeyboardInterrupt):
        return


def _unpacked(packed: bytes, pipe: "Connection[Any, Any]", tell: Tell) -> Any:
    """What the job that was handed over gives."""
    job = pickle.loads(packed)
    pipe.send((READY, None))
    return job(tell)


def _tell(pipe: "Connection[Any, Any]", value: Any) -> None:
    pipe.send((TOLD, value))
