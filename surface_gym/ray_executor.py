"""An executor on the nodes of a Ray cluster. Ray is imported when the first one is made."""

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
from uuid import uuid4

from surface_gym import parallel

COUNT_EVERY = 1.0  # [s] between counts of the processors, since nodes come and go
AHEAD = 2  # jobs submitted at a time for each processor of the cluster
POLICY_FILES = (".safetensors", ".yaml")


@lru_cache(maxsize=1)
def own_build() -> str:
    """Return version and digests of the package that this process has."""
    from surface_gym import __version__

    code, policies = _digest((".py", ".yml", ".json")), _digest(POLICY_FILES)
    return f"version {__version__} (code {code}, policies {policies})"


def check_build(wanted: str) -> None:
    """Refuse work from a process of another build."""
    if own_build() != wanted:
        raise parallel.WorkFailed(
            f"the node {socket.gethostname()} has surface_gym {own_build()}, the submitting "
            f"machine {wanted}: install the same on both"
        )


def _digest(endings: tuple[str, ...]) -> str:
    total = hashlib.sha256()
    for name, file in sorted(_package_files().items()):
        if file.suffix in endings:
            total.update(f"{name} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    return total.hexdigest()[:8]


def _package_files() -> dict[str, Path]:
    """Files of the package and its agents, by names that are the same in every installation."""
    files = {}
    for package, label in (
        (__package__, "surface_gym"),
        ("surface_gym.agents", "surface_gym/agents"),
    ):
        found = find_spec(package)
        for place in found.submodule_search_locations or () if found is not None else ():
            root = Path(place)
            for file in root.rglob("*"):
                files[f"{label}/{file.relative_to(root).as_posix()}"] = file
    return files


class RayExecutor:
    """An executor of as many jobs as the cluster has processors; nodes may come and go.

    Raises:
        ValueError: there is no cluster at the address, or Ray is not installed.
    """

    def __init__(self, cluster: parallel.Cluster) -> None:
        self._ray = _connect(cluster)
        self._work, self._mailbox = _remote_parts(self._ray.get_runtime_context().get_job_id())
        self._counted, self._processors = -COUNT_EVERY, 0
        self._busy: dict[Any, tuple[str, int]] = {}  # by reference: attempt and the job's index

    @property
    def free(self) -> int:
        if time.monotonic() > self._counted + COUNT_EVERY:
            self._counted = time.monotonic()
            self._processors = int(self._ray.cluster_resources().get("CPU", 0))
        return max(1, AHEAD * self._processors) - len(self._busy)

    @property
    def running(self) -> int:
        return len(self._busy)

    def submit(self, index: int, job: parallel.Job[Any]) -> None:
        attempt = uuid4().hex
        work = self._work.remote(own_build(), pickle.dumps(job), attempt, self._mailbox)
        self._busy[work] = attempt, index

    def events(self) -> Iterator[parallel.Event]:
        busy = list(self._busy)
        self._ray.wait(busy, timeout=parallel.POLL)
        over, _ = self._ray.wait(busy, num_returns=len(busy), timeout=0)
        lasts = [self._last_message(reference) for reference in over]
        if not over or any(has_reported for has_reported, _ in lasts):
            indices = dict(self._busy.values())  # without attempts that were given up
            for attempt, packed in self._ray.get(self._mailbox.empty.remote()):
                if attempt in indices:
                    yield indices[attempt], parallel.REPORTED, pickle.loads(packed)
        for reference, (_, message) in zip(over, lasts, strict=True):
            _, index = self._busy.pop(reference)
            yield index, *parallel.received(message)

    def _last_message(self, reference: Any) -> tuple[bool, parallel.Message]:
        """Return whether a job that is over has reported before, and its last message."""
        try:
            last: tuple[bool, parallel.Message] = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError:  # raised outside the job: no loss
            raise
        except self._ray.exceptions.RayError as loss:
            return True, (parallel.LOST, type(loss).__name__)
        return last

    def interrupt(self) -> None:
        for reference in self._busy:
            self._ray.cancel(reference)

    def close(self) -> None:
        for reference in self._busy:
            self._ray.cancel(reference, force=True)


class _Mailbox:
    """Reports of all jobs; it stands beside the submitting process."""

    def __init__(self) -> None:
        self._letters: list[tuple[str, bytes]] = []

    def put(self, attempt: str, packed: bytes) -> None:
        self._letters.append((attempt, packed))

    def empty(self) -> list[tuple[str, bytes]]:
        letters, self._letters = self._letters, []
        return letters


def _work(build: str, packed: bytes, attempt: str, mailbox: Any) -> tuple[bool, parallel.Message]:
    """Do a job on a node; return whether it reported, which has arrived, and its last message."""
    import ray

    has_reported = False

    def report(value: Any) -> None:
        nonlocal has_reported
        has_reported = True
        ray.get(mailbox.put.remote(attempt, pickle.dumps(value)))

    def job(report: Any) -> Any:
        check_build(build)
        return pickle.loads(packed)(report)

    message = parallel.run_remotely(job, report)
    return has_reported, message


@lru_cache(maxsize=1)
def _remote_parts(job: str) -> tuple[Any, Any]:
    """Make the remote function and the mailbox, once for the id of a connection."""
    del job
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    mailbox = ray.remote(num_cpus=0)(_Mailbox).options(scheduling_strategy=here).remote()
    # `map_jobs` submits lost jobs again, on every executor.
    return ray.remote(num_cpus=1, max_retries=0)(_work), mailbox


def _connect(cluster: parallel.Cluster) -> Any:
    """Return Ray, connected to the cluster once a process."""
    try:
        import ray
    except ImportError:
        raise ValueError(
            "cluster must not be given without Ray: pip install 'surface_gym[cluster]'"
        ) from None
    if not ray.is_initialized():
        try:
            with tempfile.TemporaryDirectory() as folder:
                ray.init(
                    cluster.address,
                    runtime_env=_runtime_env(cluster, Path(folder)),
                    log_to_driver=False,
                    logging_level=logging.ERROR,
                )
        except (ConnectionError, RuntimeError) as error:
            raise ValueError(
                f"cluster must be the address of a Ray cluster, got {cluster.address!r}: {error}; "
                "one that asks for a token wants RAY_AUTH_MODE=token set here, too"
            ) from None
    return ray


def _runtime_env(cluster: parallel.Cluster, folder: Path) -> dict[str, str]:
    """Copy the files that nodes need into a folder, at the same relative paths."""
    below = [file for file in cluster.files if not file.is_absolute()]
    if not below:
        return {}
    for file in below:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, folder / file)
    return {"working_dir": str(folder)}
