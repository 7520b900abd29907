"""`python -m benchmarks`: speed and accuracy, with the project's requirements."""

import json
import os
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from benchmarks.figure import Figure, figure_table
from benchmarks.gpu import NotMeasured
from surface_gym.cuda import DeviceMissing, check_device


@dataclass(frozen=True)
class BenchmarkConfig:
    """Measure speed and accuracy without compilation; or decisions per second on a GPU."""

    device: Literal["cpu", "cuda"] = "cpu"
    """"cuda" measures the vector environment on a GPU and on the CPU; then only num-envs, beside,
    json and picture count."""
    num_envs: tuple[int, ...] = (1024, 4096, 16384, 65536, 262144)
    """Numbers of environments on the GPU."""
    beside: bool = True
    """Also measure MuJoCo Warp and gymnax on the GPU, if they are installed."""
    picture: Path | None = None
    """File for a plot of the GPU's decisions per second against the number of environments."""
    physics: bool = True
    """Measure the time of a step, of an import and of a first step."""
    environments: bool = True
    """Measure the steps per second of the environments and of other packages."""
    design: bool = True
    """Measure the time of `surface-gym design`, and its runs per second and MuJoCo's."""
    sharing: bool = True
    """Measure the cost of parallel work in processes and on the nodes of a cluster."""
    scenes: int = 200
    """Number of random scenes for the accuracy table; 0: no table."""
    seed: int = 0
    """Seed of the scenes."""
    json: Path | None = None
    """File for the figures."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; without `arguments`, with the arguments of the process."""
    config = tyro.cli(BenchmarkConfig, prog="python -m benchmarks", args=arguments)
    console = Console()
    if config.device == "cuda":
        try:
            check_device()
            from benchmarks.gpu.cli import measure_device

            measure_device(config.num_envs, config.beside, config.json, config.picture, console)
        except (DeviceMissing, NotMeasured, ValueError) as error:
            sys.exit(f"error: {error}")
        return
    measure_host(config, console)


def measure_host(config: BenchmarkConfig, console: Console) -> None:
    """Measure on the CPU; print and write the figures."""
    from benchmarks import crowds, design, environments, parallel, physics

    measures: list[Callable[[], list[Figure]]] = []
    missing = []
    if config.physics:
        measures += [physics.step_figures, physics.drive_figures]
        measures += [physics.size_figures, physics.start_figures]
        measures.append(crowds.crowd_figures)
    if config.environments:
        measures.append(environments.environment_figures)
        missing += [] if environments.BOX2D else ["gymnasium[box2d] (extra 'bench')"]
        missing += [] if environments.ENVPOOL else ["envpool (extra 'bench')"]
    if config.design:
        measures.append(design.design_figures)
        missing += [] if design.MUJOCO else ["mujoco (extra 'validation')"]
    if config.sharing and parallel.RAY:
        measures.append(parallel.parallel_figures)
    elif config.sharing:
        missing.append("ray (extra 'cluster')")
    for package in missing:
        console.print(f"left out, not installed: {package}", markup=False)
    figures: list[Figure] = []
    for measure in track(measures, "measuring", console=console, transient=True):
        figures += measure()
    console.print(figure_table(figures, f"{platform.machine()}, {os.cpu_count()} cores"))
    errors: dict[float, np.ndarray] = {}
    if config.scenes:
        errors = physics.measure_accuracy(config.scenes, config.seed, console)
        console.print(physics.accuracy_table(errors))
    if config.json is not None:
        data = {
            "figures": [asdict(figure) for figure in figures],
            "accuracy": {f"{dt:g}": rows.tolist() for dt, rows in errors.items()},
        }
        config.json.write_text(json.dumps(data, indent=1) + "\n")
