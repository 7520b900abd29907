"""`python -m benchmarks`: cost and accuracy, beside what the project asks of itself."""

import json
import os
import platform
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from benchmarks import accuracy, design, environments, physics, sharing
from benchmarks.environments import BOX2D, ENVPOOL
from benchmarks.figure import Figure, table_of
from benchmarks.gpu.command import NotMeasured, measure_device
from surface_gym.cuda.env import DeviceMissing


@dataclass(frozen=True)
class BenchmarkConfig:
    """Measure cost and accuracy, warmed up; or decisions a second on a GPU."""

    device: Literal["cpu", "cuda"] = "cpu"
    """"cuda" measures the vector environment on a GPU, beside the CPU's: lanes, beside, json and
    picture are read then, and the others are not."""
    lanes: tuple[int, ...] = (1024, 4096, 16384, 65536, 262144)
    """On the GPU."""
    beside: bool = True
    """MuJoCo Warp and gymnax on the GPU, where they are installed."""
    picture: Path | None = None
    """File to draw the GPU's decisions a second against lanes in."""
    physics: bool = True
    """Cost of a step, of an import and of a first step."""
    environments: bool = True
    """Steps a second beside other packages."""
    design: bool = True
    """Time of a design's answer, and its runs beside MuJoCo's."""
    sharing: bool = True
    """Cost of sharing work among processes and the nodes of a cluster."""
    scenes: int = 200
    """Random scenes of the accuracy table; 0 leaves it out."""
    seed: int = 0
    """Of the scenes."""
    json: Path | None = None
    """File to write the figures to."""


def main() -> None:
    """Measure, print, write."""
    config = tyro.cli(BenchmarkConfig)
    console = Console()
    if config.device == "cuda":
        try:
            measure_device(config.lanes, config.beside, config.json, config.picture, console)
        except (DeviceMissing, NotMeasured, ValueError) as error:
            sys.exit(f"error: {error}")
        return
    figures: list[Figure] = []
    measures: list[Callable[[], list[Figure]]] = []
    if config.physics:
        measures += [physics.step_figures, physics.size_figures, physics.start_figures]
    if config.environments:
        measures.append(environments.environment_figures)
        for package, found in (("gymnasium[box2d]", BOX2D), ("envpool", ENVPOOL)):
            if not found:
                console.print(f"left out, not installed: {package} (extra 'bench')", markup=False)
    if config.design:
        measures.append(design.design_figures)
        if not design.MUJOCO:
            console.print("left out, not installed: mujoco (extra 'validation')", markup=False)
    if config.sharing and sharing.RAY:
        measures.append(sharing.sharing_figures)
    elif config.sharing:
        console.print("left out, not installed: ray (extra 'cluster')", markup=False)
    for measure in track(measures, "measuring", console=console, transient=True):
        figures += measure()
    console.print(table_of(figures, f"{platform.machine()}, {os.cpu_count()} cores"))
    errors: dict[float, np.ndarray] = {}
    if config.scenes:
        errors = accuracy.measure(config.scenes, config.seed, console)
        console.print(accuracy.table(errors))
    if config.json is not None:
        data = {
            "figures": [asdict(figure) for figure in figures],
            "accuracy": {f"{dt:g}": rows.tolist() for dt, rows in errors.items()},
        }
        config.json.write_text(json.dumps(data, indent=1) + "\n")
