"""Measured figures with requirements, the result of every benchmark."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table


@dataclass(frozen=True)
class Figure:
    """A measured figure, and its requirement if there is one."""

    name: str
    value: float
    unit: str
    most: float | None = None  # required, at most
    least: float | None = None  # required, at least

    @property
    def required(self) -> str:
        """The requirement as text."""
        if self.most is not None:
            return f"<= {self.most:g}"
        return f">= {self.least:g}" if self.least is not None else ""


def format_number(value: float) -> str:
    """Format a number for a table."""
    return f"{value:,.0f}" if value >= 1000.0 else f"{value:.3g}"


def figure_table(figures: Sequence[Figure], title: str) -> Table:
    """Make a table of figures and requirements."""
    table = Table("figure", title=title)
    for column in ("measured", "unit", "required"):
        table.add_column(column, justify="right")
    for figure in figures:
        table.add_row(figure.name, format_number(figure.value), figure.unit, figure.required)
    return table
