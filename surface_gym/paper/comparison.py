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
class Found:
    """A value of ours, and how much of its run Eq. (1) cannot balance."""

    value: Value
    tipping: float | None  # [-] share of the steps up to the value; None: there was no step


@dataclass(frozen=True)
class Cell:
    """One value of the paper beside ours, all in the unit its column names.

    Numbers agree if, rounded as the paper prints them, they differ by the tolerance at most;
    other values agree if they are equal.
    """

    row: str
    column: str
    size: str  # of the box, "S" or "B"
    paper: Value
    ours: tuple[Found, ...]  # one an integration, in the order of `INTEGRATIONS`
    decimals: int = 0  # the paper prints
    tolerance: float = 0.0

    def agrees(self, integration: int) -> bool:
        """Whether ours by the integration of that place agrees."""
        ours = self.ours[integration].value
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

    def agreeing(self, integration: int) -> int:
        """Cells that agree by the integration of that place."""
        return sum(cell.agrees(integration) for cell in self.cells)

    def tipping(self, integration: int) -> dict[str, tuple[float, float]]:
        """By the size of the box: least and largest share of a run's steps that would tip it."""
        shares: dict[str, list[float]] = {}
        for cell in self.cells:
            share = cell.ours[integration].tipping
            if share is not None:
                shares.setdefault(cell.size, []).append(share)
        return {size: (min(found), max(found)) for size, found in shares.items()}
