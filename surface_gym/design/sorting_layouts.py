"""The best fixed layouts for sorting that ship with the package, and how they are found anew."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.best_layout import BestLayout, best_layout
from surface_gym.design.case import Case
from surface_gym.design.purposes import Sort
from surface_gym.design.search import Effort
from surface_gym.layouts import box
from surface_gym.lines import ORIENTATIONS
from surface_gym.sharing import Workers
from surface_gym.whole_files import replacing

SPEEDS = np.arange(30, 271, 2) / 100.0  # [m/s] at which a layout has to sort, as many as it can
COLUMNS = 16  # of the zone
SIDE = -1  # that they sort to: y < 0
FILE = "data/sorting.json"
# [rad] axes on offer: the study's, every 22.5 deg, or any.
OFFERS: dict[str, tuple[float, ...] | None] = {
    "four": ORIENTATIONS,
    "eight": tuple(math.pi / 2.0 - math.pi / 8.0 * place for place in range(8)),
    "any": None,
}
SIZES = ("S", "B")

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SortingLayout:
    """A layout that leads a box to y < 0, and how slowly a box may come."""

    box: str  # "S" or "B", the study's
    offer: str  # a key of `OFFERS`: the orientations it chooses from
    axis: Numbers  # (rows, columns) [rad], the first row at the least y
    least_speed: float  # [m/s] from which on it sorts at all of `SPEEDS`
    least_sure_speed: float  # [m/s] the same for all but 5 % of the draws of what is not known
    mean_time: float  # [s] of those that it sorts
    study_least_speed: float  # [m/s] of the study's layout
    study_least_sure_speed: float  # [m/s]
    study_mean_time: float  # [s]

    @property
    def half_length(self) -> float:
        """[m] of the box."""
        return float(box(self.box).base.outline.max())


@lru_cache(maxsize=1)
def sorting_layouts() -> tuple[SortingLayout, ...]:
    """The layouts that ship with the package."""
    text = resources.files("surface_gym.design").joinpath(FILE).read_text("utf-8")
    return tuple(
        SortingLayout(**{**each, "axis": np.radians(each["axis"])}) for each in json.loads(text)
    )


def find_sorting_layouts(
    offers: tuple[str, ...] = tuple(OFFERS),
    sizes: tuple[str, ...] = SIZES,
    effort: Effort = Effort(),
    workers: Workers = 1,
    seed: int = 0,
    checkpoints: Path | str | None = None,
    advance: Callable[[int, int], None] = lambda *_: None,
) -> dict[tuple[str, str], BestLayout]:
    """Search the layouts that ship anew.

    Args:
        offers: keys of `OFFERS`.
        sizes: of `SIZES`.
        effort: how long to search, for each.
        workers: threads that share the runs, or a cluster; what is found does not depend on it.
        seed: of the searches and of the draws of what is not known.
        checkpoints: folder that keeps what is found; searches whose files exist go on from there.
        advance: called with how much of the searches is done and how much there is.

    Returns:
        The layouts by box and offer.

    Raises:
        ValueError: an argument that is not allowed, or a checkpoint of another search.
    """
    wanted = [
        (checks.one_of("sizes", size, SIZES), checks.one_of("offers", offer, OFFERS))
        for offer in offers
        for size in sizes
    ]
    found = {}
    for place, (size, offer) in enumerate(wanted):

        def told(done: int, steps: int, place: int = place) -> None:
            advance(place * steps + done, len(wanted) * steps)

        found[size, offer] = best_layout(
            Case(box(size), Sort(SIDE), seed=seed),
            SPEEDS,
            COLUMNS,
            orientations=OFFERS[offer],
            effort=effort,
            workers=workers,
            checkpoint=None if checkpoints is None else Path(checkpoints) / f"{size}-{offer}.npz",
            advance=told,
        )
    return found


def write_sorting_layouts(file: Path | str, found: dict[tuple[str, str], BestLayout]) -> None:
    """Write layouts to a file as the one that ships; a write broken off leaves it as it was.

    Args:
        file: to write.
        found: by `find_sorting_layouts`.
    """
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
    with replacing(Path(file)) as part:
        part.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
