"""The ids that `gymnasium.make` and `gymnasium.make_vec` know."""

from typing import TYPE_CHECKING, Any

import gymnasium as gym

from surface_gym import checks

if TYPE_CHECKING:
    from surface_gym.tasks.base import Task

FLOW_TASK = "flow"  # the task of streams of parcels
ON_SLOPES = ("singulate", "merge", "sequence")  # tasks on streams with a take-away
# Control periods after which Gymnasium truncates an episode, by task: `Task.periods`, written down
# here too so that no task is imported before it is used. None: a stream ends by itself.
PERIODS = {
    "sort": 100, "slow": 100, "stop": 150, "track": 300, "orient": 200, FLOW_TASK: None,
    **dict.fromkeys(ON_SLOPES),
}  # fmt: skip


def env_id(task: str) -> str:
    """Return the id of one of the package's environments, by its task's name."""
    return f"SmartSurface/{task.capitalize()}-v0"


FLOW = env_id(FLOW_TASK)
DEVICES = ("cpu", "cuda")


def register(task: "type[Task]", name: str) -> None:
    """Register a user's task in Gymnasium by a name such as "Mine/Reach-v0"."""
    from surface_gym.flow.task import StreamTask

    _register(name, task(), None if issubclass(task, StreamTask) else task.periods)


def register_all() -> None:
    """Register `SmartSurface/<Task>-v0` for every task of the package."""
    for name, periods in PERIODS.items():
        _register(env_id(name), name, periods)


def _register(name: str, given: Any, periods: int | None) -> None:
    gym.register(
        id=name,
        entry_point="surface_gym.env:SmartSurfaceEnv",
        vector_entry_point="surface_gym.registration:make_vector_env",
        max_episode_steps=periods,
        kwargs={"task": given},
    )


def make_vector_env(num_envs: int = 1, device: str = "cpu", **arguments: Any) -> Any:
    """Make the vector environment of `gym.make_vec`, on the CPU or on a GPU.

    Args:
        num_envs: number of environments.
        device: "cpu" or "cuda".
        arguments: those of `SmartSurfaceVectorEnv`.

    Raises:
        ValueError: an argument is not allowed, or not on this device.
        DeviceMissing: there is no GPU, or a library to use it is missing.
    """
    if checks.one_of("device", device, DEVICES) == "cpu":
        from surface_gym.vector_env import SmartSurfaceVectorEnv

        return SmartSurfaceVectorEnv(num_envs, **arguments)
    from surface_gym.cuda import check_device

    check_device()
    return make_device_env(num_envs, device, **arguments)


def make_device_env(num_envs: int, device: str, **arguments: Any) -> Any:
    """Make the vector environment of tensors on a device of torch.

    Raises:
        ValueError: an argument is not allowed, or not on this device.
    """
    import torch

    from surface_gym.cuda.env import CudaVectorEnv

    for name, only in (("threads", 1), ("render_mode", None)):
        given = arguments.pop(name, only)
        if given != only:
            raise ValueError(f"{name} must be {only} where device is {device!r}, got {given!r}")
    return CudaVectorEnv(num_envs, device=torch.device(device), **arguments)
