"""A crew of a Ray cluster's nodes. Ray is imported when the first crew is made."""

import logging
import pickle
import shutil
import tempfile
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any
from uuid import uuid4

from surface_gym.sharing.cluster import Build, Cluster, check_build, own_build
from surface_gym.sharing.crew import LOST, POLL, TOLD, Heard, Job, Word, as_raised, attempt

COUNT_EVERY = 1.0  # [s] that processors are counted anew, since nodes come and go
AHEAD = 2  # jobs for each processor that a cluster is handed at a time


class RayCrew:
    """As many jobs at a time as the cluster has processors, nodes that come and go included.

    Raises:
        ValueError: there is no cluster at the address, or Ray is not installed.
    """

    def __init__(self, cluster: Cluster) -> None:
        self._ray = _connected(cluster)
        self._work, self._letterbox = _equipment(self._ray.get_runtime_context().get_job_id())
        self._counted, self._processors = -COUNT_EVERY, 0
        self._busy: dict[Any, tuple[str, int]] = {}  # by reference: a number, and the job's place

    @property
    def free(self) -> int:
        if time.monotonic() > self._counted + COUNT_EVERY:
            self._counted = time.monotonic()
            self._processors = int(self._ray.cluster_resources().get("CPU", 0))
        return max(1, AHEAD * self._processors) - len(self._busy)

    @property
    def running(self) -> int:
        return len(self._busy)

    def hand(self, place: int, job: Job[Any]) -> None:
        number = uuid4().hex
        work = self._work.remote(own_build(), pickle.dumps(job), number, self._letterbox)
        self._busy[work] = number, place

    def listen(self) -> Iterator[Heard]:
        busy = list(self._busy)
        self._ray.wait(busy, timeout=POLL)
        over, _ = self._ray.wait(busy, num_returns=len(busy), timeout=0)
        lasts = [self._last(reference) for reference in over]
        if not over or any(has_told for has_told, _ in lasts):
            places = dict(self._busy.values())  # without attempts that were given up
            for number, packed in self._ray.get(self._letterbox.take.remote()):
                if number in places:
                    yield places[number], TOLD, pickle.loads(packed)
        for reference, (_, word) in zip(over, lasts, strict=True):
            _, place = self._busy.pop(reference)
            yield place, *as_raised(word)

    def _last(self, reference: Any) -> tuple[bool, Word]:
        """Whether a job that is over has told anything before, and its last word."""
        try:
            last: tuple[bool, Word] = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError:  # raised outside the job: no loss
            raise
        except self._ray.exceptions.RayError as loss:
            return True, (LOST, type(loss).__name__)
        return last

    def interrupt(self) -> None:
        for reference in self._busy:
            self._ray.cancel(reference)

    def close(self) -> None:
        for reference in self._busy:
            self._ray.cancel(reference, force=True)


class _Letterbox:
    """Where jobs leave what they tell; it stands beside whoever hands them out."""

    def __init__(self) -> None:
        self._letters: list[tuple[str, bytes]] = []

    def put(self, number: str, packed: bytes) -> None:
        self._letters.append((number, packed))

    def take(self) -> list[tuple[str, bytes]]:
        taken, self._letters = self._letters, []
        return taken


def _work(build: Build, packed: bytes, number: str, letterbox: Any) -> tuple[bool, Word]:
    """Do a job on a node: whether it told anything, which is there by now, and its last word."""
    import ray

    has_told = False

    def tell(value: Any) -> None:
        nonlocal has_told
        has_told = True
        ray.get(letterbox.put.remote(number, pickle.dumps(value)))

    def job(tell: Any) -> Any:
        check_build(build)
        return pickle.loads(packed)(tell)

    word = attempt(job, tell)
    return has_told, word


@lru_cache(maxsize=1)
def _equipment(job: str) -> tuple[Any, Any]:
    """What does the work, and the letterbox beside it, once for a connection's name."""
    del job
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    letterbox = ray.remote(num_cpus=0)(_Letterbox).options(scheduling_strategy=here).remote()
    # Lost jobs are handed out again by `share`, whoever carries them out.
    return ray.remote(num_cpus=1, max_retries=0)(_work), letterbox


def _connected(cluster: Cluster) -> Any:
    """Ray, connected to the cluster once a process."""
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
                    runtime_env=_runtime(cluster, Path(folder)),
                    log_to_driver=False,
                    logging_level=logging.ERROR,
                )
        except (ConnectionError, RuntimeError) as error:
            raise ValueError(
                f"cluster must be the address of a Ray cluster, got {cluster.address!r}: {error}; "
                "one that asks for a token wants RAY_AUTH_MODE=token set here, too"
            ) from None
    return ray


def _runtime(cluster: Cluster, folder: Path) -> dict[str, str]:
    """The files that nodes need, at the same places below their working folders as in a folder."""
    below = [file for file in cluster.files if not file.is_absolute()]
    if not below:
        return {}
    for file in below:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, folder / file)
    return {"working_dir": str(folder)}
