"""`python -m surface_gym.design.ship`: search the sorting layouts of the package anew."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import Progress

from surface_gym.cores import usable_cores
from surface_gym.design.sorting_layouts import (
    FILE,
    OFFERS,
    find_sorting_layouts,
    write_sorting_layouts,
)
from surface_gym.sharing import workers_of


@dataclass(frozen=True)
class ShipOptions:
    """Search the fixed layouts that sort the study's boxes best, and write them to a file.

    Takes about six minutes on two cores. One that was stopped goes on from its checkpoints.
    """

    file: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path(__file__).parent / FILE
    """To write; else the one that ships."""
    offers: tuple[str, ...] = tuple(OFFERS)
    """Orientations to choose from: four, eight or any."""
    checkpoints: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/design/ship")
    """Folder of what the searches have done."""
    workers: int = field(default_factory=usable_cores)
    """Threads that share the runs; what is found does not depend on it."""
    cluster: str | None = None
    """Address of a Ray cluster to share them among instead, "auto" for this machine's."""


def main() -> None:
    """Search, with a bar, and write."""
    options = tyro.cli(ShipOptions, prog="python -m surface_gym.design.ship")
    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("searching", total=None)
        found = find_sorting_layouts(
            options.offers,
            workers=workers_of(options.cluster, options.workers),
            checkpoints=options.checkpoints,
            advance=lambda done, total: progress.update(bar, completed=done, total=total),
        )
    write_sorting_layouts(options.file, found)
    for (size, offer), layout in found.items():
        print(f"{size}-box, {offer}: sorts from {layout.best.least_speed:g} m/s on")


if __name__ == "__main__":
    main()
