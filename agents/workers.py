"""Who does the work that a command hands out."""

from pathlib import Path

from surface_gym.sharing import Cluster, Workers


def workers_of(cluster: str | None, processes: int, task: str | None) -> Workers:
    """A cluster where there is an address, to which a task of one's own goes along; else processes.

    Raises:
        ValueError: the address is not one that can be used.
    """
    if cluster is None:
        return processes
    own = task is not None and ":" in task
    return Cluster(cluster, (Path(str(task).rpartition(":")[0]),) if own else ())
