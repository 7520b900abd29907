"""Base classes and helpers of answers: sentences, tables and figures."""

import csv
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surface_gym.design.case import GROUPS, NOMINAL, TOGETHER

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure

Cell = str | float | int | bool | None

DPI = 120
BLUE, ORANGE = "#0072B2", "#D55E00"
# Okabe and Ito's colours, safe for colour-blind readers, each with a line style.
LINES: dict[str, tuple[str, Any]] = {
    NOMINAL: ("#999999", "-"),
    "friction": ("#E69F00", "--"),
    "load": ("#56B4E9", "-."),
    "unevenness": ("#009E73", ":"),
    "entry": ("#CC79A7", (0, (3, 1, 1, 1))),
    TOGETHER: ("#000000", "-"),
}


@dataclass(frozen=True)
class ReportTable:
    """A header and rows; shown in a terminal, written as CSV, or both."""

    name: str  # file name without suffix
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    shown: bool = True  # whether it is shown in a terminal
    written: bool = True  # whether it is written as CSV


class Answer(ABC):
    """An answer to a question about a case: a sentence, tables and a figure."""

    @property
    @abstractmethod
    def name(self) -> str:
        """File name of the figure, without suffix."""

    @property
    @abstractmethod
    def sentence(self) -> str:
        """The answer in one sentence."""

    @abstractmethod
    def tables(self) -> tuple[ReportTable, ...]:
        """Return the answer as tables."""

    @abstractmethod
    def draw(self) -> "Figure":
        """Draw the answer with matplotlib."""


def write_csv(table: ReportTable, folder: Path) -> Path:
    """Write a table with full precision and empty missing cells to a folder; return the file."""
    path = folder / f"{table.name}.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table.header)
        for row in table.rows:
            writer.writerow("" if _is_missing(cell) else cell for cell in row)
    return path


def format_cell(cell: Cell) -> str:
    """Format a cell for a terminal."""
    if _is_missing(cell):
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)


def _is_missing(cell: Cell) -> bool:
    return cell is None or (isinstance(cell, float) and math.isnan(cell))


def group_label(group: str) -> str:
    """Return the label of a group of unknown quantities."""
    if group == TOGETHER:
        return "all together"
    return group if group in GROUPS else "nothing"


def plural(count: int, noun: str) -> str:
    """Return a count and a noun: "1 column", "2 columns"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def new_figure(width: float, height: float, title: str, fontsize: str = "large") -> "Figure":
    """Make an empty figure [inch] whose title is a question."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, fontsize=fontsize)
    return figure


def new_panel(title: str, subtitle: str) -> "tuple[Figure, Axes]":
    """Make a figure of one panel with a question and a subtitle below it."""
    figure = new_figure(7.2, 4.8, title)
    axes = figure.subplots()
    axes.set_title(subtitle, fontsize="small")
    axes.grid(alpha=0.25)
    return figure, axes


def legend_of_drawn(axes: "Axes") -> dict[str, Any]:
    """Return arguments of a legend for lines with points."""
    drawn = [
        (line, label)
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
        if not hasattr(line, "get_xdata") or len(line.get_xdata())
    ]
    handles, labels = zip(*drawn, strict=True)
    return {"handles": handles, "labels": labels, "fontsize": "small", "framealpha": 0.9}
