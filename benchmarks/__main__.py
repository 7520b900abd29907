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
from rich.table import Table

from benchmarks import accuracy, physics
from benchmarks.physics import Figure

PARTS: dict[str, tuple[Callable[[], list[Figure]], ...]] = {
    "physics": (physics.step_figures, physics.size_figures, physics.start_figures),
}


@dataclass(frozen=True)
class BenchmarkConfig:
    """Measure cost and accuracy, on one core, warmed up."""

    scenes: int = 200
    """Random scenes of the accuracy table; 0 leaves it out."""
    seed: int = 0
    """Of the scenes."""
    json: Path | None = None
    """File to write the figures to."""


def _asked(figure: Figure) -> str:
    if figure.most is not None:
        return f"<= {figure.most:g}"
    return f">= {figure.least:g}" if figure.least is not None else ""


def main() -> None:
    """Measure, print, write."""
    config = tyro.cli(BenchmarkConfig)
    console = Console()
    figures: list[Figure] = []
    with console.status("") as status:
        for part in PARTS.values():
            for measure in part:
                status.update((measure.__doc__ or "").splitlines()[0])
                figures += measure()
    table = Table("figure", title=f"{platform.machine()}, {os.cpu_count()} cores, one used")
    for column in ("measured", "unit", "asked"):
        table.add_column(column, justify="right")
    for figure in figures:
        table.add_row(figure.name, f"{figure.value:.3g}", figure.unit, _asked(figure))
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
