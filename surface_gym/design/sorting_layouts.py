"""The best fixed layouts for sorting, shipped with the package.

`python -m surface_gym.design.sorting_layouts` repeats the search.
"""

import json
import math
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks, files, lines, parallel
from surface_gym.design import runs, search
from surface_gym.design.case import Case, SortPurpose
from surface_gym.design.fixed_layout import BestLayout, best_layout
from surface_gym.layouts import box

SPEEDS = np.arange(30, 271, 2) / 100.0  # [m/s] speeds of the search
COLUMNS = 16  # columns of the zone
SIDE = -1  # sorting direction: y < 0
FILE = "data/sorting.json"
# [rad] allowed axes: the study's, every 22.5 deg, or any.
OFFERS: dict[str, tuple[float, ...] | None] = {
    "four": lines.ORIENTATIONS,
    "eight": tuple(math.pi / 2.0 - math.pi / 8.0 * place for place in range(8)),
    "any": None,
}
SIZES = ("S", "B")


@dataclass(frozen=True, eq=False)
class SortingLayout:
    """A layout that leads a box to y < 0, with its smallest speeds of success."""

    box: str  # "S" or "B", the study's
    offer: str  # key of `OFFERS`: the allowed orientations
    axis: NDArray[np.float64]  # (rows, columns) [rad] first row at the smallest y
    least_speed: float  # [m/s] smallest speed from which all of `SPEEDS` succeed
    least_sure_speed: float  # [m/s] the same for 95 % of the draws of unknown quantities
    mean_time: float  # [s] mean time of successful runs
    study_least_speed: float  # [m/s] of the study's layout
    study_least_sure_speed: float  # [m/s]
    study_mean_time: float  # [s]

    @property
    def half_length(self) -> float:
        """[m] half length of the box."""
        return float(box(self.box).base.outline.max())


@lru_cache(maxsize=1)
def sorting_layouts() -> tuple[SortingLayout, ...]:
    """Load the shipped layouts."""
    text = resources.files("surface_gym.design").joinpath(FILE).read_text("utf-8")
    return tuple(
        SortingLayout(**{**each, "axis": np.radians(each["axis"])}) for each in json.loads(text)
    )


def find_sorting_layouts(
    offers: tuple[str, ...] = tuple(OFFERS), sizes: tuple[str, ...] = SIZES,
    effort: search.Effort = search.Effort(), workers: parallel.Workers = 1, seed: int = 0,
    checkpoints: Path | str | None = None, on_progress: runs.OnProgress = lambda *_: None,
) -> dict[tuple[str, str], BestLayout]:  # fmt: skip
    """Repeat the search of shipped layouts by box and offer, resuming from checkpoints."""
    wanted = [
        (checks.one_of("sizes", size, SIZES), checks.one_of("offers", offer, OFFERS))
        for offer in offers
        for size in sizes
    ]
    steps = effort.epochs + effort.rounds * COLUMNS
    progress = runs.split_progress(on_progress, [steps] * len(wanted))
    return {
        (size, offer): best_layout(
            Case(box(size), SortPurpose(SIDE), seed=seed),
            SPEEDS,
            COLUMNS,
            orientations=OFFERS[offer],
            effort=effort,
            workers=workers,
            checkpoint=None if checkpoints is None else Path(checkpoints) / f"{size}-{offer}.npz",
            on_progress=part,
        )
        for (size, offer), part in zip(wanted, progress, strict=True)
    }


def write_sorting_layouts(file: Path | str, found: dict[tuple[str, str], BestLayout]) -> None:
    """Write layouts in the format of the shipped file; an interrupted write changes nothing."""
    rows = [
        {
            "box": size,
            "offer": offer,
            "axis": np.degrees(each.best.axis).round(6).tolist(),
            "least_speed": each.best.least_speed,
            "least_sure_speed": each.best.least_sure_speed,
            "mean_time": round(each.best.mean_time, 6),
            "study_least_speed": each.study.least_speed,
            "study_least_sure_speed": each.study.least_sure_speed,
            "study_mean_time": round(each.study.mean_time, 6),
        }
        for (size, offer), each in found.items()
    ]
    with files.replacing(Path(file)) as part:
        part.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def main(
    file: Path = Path(__file__).parent / FILE,
    offers: tuple[str, ...] = tuple(OFFERS),
    checkpoints: Path = Path("runs/design/ship"),
    workers: int = parallel.usable_cores(),
    cluster: str | None = None,
) -> None:
    """Search for the best fixed sorting layouts of the study's boxes, and write them to a file.

    Takes about six minutes on two cores. An interrupted search is resumed from its checkpoints.

    Args:
        file: file to write; the default is the shipped file.
        offers: orientations to choose from, "four", "eight" or "any".
        checkpoints: folder for the states of the searches.
        workers: number of threads; the result does not depend on it.
        cluster: address of a Ray cluster to use instead; "auto" for a local cluster.
    """
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("searching", total=None)
        found = find_sorting_layouts(
            offers,
            workers=parallel.choose_workers(cluster, workers),
            checkpoints=checkpoints,
            on_progress=lambda done, total: progress.update(bar, completed=done, total=total),
        )
    write_sorting_layouts(file, found)
    for (size, offer), layout in found.items():
        print(f"{size}-box, {offer}: sorts from {layout.best.least_speed:g} m/s on")


if __name__ == "__main__":
    import tyro

    tyro.cli(main, prog="python -m surface_gym.design.sorting_layouts")
