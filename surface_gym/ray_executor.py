"""An executor on the nodes of a Ray cluster. Ray is imported on first use."""

import hashlib
import logging
import pickle
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from surface_gym import executors

COUNT_EVERY = 1.0  # [s] between counts of the processors, since nodes come and go
AHEAD = 2  # submitted jobs per processor of the cluster
OF_RESULTS = (
    ".py",
    ".yml",
    ".yaml",
    ".json",
    ".safetensors",
)  # endings of files that results depend on


@lru_cache(maxsize=1)
def own_build() -> str:
    """Return the version of this process's package, and a digest of its code and policies."""
    from surface_gym import __version__

    found = {}  # by names that are equal in a checkout and in an installation
    for package in ("surface_gym", "surface_gym.agents"):
        spec = find_spec(package)
        for place in (spec.submodule_search_locations or ()) if spec is not None else ():
            for file in Path(place).rglob("*"):
                if file.suffix in OF_RESULTS:
                    name = file.relative_to(place).as_posix()
                    found[f"{package.replace('.', '/')}/{name}"] = file.read_bytes()
    total = hashlib.sha256()
    for name, content in sorted(found.items()):
        total.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    return f"version {__version__} (files {total.hexdigest()[:8]})"


class RayExecutor:
    """An executor with one job per processor of the cluster; nodes may come and go.

    Raises:
        ValueError: there is no cluster at the address, or Ray is not installed.
    """

    def __init__(self, cluster: executors.Cluster) -> None:
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

    def submit(self, index: int, job: executors.Job[Any]) -> None:
        work = self._work.remote(own_build(), pickle.dumps(job), self._mailbox)
        self._busy[work] = index

    def events(self) -> Iterator[executors.Event]:
        busy = list(self._busy)
        self._ray.wait(busy, timeout=executors.POLL)
        over, _ = self._ray.wait(busy, num_returns=len(busy), timeout=0)
        lasts = [self._last_message(reference) for reference in over]
        by_task = {reference.task_id().hex(): index for reference, index in self._busy.items()}
        for task, packed in self._ray.get(self._mailbox.empty.remote()):
            if task in by_task:  # else its node was given up
                yield by_task[task], executors.REPORTED, pickle.loads(packed)
        for reference, message in zip(over, lasts, strict=True):
            yield self._busy.pop(reference), *message

    def _last_message(self, reference: Any) -> executors.Message:
        try:
            last: executors.Message = self._ray.get(reference)
        except self._ray.exceptions.TaskCancelledError as loss:  # also before the job began
            return executors.LOST, type(loss).__name__
        except self._ray.exceptions.RayTaskError:  # raised outside the job: no loss
            raise
        except self._ray.exceptions.RayError as loss:
            return executors.LOST, type(loss).__name__
        return last

    def interrupt(self) -> None:
        for reference in self._busy:
            self._ray.cancel(reference)

    def close(self) -> None:
        for reference in self._busy:
            self._ray.cancel(reference, force=True)


class _Mailbox:
    """Reports of all jobs, on the node of the submitting process."""

    def __init__(self) -> None:
        self._letters: list[tuple[str, bytes]] = []

    def put(self, task: str, value: bytes) -> None:
        self._letters.append((task, value))

    def empty(self) -> list[tuple[str, bytes]]:
        letters, self._letters = self._letters, []
        return letters


def _work(build: str, packed: bytes, mailbox: Any) -> executors.Message:
    """Run a job on a node, unless the node has another build."""
    import ray

    if own_build() != build:
        error = executors.WorkError(
            f"the node {socket.gethostname()} has surface_gym {own_build()}, the submitting "
            f"machine {build}: install the same on both"
        )
        return executors.FAILED, (error, "")
    task = ray.get_runtime_context().get_task_id()
    return executors.run_packed(
        packed, lambda value: ray.get(mailbox.put.remote(task, pickle.dumps(value)))
    )


@lru_cache(maxsize=1)
def _remote_parts(job: str) -> tuple[Any, Any]:
    """Make the remote function and the mailbox, once per connection."""
    del job
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    mailbox = ray.remote(num_cpus=0)(_Mailbox).options(scheduling_strategy=here).remote()
    # `map_jobs` submits lost jobs again, on every executor.
    return ray.remote(num_cpus=1, max_retries=0)(_work), mailbox


def _connect(cluster: executors.Cluster) -> Any:
    """Return Ray, connected to the cluster once per process."""
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
