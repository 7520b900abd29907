"""All that is measured where there is a GPU, one contender at a time."""

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version

import torch

from benchmarks.environments import TASKS
from benchmarks.gpu.agreement import LANES, agreement_of
from benchmarks.gpu.cartpole import GYMNAX, cartpole_rate
from benchmarks.gpu.lanes import (
    ID,
    PLACES,
    DeviceFlows,
    DeviceLanes,
    HostLanes,
    make_env,
    make_flow,
)
from benchmarks.gpu.resets import clock_of, resets_of
from benchmarks.gpu.results import Results, on_cpu, on_gpu
from benchmarks.gpu.warp_scene import MUJOCO_WARP, warp_rate
from benchmarks.gpu.windows import Effort, Rate, rate_of
from surface_gym.parallel import usable_cores
from surface_gym.tasks.sort import Sort

HOST_LANES = 4096  # of the CPU's vector environment
# A window of as many decisions as a GPU's would take the CPU half a minute.
HOST_EFFORT = Effort(steps=64, settling=64)
FLOW_LANES = (1024, 4096)  # lines of 16 parcels
# A line's first minute, in which its parcels come.
FLOW_EFFORT = Effort(windows=3, steps=128, chunk=32, settling=128)
WORLDS = (1024, 4096, 16384)  # of MuJoCo Warp, which is at its best with thousands


@dataclass(frozen=True)
class Job:
    """Something to measure."""

    name: str
    run: Callable[[Results], None]
    ours: bool = True  # not another package's


def jobs(lanes: Sequence[int], beside: bool) -> Iterator[Job]:
    """All that is measured: the CPU first, which the others are held against.

    Args:
        lanes: of the GPU's batches and of CartPole.
        beside: whether other packages are measured as well.
    """
    effort = Effort()
    for name, task in TASKS.items():
        for threads in sorted({1, usable_cores()}):
            yield Job(on_cpu(name, threads), partial(_host, name, task, threads))
    yield Job(f"agreement of {LANES:,} lanes", _agreement)
    for name, task in TASKS.items():
        for count in lanes:
            yield Job(
                f"{on_gpu(name)}, {count:,} lanes", partial(_device, name, task, count, effort)
            )
    for count in FLOW_LANES:
        yield Job(f"flow, {count:,} lines", partial(_flow, count))
    if beside:
        yield from _beside(lanes, effort)


def machine() -> str:
    """The GPU, the CPU, and what drives them."""
    packages = ("torch", "numba-cuda", "numba")
    return ", ".join(
        [
            torch.cuda.get_device_name(),
            f"{platform.machine()}, {usable_cores()} usable cores",
            *(f"{package} {version(package)}" for package in packages),
        ]
    )


def _host(name: str, task: Sort, threads: int, results: Results) -> None:
    env = make_env(task, HOST_LANES, threads=threads)
    results.rates.append(rate_of(HostLanes(on_cpu(name, threads), env), HOST_EFFORT))
    env.close()


def _device(name: str, task: Sort, lanes: int, effort: Effort, results: Results) -> None:
    env = make_env(task, lanes, device="cuda")
    try:
        contender = DeviceLanes(on_gpu(name), env)
        results.rates.append(rate_of(contender, effort))
        results.resets.append(resets_of(contender, clock_of(env.device)))
    finally:
        env.close()
        torch.cuda.empty_cache()


def _flow(lanes: int, results: Results) -> None:
    env = make_flow(lanes, device="cuda")
    try:
        contender = DeviceFlows(f"Flow, {PLACES} parcels a line, GPU", env)
        results.rates.append(rate_of(contender, FLOW_EFFORT))
    finally:
        env.close()
        torch.cuda.empty_cache()


def _agreement(results: Results) -> None:
    import gymnasium as gym

    task = Sort()
    host, device = (
        gym.make_vec(ID, num_envs=LANES, task=task, actions="halves", device=where)
        for where in ("cpu", "cuda")
    )
    results.agreement.append(agreement_of(device, host, task.periods))
    host.close()
    device.close()


def _beside(lanes: Sequence[int], effort: Effort) -> Iterator[Job]:
    """Of other packages, those that are installed."""

    def left_out(package: str, results: Results) -> None:
        results.left_out.append(f"not installed: {package}")

    def measured(rate: Callable[[], Rate], results: Results) -> None:
        results.rates.append(rate())

    rates: dict[str, tuple[bool, Callable[[int], Rate], Sequence[int]]] = {
        "gymnax": (GYMNAX, partial(cartpole_rate, effort=effort), lanes),
        "mujoco-warp": (MUJOCO_WARP, warp_rate, WORLDS),
    }
    for package, (found, rate, counts) in rates.items():
        if not found:
            yield Job(package, partial(left_out, package), ours=False)
            continue
        for count in counts:
            run = partial(measured, partial(rate, count))
            yield Job(f"{package}, {count:,} lanes", run, ours=False)
