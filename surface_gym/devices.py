"""Where a vector environment runs: on the CPU, or on a GPU."""

from typing import Any

from surface_gym import checks
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
    if checks.one_of("device", device, DEVICES) == "cpu":
        return SmartSurfaceVectorEnv(num_envs, **arguments)
    from surface_gym.gpu.needs import check_device

    check_device()
    return make_device_env(num_envs, device, **arguments)


def make_device_env(
    num_envs: int,
    device: str,
    max_episode_steps: int | None = None,
    autoreset_mode: Any = "NextStep",
    threads: int = 1,
    render_mode: str | None = None,
    **arguments: Any,
) -> Any:
    """The vector environment of tensors on a device.

    Raises:
        ValueError: an argument is not allowed, or not on this device.
    """
    import torch

    from surface_gym.gpu.vector_env import DeviceVectorEnv

    for name, value, only in (("threads", threads, 1), ("render_mode", render_mode, None)):
        if value != only:
            raise ValueError(f"{name} must be {only} where device is {device!r}, got {value!r}")
    settings = Settings(**arguments)
    place = torch.device(device)
    return DeviceVectorEnv(num_envs, settings, max_episode_steps, autoreset_mode, place)
