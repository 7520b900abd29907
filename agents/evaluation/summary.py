"""What the cells of one contender under one condition come to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .cell import Cell
from .statistics import interval

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Summary:
    """The seeds of one contender under one condition."""

    cells: tuple[Cell, ...]

    @property
    def success(self) -> NDArray[np.bool_]:
        """(seeds, starts)."""
        return np.array([cell.success for cell in self.cells])

    @property
    def rate(self) -> float:
        """[-] over seeds and starts."""
        return float(self.success.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """[-] 95 % of the rate."""
        return interval(self.success)

    @property
    def time(self) -> Numbers:
        """(seeds, starts) [s] until the end."""
        return np.array([cell.time for cell in self.cells])

    @property
    def columns(self) -> Numbers:
        """(seeds, starts) of the zone touched."""
        return np.array([cell.columns for cell in self.cells], dtype=float)

    @property
    def decision_time(self) -> float:
        """[s] of one lane's decision."""
        return float(np.mean([cell.decision_time for cell in self.cells]))

    def figure(self, name: str) -> Numbers:
        """(seeds, starts) size of one of the task's own figures."""
        return np.abs(np.array([cell.figures[name] for cell in self.cells]))


def summarise(cells: Sequence[Cell]) -> dict[tuple[str, str, str], Summary]:
    """Summaries by task, contender and condition, in the order of the cells."""
    found: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in cells:
        found.setdefault(cell.key[:3], []).append(cell)
    return {key: Summary(tuple(group)) for key, group in found.items()}
