"""Jobs that do not depend on each other, handed out, and what comes back of them."""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from surface_gym import checks
from surface_gym.sharing.cluster import Cluster
from surface_gym.sharing.crew import DONE, LOST, TOLD, Crew, Job, Tell, WorkFailed
from surface_gym.sharing.processes import Processes
from surface_gym.sharing.ray_crew import RayCrew

Result = TypeVar("Result")
Heard = Callable[[int, Any], None]  # the job's place, and what it told
Workers = int | Cluster  # processes on this machine, or a cluster

LOSSES = 10  # processes that a job may cost without a word from it


def share(
    jobs: Sequence[Job[Result]], workers: Workers, heard: Heard = lambda *_: None
) -> Iterator[tuple[int, Result]]:
    """Carry jobs out, and yield the place of each and its result as they are done, in any order.

    A job whose process or node dies is done again, from its beginning or from what it left on disk.
    An interrupt, or whatever else ends this, interrupts the jobs as well and waits for their last
    words.

    Args:
        jobs: functions of modules, or `functools.partial` of them, so that another process finds
            them; each is called with one argument, by which it tells how far it is.
        workers: processes to share them among, or a cluster; with one, jobs run in this process.
        heard: called with a job's place and what it told.

    Raises:
        WorkFailed: a job has cost `LOSSES` processes without a word, or a node has another version
            of the package.
        ValueError: there is no cluster at the address.
    """
    if not isinstance(workers, Cluster) and min(workers, len(jobs)) <= 1:
        for place, job in enumerate(jobs):
            yield place, job(partial(heard, place))
        return
    crew = RayCrew(workers) if isinstance(workers, Cluster) else Processes(workers)
    try:
        yield from _carried_out(jobs, crew, heard)
    except BaseException:
        _end(crew, heard)
        raise
    finally:
        crew.close()


def quiet(job: Callable[[], Result], tell: Tell) -> Result:
    """A job that tells nothing, as `share` calls it."""
    del tell
    return job()


def check_workers(workers: Workers) -> Workers:
    """A cluster, or at least one process.

    Raises:
        ValueError: it is neither.
    """
    return workers if isinstance(workers, Cluster) else checks.integer("workers", workers, least=1)


def workers_of(cluster: str | None, processes: int, files: tuple[Path, ...] = ()) -> Workers:
    """Who a command's options name: a cluster where there is an address, else processes.

    Args:
        cluster: its address.
        processes: on this machine.
        files: that a cluster's nodes need.

    Raises:
        ValueError: the address is not one that can be used.
    """
    return processes if cluster is None else Cluster(cluster, files)


def _carried_out(
    jobs: Sequence[Job[Result]], crew: Crew, heard: Heard
) -> Iterator[tuple[int, Result]]:
    waiting, left, losses = deque(range(len(jobs))), len(jobs), Counter[int]()
    while left:
        for _ in range(min(crew.free, len(waiting))):
            place = waiting.popleft()
            crew.hand(place, jobs[place])
        for place, kind, value in crew.listen():
            if kind == TOLD:
                losses[place] = 0
                heard(place, value)
            elif kind == DONE:
                left -= 1
                yield place, value
            elif kind == LOST:
                losses[place] += 1
                if losses[place] == LOSSES:
                    raise WorkFailed(f"a job has cost {LOSSES} processes; the last: {value}")
                waiting.appendleft(place)
            else:
                raise value


def _end(crew: Crew, heard: Heard) -> None:
    """Interrupt what is running, and hear it out."""
    crew.interrupt()
    while crew.running:
        for place, kind, value in crew.listen():
            if kind == TOLD:
                heard(place, value)
