"""All measurements of `python -m benchmarks --device cuda`, printed and written to files."""

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

import gymnasium as gym
import torch
from rich.console import Console
from rich.progress import track

from benchmarks.environments import TASKS
from benchmarks.figure import figure_table
from benchmarks.gpu import NotMeasured
from benchmarks.gpu.agreement import NUM_ENVS, measure_agreement
from benchmarks.gpu.peers import GYMNAX, MUJOCO_WARP, measure_cartpole, measure_warp
from benchmarks.gpu.results import Results, cpu_name, gpu_name, plot_rates
from benchmarks.gpu.timing import (
    ID,
    MAX_PARCELS,
    DeviceProgram,
    Effort,
    HostProgram,
    Rate,
    device_clock,
    make_sort,
    make_streams,
    measure_rate,
    measure_resets,
)
from surface_gym.cuda import check_device
from surface_gym.parallel import usable_cores
from surface_gym.tasks.sort import Sort

HOST_NUM_ENVS = 4096  # of the CPU's vector environment
# The CPU would take half a minute for as many decisions as the GPU's windows have.
HOST_EFFORT = Effort(steps=64, warm_up=64)
STREAM_NUM_ENVS = (1024, 4096)  # lines of 16 parcels
# The first minute of a line, in which its parcels arrive.
STREAM_EFFORT = Effort(windows=3, steps=128, chunk=32, warm_up=128)
WORLDS = (1024, 4096, 16384)  # of MuJoCo Warp, which is fastest with thousands of worlds


@dataclass(frozen=True)
class Job:
    """A measurement."""

    name: str
    run: Callable[[Results], None]
    ours: bool = True  # whether it measures this package


def measure_device(
    num_envs: Sequence[int], beside: bool, json: Path | None, picture: Path | None, console: Console
) -> None:
    """Run all measurements, print the results, and write them after each measurement.

    Args:
        num_envs: numbers of environments to measure.
        beside: whether to measure other packages too.
        json: file for the results, or None.
        picture: file for a plot of decisions per second against environments, or None.

    Raises:
        DeviceMissing: there is no GPU, or a library for it is missing.
        ValueError: `num_envs` are not positive numbers.
        NotMeasured: some measurements failed; the others are printed and written.
    """
    if not num_envs or min(num_envs) < 1:
        raise ValueError(f"num_envs must be positive numbers, one at least, got {tuple(num_envs)}")
    check_device()
    results = Results(describe_machine())
    jobs = list(list_jobs(num_envs, beside))
    for job in track(jobs, "measuring", console=console, transient=True):
        try:
            job.run(results)
        # The GPU's memory may be too small, or another package too new: go on with the others.
        except Exception as error:
            reason = f"{job.name}: {type(error).__name__}: {error}"
            (results.failed if job.ours else results.left_out).append(reason)
            if job.ours:
                console.print_exception()
        if json is not None:
            results.write(json)
    console.print(results.table())
    console.print(figure_table(results.figures(), results.machine))
    for line in results.left_out:
        console.print(f"left out, {line}", markup=False)
    if picture is not None:
        plot_rates(results.rates, picture)
    if results.failed:
        raise NotMeasured("; ".join(results.failed))


def list_jobs(num_envs: Sequence[int], beside: bool) -> Iterator[Job]:
    """Yield all measurements, first those on the CPU, with which the others are compared."""
    effort = Effort()
    for name, task in TASKS.items():
        for threads in sorted({1, usable_cores()}):
            yield Job(cpu_name(name, threads), partial(_measure_host, name, task, threads))
    yield Job(f"agreement of {NUM_ENVS:,} environments", _measure_agreement)
    for name, task in TASKS.items():
        for count in num_envs:
            run = partial(_measure_device, name, task, count, effort)
            yield Job(f"{gpu_name(name)}, {count:,} environments", run)
    for count in STREAM_NUM_ENVS:
        yield Job(f"Flow, {count:,} lines", partial(_measure_streams, count))
    if beside:
        yield from _list_peers(num_envs, effort)


def describe_machine() -> str:
    """Return the names of the GPU, the CPU and their software."""
    packages = ("torch", "numba-cuda", "numba")
    return ", ".join(
        [
            torch.cuda.get_device_name(),
            f"{platform.machine()}, {usable_cores()} usable cores",
            *(f"{package} {version(package)}" for package in packages),
        ]
    )


def _measure_host(name: str, task: Sort, threads: int, results: Results) -> None:
    """Measure the CPU's vector environment."""
    env = make_sort(task, HOST_NUM_ENVS, threads=threads)
    results.rates.append(measure_rate(HostProgram(cpu_name(name, threads), env), HOST_EFFORT))
    env.close()


def _measure_device(name: str, task: Sort, num_envs: int, effort: Effort, results: Results) -> None:
    """Measure the GPU's vector environment, and its resets."""
    env = make_sort(task, num_envs, device="cuda")
    try:
        program = DeviceProgram(gpu_name(name), env)
        results.rates.append(measure_rate(program, effort))
        results.resets.append(measure_resets(program, device_clock(env.device)))
    finally:
        env.close()
        torch.cuda.empty_cache()


def _measure_streams(num_envs: int, results: Results) -> None:
    """Measure the GPU's streams."""
    env = make_streams(num_envs, device="cuda")
    try:
        program = DeviceProgram(f"Flow, {MAX_PARCELS} parcels a line, GPU", env)
        results.rates.append(measure_rate(program, STREAM_EFFORT))
    finally:
        env.close()
        torch.cuda.empty_cache()


def _measure_agreement(results: Results) -> None:
    """Compare episodes on the GPU with the same episodes on the CPU."""
    task = Sort()
    host, device = (
        gym.make_vec(ID, num_envs=NUM_ENVS, task=task, actions="halves", device=where)
        for where in ("cpu", "cuda")
    )
    results.agreement.append(measure_agreement(device, host, task.periods))
    host.close()
    device.close()


def _list_peers(num_envs: Sequence[int], effort: Effort) -> Iterator[Job]:
    """Yield the measurements of other packages, as left out if a package is not installed."""

    def leave_out(package: str, results: Results) -> None:
        results.left_out.append(f"not installed: {package}")

    def measure(rate: Callable[[], Rate], results: Results) -> None:
        results.rates.append(rate())

    peers: dict[str, tuple[bool, Callable[[int], Rate], Sequence[int]]] = {
        "gymnax": (GYMNAX, partial(measure_cartpole, effort=effort), num_envs),
        "mujoco-warp": (MUJOCO_WARP, measure_warp, WORLDS),
    }
    for package, (found, rate, counts) in peers.items():
        if not found:
            yield Job(package, partial(leave_out, package), ours=False)
            continue
        for count in counts:
            run = partial(measure, partial(rate, count))
            yield Job(f"{package}, {count:,} environments", run, ours=False)
