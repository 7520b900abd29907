"""Work shared among processes on this machine or the nodes of a Ray cluster, with equal results."""

from surface_gym.sharing.cluster import Cluster
from surface_gym.sharing.crew import Job, Tell, WorkFailed
from surface_gym.sharing.jobs import Workers, check_workers, quiet, share, workers_of

__all__ = [
    "Cluster",
    "Job",
    "Tell",
    "WorkFailed",
    "Workers",
    "check_workers",
    "quiet",
    "share",
    "workers_of",
]
