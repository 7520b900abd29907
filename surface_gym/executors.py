"""Executors: processes of this machine, or the nodes of a Ray cluster, that run jobs.

An executor takes jobs, and yields their messages. A job sends reports, and at the end a result or
an error. If a job's process dies, the last message is a loss instead. Ray is imported on first use.
"""

import hashlib
import logging
import os
import pickle
import shutil
import signal
import socket
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
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

COUNT_EVERY = 1.0  # [s] between counts of the processors, since nodes come and go
AHEAD = 2  # submitted jobs per processor of the cluster
# Endings of files that results depend on.
OF_RESULTS = (".py", ".yml", ".yaml", ".json", ".safetensors")

# Processes are spawned, since a fork would copy locks of other libraries' threads.
_SPAWN = get_context("spawn")


class WorkError(Exception):
    """Raised if jobs cannot run, e.g. because a node has another version of the package."""


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster that this machine has joined."""

    address: str  # host:port of its head, or "auto" for the joined cluster
    files: tuple[Path, ...] = ()  # files of custom tasks for nodes, below the working folder

    def __post_init__(self) -> None:
        if not self.address or self.address.startswith("ray://"):
            raise ValueError(
                "cluster must be host:port, or auto, of a cluster that this machine has joined by "
                f"`ray start --address=...`, got {self.address!r}"
            )


class Job(Protocol[Result_co]):
    """A job that other processes can import: a function, or a `functools.partial` of a function."""

    def __call__(self, report: Report, /) -> Result_co:
        """Run the job; call `report` with progress from time to time."""


def describe_error(error: BaseException) -> str:
    """Describe an error and its notes in one line. A note may name the job that failed."""
    return " ".join([str(error), *(f"({note})" for note in getattr(error, "__notes__", ()))])


class RemoteTraceback(Exception):
    """The traceback of an error from another process."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


def run_packed(packed: bytes, report: Report) -> Message:
    """Run a job, pickled as `packed`, in this process; return its result or error as a message."""
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
        """Run `job` in up to `most` processes, to prepare the processes for later jobs."""
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
        """Yield messages of jobs. Wait at most `POLL` seconds for the first message."""
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
        """Interrupt all running jobs, as Ctrl-C does."""
        if os.name == "posix":  # on other systems, Ctrl-C has reached them already
            for process, _ in self._busy.values():
                os.kill(process.pid, signal.SIGINT)

    def close(self) -> None:
        """End all jobs and processes."""
        busy = [(process, pipe) for pipe, (process, _) in self._busy.items()]
        started = [*self._idle, *busy]
        for process, pipe in started:  # idle processes too: they take a second to unload libraries
            process.terminate()
            pipe.close()
        for process, _ in started:
            process.join()


def _start_process() -> tuple[Any, Any]:
    """Return a new process and its pipe. Interrupts cannot end the process while it starts."""
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


@lru_cache(maxsize=1)
def own_build() -> str:
    """Return the package's version in this process, and a digest of its code and policies."""
    from surface_gym import __version__

    found = {}  # by names that are equal in a checkout and in an installation
    for package in ("surface_gym", "surface_gym.agents"):
        folder = Path(str(resources.files(package)))
        for file in folder.rglob("*"):
            if file.suffix in OF_RESULTS:
                name = file.relative_to(folder).as_posix()
                found[f"{package.replace('.', '/')}/{name}"] = file.read_bytes()
    total = hashlib.sha256()
    for name, content in sorted(found.items()):
        total.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    return f"version {__version__} (files {total.hexdigest()[:8]})"


class RayExecutor:
    """An executor that runs one job on each processor of a Ray cluster. Nodes may come and go.

    Raises:
        ValueError: there is no cluster at the address, or Ray is not installed.
    """

    def __init__(self, cluster: Cluster) -> None:
        self._ray = _connect(cluster)
        self._work, self._mailbox = _remote_parts(self._ray.get_runtime_context().get_job_id())
        self._counted, self._processors = -COUNT_EVERY, 0
        self._busy: dict[Any, int] = {}  # by reference: the job's index

    @property
    def free(self) -> int:
        if time.monotonic() > self._counted + COUNT_EVERY:
            self._counted = time.monotonic()
            self._processors = int(self._ray.cluster_resources().get("CPU", 0))
        return max(1, AHEAD * self._processors) - len(self._busy)

    @property
    def running(self) -> int:
        return len(self._busy)

    def submit(self, index: int, job: Job[Any]) -> None:
        work = self._work.remote(own_build(), pickle.dumps(job), self._mailbox)
        self._busy[work] = index

    def events(self) -> Iterator[Event]:
        busy = list(self._busy)
        self._ray.wait(busy, timeout=POLL)
        over, _ = self._ray.wait(busy, num_returns=len(busy), timeout=0)
        lasts = [self._last_message(reference) for reference in over]
        by_task = {reference.task_id().hex(): index for reference, index in self._busy.items()}
        for task, packed in self._ray.get(self._mailbox.empty.remote()):
            if task in by_task:  # else its node was given up
                yield by_task[task], REPORTED, pickle.loads(packed)
        for reference, message in zip(over, lasts, strict=True):
            yield self._busy.pop(reference), *message

    def _last_message(self, reference: Any) -> Message:
        try:
            last: Message = self._ray.get(reference)
        except self._ray.exceptions.TaskCancelledError as loss:  # also before the job began
            return LOST, type(loss).__name__
        except self._ray.exceptions.RayTaskError:  # raised outside the job: no loss
            raise
        except self._ray.exceptions.RayError as loss:
            return LOST, type(loss).__name__
        return last

    def interrupt(self) -> None:
        for reference in self._busy:
            self._ray.cancel(reference)

    def close(self) -> None:
        for reference in self._busy:
            self._ray.cancel(reference, force=True)


class _Mailbox:
    """Reports of all jobs, collected on the node of the process that submits the jobs."""

    def __init__(self) -> None:
        self._letters: list[tuple[str, bytes]] = []

    def put(self, task: str, value: bytes) -> None:
        self._letters.append((task, value))

    def empty(self) -> list[tuple[str, bytes]]:
        letters, self._letters = self._letters, []
        return letters


def _work_on_node(build: str, packed: bytes, mailbox: Any) -> Message:
    """Run a pickled job on a node; return an error if the node's build is not `build`.

    The job's reports go to the actor `mailbox`.
    """
    import ray

    if own_build() != build:
        error = WorkError(
            f"the node {socket.gethostname()} has surface_gym {own_build()}, the submitting "
            f"machine {build}: install the same on both"
        )
        return FAILED, (error, "")
    task = ray.get_runtime_context().get_task_id()
    return run_packed(packed, lambda value: ray.get(mailbox.put.remote(task, pickle.dumps(value))))


@lru_cache(maxsize=1)
def _remote_parts(job: str) -> tuple[Any, Any]:
    """Make the remote function and the mailbox, once for each connection to Ray.

    `job` is the connection's id.
    """
    del job
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    mailbox = ray.remote(num_cpus=0)(_Mailbox).options(scheduling_strategy=here).remote()
    # `map_jobs` submits lost jobs again, on every executor.
    return ray.remote(num_cpus=1, max_retries=0)(_work_on_node), mailbox


def _connect(cluster: Cluster) -> Any:
    """Connect this process to the cluster, unless connected before; return the module `ray`."""
    try:
        import ray
    except ImportError:
        raise ValueError(
            "cluster must not be given without Ray: pip install 'surface_gym[cluster]'"
        ) from None
    if ray.is_initialized():
        return ray
    with tempfile.TemporaryDirectory() as folder:
        for file in cluster.files:  # which nodes need, at the same relative paths
            if not file.is_absolute():
                (Path(folder) / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, Path(folder) / file)
        try:
            ray.init(
                cluster.address,
                runtime_env={"working_dir": folder} if any(Path(folder).iterdir()) else {},
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
        except (ConnectionError, RuntimeError) as error:
            raise ValueError(
                f"cluster must be the address of a Ray cluster, got {cluster.address!r}: {error}; "
                "one that asks for a token wants RAY_AUTH_MODE=token set here, too"
            ) from None
    return ray
