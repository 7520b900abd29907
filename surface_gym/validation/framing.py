"""How tables of a terminal are framed and numbers written."""

from collections.abc import Iterable

from rich import box
from rich.markup import escape
from rich.table import Table


def new_table(title: str, *columns: str, labels: int = 1) -> Table:
    """A table whose first columns are labels, the others numbers."""
    table = Table(
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for k, column in enumerate(columns):
        table.add_column(escape(column), justify="left" if k < labels else "right", no_wrap=True)
    return table


def numbers(values: Iterable[float], digits: int = 2) -> list[str]:
    """Numbers as text."""
    return [f"{value:.{digits}f}" for value in values]
