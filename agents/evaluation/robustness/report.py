"""The sweep's files, and what is shown of it."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from ..table import print_table
from .picture import draw_sweep
from .results import Sweep
from .sweep import SweptCell
from .tables import sweep_tables, write_tables

PICTURE = "robustness.png"


def write_sweep(cells: Sequence[SweptCell], folder: Path, console: Console) -> None:
    """Write robustness.md, .csv, .json and .png into a folder, and show the tables."""
    sweep = Sweep(tuple(cells))
    tables = sweep_tables(sweep)
    write_tables(sweep, tables, folder)
    draw_sweep(sweep, folder / PICTURE)
    for table in tables:
        print_table(table, console)
