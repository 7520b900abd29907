"""A value of the paper beside ours, and tables of them."""

from dataclasses import dataclass
from typing import NamedTuple


class SlowingLayout(NamedTuple):
    """An entry of Table 4."""

    columns: int  # of the slowing area
    angle: int  # [deg] 0, or 45 for +-45 in alternate rows

    def __str__(self) -> str:
        return f"{self.columns} at {'±' if self.angle else ''}{self.angle}°"


Value = int | float | SlowingLayout | None


@dataclass(frozen=True)
class Cell:
    """One value of the paper beside ours, all in the unit its column names.

    Numbers agree if, rounded as the paper prints them, they differ by the tolerance at most;
    other values agree if they are equal.
    """

    row: str
    column: str
    paper: Value
    paper_step: Value  # ours at PAPER_STEP
    converged: Value  # ours at CONVERGED
    decimals: int = 0  # the paper prints
    tolerance: float = 0.0

    @property
    def paper_step_agrees(self) -> bool:
        return self._agrees(self.paper_step)

    @property
    def converged_agrees(self) -> bool:
        return self._agrees(self.converged)

    def _agrees(self, ours: Value) -> bool:
        if isinstance(ours, (int, float)) and isinstance(self.paper, (int, float)):
            difference = round(ours, self.decimals) - self.paper
            return abs(round(difference, self.decimals)) <= self.tolerance
        return ours == self.paper


@dataclass(frozen=True)
class Table:
    """A table of the paper, or a sentence of it that states numbers."""

    key: str  # its name in the JSON report
    title: str
    rule: str  # what is counted, and when a cell agrees
    cells: tuple[Cell, ...]

    @property
    def paper_step_agreeing(self) -> int:
        """Cells that agree at PAPER_STEP."""
        return sum(cell.paper_step_agrees for cell in self.cells)

    @property
    def converged_agreeing(self) -> int:
        """Cells that agree at CONVERGED."""
        return sum(cell.converged_agrees for cell in self.cells)
