"""What the cells of the sweep come to."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from surface_gym.conditions import CONDITIONS
from surface_gym.parcel import Base, Disc, Rectangle
from surface_gym.settings import Settings

from ..drawn import drawn_parcels
from ..statistics import interval
from ..trials import SEED, make_trial
from .factors import FACTORS, LAB, TRAINED, Level
from .sweep import SweptCell

Booleans = NDArray[np.bool_]
SHAPES = ("square", "rectangle", "disc", "polygon")


@dataclass(frozen=True)
class Rate:
    """A share of successes, over seeds and starts."""

    value: float  # [-]
    low: float  # [-] of the 95 % interval
    high: float  # [-]
    seeds: int
    starts: int  # of each seed


@dataclass(frozen=True, eq=False)
class Sweep:
    """All cells."""

    cells: tuple[SweptCell, ...]

    @cached_property
    def _found(self) -> dict[tuple[str, str, str], list[SweptCell]]:
        found: dict[tuple[str, str, str], list[SweptCell]] = {}
        for cell in self.cells:
            found.setdefault((cell.task, cell.contender, cell.factor), []).append(cell)
        return found

    @property
    def tasks(self) -> list[str]:
        """Names, in their order."""
        return list(dict.fromkeys(cell.task for cell in self.cells))

    def contenders(self, task: str | None = None) -> list[str]:
        """Names, in their order; None: of all tasks."""
        return list(dict.fromkeys(c.contender for c in self.cells if task in (None, c.task)))

    def success(self, task: str, who: str, factor: str, level: Level) -> Booleans | None:
        """(seeds, starts) whether each succeeded; None where it was not tried."""
        cells, place = self._at(task, who, factor, level)
        if place is None:
            return None
        return np.array([[letter == "1" for letter in cell.success[place]] for cell in cells])

    def rate(self, task: str, who: str, factor: str, level: Level) -> Rate | None:
        """The share of successes; None where it was not tried."""
        success = self.success(task, who, factor, level)
        return None if success is None else rate_of(success)

    def error(self, task: str, who: str, factor: str, level: Level) -> float | None:
        """Median size of the task's first figure, mean over seeds; None where it was not tried."""
        cells, place = self._at(task, who, factor, level)
        return None if place is None else float(np.mean([cell.error[place] for cell in cells]))

    def by_shape(self, task: str, who: str) -> dict[str, Rate]:
        """In the lab, by the shape of the parcel; a shape that no start drew is left out."""
        success = self.success(task, who, LAB, LAB)
        if success is None:
            return {}
        shapes = np.array(lab_shapes(task, success.shape[1]))
        return {shape: rate_of(success[:, shapes == shape]) for shape in SHAPES if shape in shapes}

    def _at(
        self, task: str, who: str, factor: str, level: Level
    ) -> tuple[Sequence[SweptCell], int | None]:
        """A cell a seed, and the level's place in each; the place is None where there is none."""
        if level == FACTORS[factor].trained:
            factor = level = TRAINED
        cells = self._found.get((task, who, factor), [])
        tried = cells[0].levels if cells else []
        return cells, tried.index(level) if level in tried else None


def rate_of(success: Booleans) -> Rate:
    """The rate of successes (seeds, starts)."""
    return Rate(float(success.mean()), *interval(success), *success.shape)


def shape_of(base: Base) -> str:
    """What a base of the lab is called."""
    if isinstance(base, Rectangle):
        return "square" if base.length == base.width else "rectangle"
    return "disc" if isinstance(base, Disc) else "polygon"


@lru_cache(maxsize=16)
def lab_shapes(task: str, starts: int) -> tuple[str, ...]:
    """The shape of each start's parcel, as the lab draws it."""
    settings = Settings(task=make_trial(task).task, condition=CONDITIONS[LAB])
    return tuple(shape_of(each.base) for each in drawn_parcels(settings, [{}] * starts, SEED))
