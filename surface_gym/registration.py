"""Tasks by name, and ids for `gymnasium.make` and `gymnasium.make_vec`."""

from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym

from surface_gym.registry import Registry

if TYPE_CHECKING:
    from surface_gym.tasks.base import Task


class ShippedTask(NamedTuple):
    """A task of the package, imported on first use."""

    place: str  # "module:Class"
    periods: int | None  # `Task.periods`; None: a stream, which ends by itself


SHIPPED = {
    "sort": ShippedTask("surface_gym.tasks.sort:Sort", 100),
    "slow": ShippedTask("surface_gym.tasks.slow:Slow", 100),
    "stop": ShippedTask("surface_gym.tasks.stop:Stop", 150),
    "track": ShippedTask("surface_gym.tasks.track:Track", 300),
    "orient": ShippedTask("surface_gym.tasks.orient:Orient", 200),
    "park": ShippedTask("surface_gym.tasks.park:Park", 150),
    "flow": ShippedTask("surface_gym.flow.task:Flow", None),
    "singulate": ShippedTask("surface_gym.flow.slope_tasks:Singulate", None),
    "merge": ShippedTask("surface_gym.flow.slope_tasks:Merge", None),
    "sequence": ShippedTask("surface_gym.flow.slope_tasks:Sequence", None),
}
DEFAULT_TASK, DEFAULT_STREAM = "sort", "flow"
DEFAULT_SLOPE = "singulate"  # default task for modules as agents
PERIODS = {name: each.periods for name, each in SHIPPED.items()}

# Every task by name: of the package, of plugins, and of users who call `register`.
TASKS: "Registry[type[Task]]" = Registry(
    "task", imports={name: each.place for name, each in SHIPPED.items()}
)
_IDS: dict[str, str] = {}  # ids of other tasks than the package's


def env_id(task: str) -> str:
    """Return the Gymnasium id of a task by its name."""
    return _IDS.get(task, f"SmartSurface/{task.capitalize()}-v0")


def register(task: "type[Task]", name: str) -> None:
    """Register your task in Gymnasium by an id, e.g. "Mine/Reach-v0".

    `name` is the id. The task's name is the lower-case name of the task's class, here "reach". If a
    task is registered again by the same id, the new task replaces the old task.

    Raises:
        ValueError: the task's name belongs to a task of the package, or to another id.
    """
    made = task()
    again = _IDS.get(made.name) == name
    TASKS.register(made.name, task, replace=again)
    if again:
        gym.registry.pop(name, None)
    _IDS[made.name] = name
    _register(name, made, None if made.is_stream else made.periods)


def register_all() -> None:
    """Register `SmartSurface/<Task>-v0` for every task of the package."""
    for name, shipped in SHIPPED.items():
        _register(env_id(name), name, shipped.periods)


def _register(name: str, given: Any, periods: int | None) -> None:
    gym.register(
        id=name,
        entry_point="surface_gym.env:SmartSurfaceEnv",
        vector_entry_point="surface_gym.vector_env:make_vector_env",
        max_episode_steps=periods,
        kwargs={"task": given},
    )
