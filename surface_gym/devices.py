"""Where a vector environment runs: on the CPU, or on a GPU."""

from collections.abc import Callable
from functools import partial
from typing import Any

from surface_gym import checks
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.vector_env import FlowVectorEnv
from surface_gym.settings import Settings
from surface_gym.vector_env import SmartSurfaceVectorEnv

DEVICES = ("cpu", "cuda")


def make_vector_env(num_envs: int = 1, device: str = "cpu", **arguments: Any) -> Any:
    """What `gym.make_vec` gives: `SmartSurfaceVectorEnv`, or on a GPU `gpu.vector_env`'s.

    Args:
        num_envs: number of lanes.
        device: "cpu" or "cuda".
        arguments: those of `SmartSurfaceVectorEnv`.

    Raises:
        ValueError: an argument is not allowed, or not on this device.
        DeviceMissing: there is no GPU, or not what it takes to use it.
    """
    return _made(SmartSurfaceVectorEnv, make_device_env, num_envs, device, arguments)


def make_flow_vector_env(num_envs: int = 1, device: str = "cpu", **arguments: Any) -> Any:
    """The same of `FlowVectorEnv`."""
    return _made(FlowVectorEnv, make_device_flow, num_envs, device, arguments)


def _made(
    of_cpu: Callable[..., Any],
    of_device: Callable[..., Any],
    num_envs: int,
    device: str,
    arguments: dict[str, Any],
) -> Any:
    if checks.one_of("device", device, DEVICES) == "cpu":
        return of_cpu(num_envs, **arguments)
    from surface_gym.cuda.env import check_device

    check_device()
    return of_device(num_envs, device, **arguments)


def make_device_env(num_envs: int, device: str, **arguments: Any) -> Any:
    """The vector environment of tensors on a device, whatever it is.

    Raises:
        ValueError: an argument is not allowed, or not on this device.
    """
    from surface_gym.cuda.batch import CudaBatch
    from surface_gym.cuda.env import check_settings

    face, settings = _parted(device, arguments)
    made = Settings(**settings)
    check_settings(made)
    return _on_device(num_envs, made, partial(CudaBatch, made), device, face)


def make_device_flow(num_envs: int, device: str, **arguments: Any) -> Any:
    """The vector environment of flows of tensors on a device, whatever it is.

    Raises:
        ValueError: an argument is not allowed, or not on this device.
    """
    from surface_gym.cuda.batch import CudaStreamBatch
    from surface_gym.cuda.env import check_sensor

    face, settings = _parted(device, arguments)
    made = FlowSettings(**settings)
    check_sensor(made)
    return _on_device(num_envs, made, partial(CudaStreamBatch, made), device, face)


def _on_device(
    num_envs: int, settings: Any, make_batch: Any, device: str, face: dict[str, Any]
) -> Any:
    import torch

    from surface_gym.cuda.env import CudaVectorEnv

    return CudaVectorEnv(num_envs, settings, make_batch, device=torch.device(device), **face)


def _parted(device: str, arguments: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The arguments of the face, and those of the settings."""
    for name, only in (("threads", 1), ("render_mode", None)):
        given = arguments.pop(name, only)
        if given != only:
            raise ValueError(f"{name} must be {only} where device is {device!r}, got {given!r}")
    face = {"max_episode_steps": None, "autoreset_mode": "NextStep"}
    return {name: arguments.pop(name, usual) for name, usual in face.items()}, arguments
