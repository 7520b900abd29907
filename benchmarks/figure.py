"""A figure and what is asked of it."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table


@dataclass(frozen=True)
class Figure:
    """A measured figure beside the one asked for."""

    name: str
    value: float
    unit: str
    most: float | None = None  # asked for, at most
    least: float | None = None  # asked for, at least

    @property
    def asked(self) -> str:
        """The bound in words."""
        if self.most is not None:
            return f"<= {self.most:g}"
        return f">= {self.least:g}" if self.least is not None else ""


def written(value: float) -> str:
    """A number for a table."""
    return f"{value:,.0f}" if value >= 1000.0 else f"{value:.3g}"


def table_of(figures: Sequence[Figure], title: str) -> Table:
    """Figures beside what is asked of them."""
    table = Table("figure", title=title)
    for column in ("measured", "unit", "asked"):
        table.add_column(column, justify="right")
    for figure in figures:
        table.add_row(figure.name, written(figure.value), figure.unit, figure.asked)
    return table
