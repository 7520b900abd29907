"""`python -m benchmarks`: cost and accuracy, beside what the project asks of itself."""

import json
import os
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks import accuracy, design, environments, physics, sharing
from benchmarks.environments import BOX2D, ENVPOOL
from benchmarks.figure import Figure


@dataclass(frozen=True)
class BenchmarkConfig:
    """Measure cost and accuracy, warmed up."""

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


def _written(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000.0 else f"{value:.3g}"


def main() -> None:
    """Measure, print, write."""
    config = tyro.cli(BenchmarkConfig)
    console = Console()
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
    table = Table("figure", title=f"{platform.machine()}, {os.cpu_count()} cores")
    for column in ("measured", "unit", "asked"):
        table.add_column(column, justify="right")
    for figure in figures:
        table.add_row(figure.name, _written(figure.value), figure.unit, figure.asked)
    console.print(table)
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


if __name__ == "__main__":
    main()
