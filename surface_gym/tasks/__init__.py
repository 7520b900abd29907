"""The tasks: starts, observations, reward terms and ends of episodes."""

from surface_gym.tasks.base import Task
from surface_gym.tasks.orient import Orient
from surface_gym.tasks.park import Park
from surface_gym.tasks.slow import Slow
from surface_gym.tasks.sort import Sort
from surface_gym.tasks.stop import Stop
from surface_gym.tasks.track import Track

TASKS: dict[str, type[Task]] = {
    "sort": Sort,
    "slow": Slow,
    "stop": Stop,
    "track": Track,
    "orient": Orient,
    "park": Park,
}

__all__ = ["TASKS", "Orient", "Park", "Slow", "Sort", "Stop", "Task", "Track"]
