"""The sorting comparison as a table: on screen, as Markdown and as JSON."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from agents.comparison import PARCELS, SPEEDS, SortRecord

SHOWN_SPEEDS = np.arange(3, 28, 2) / 10.0  # [m/s] rows of the table, of the speeds compared


def _cell(record: SortRecord, speed: float) -> str:
    row = int(np.argmin(np.abs(record.speed - speed)))
    time = record.slowest_time[row]
    if np.isfinite(time):
        return f"{time:.3f}"
    return "fails" if not record.success[row].any() else "one side"


def minimum_text(record: SortRecord) -> str:
    """The minimum entry speed as text."""
    return "none" if record.minimum_speed is None else f"{record.minimum_speed:.2f}"


def _rows(records: Sequence[SortRecord]) -> tuple[list[str], list[list[str]]]:
    ordered = [record for parcel in PARCELS for record in records if record.parcel == parcel]
    header = [
        "entry speed [m/s]",
        *(f"{record.parcel}-box, {record.controller}" for record in ordered),
    ]
    rows = [
        [f"{speed:.1f}", *(_cell(record, speed) for record in ordered)] for speed in SHOWN_SPEEDS
    ]
    rows.append(["minimum [m/s]", *(minimum_text(record) for record in ordered)])
    rows.append(["success", *(f"{record.success_rate:.3f}" for record in ordered)])
    return header, rows


def _caption() -> str:
    return (
        "time to sort [s], the slower of both sides; minimum and success over "
        f"{len(SPEEDS)} speeds from {SPEEDS[0]:g} to {SPEEDS[-1]:g} m/s and both sides"
    )


def print_table(records: Sequence[SortRecord], console: Console) -> None:
    """Show the comparison on screen."""
    header, rows = _rows(records)
    table = Table(escape(header[0]), title="Sorting by entry speed", caption=escape(_caption()))
    for name in header[1:]:
        table.add_column(name, justify="right")
    for number, row in enumerate(rows):
        table.add_row(*map(escape, row), end_section=number == len(rows) - 3)
    console.print(table)


def write_table(records: Sequence[SortRecord], folder: Path) -> None:
    """Write table.md and table.json into a folder."""
    header, rows = _rows(records)
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    text = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    (folder / "table.md").write_text(f"{text}\n\n{_caption()}\n")
    data = [
        {
            "controller": record.controller,
            "parcel": record.parcel,
            "minimum_speed": record.minimum_speed,
            "success_rate": record.success_rate,
            "speed": record.speed.tolist(),
            "success": record.success.all(axis=1).tolist(),
            "time": [time if np.isfinite(time) else None for time in record.slowest_time.tolist()],
        }
        for record in records
    ]
    (folder / "table.json").write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")
