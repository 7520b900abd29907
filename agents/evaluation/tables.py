"""Tables of results: on screen, as Markdown and HTML, and all numbers as CSV and JSON."""

import csv
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table as Screen
from rich.text import Text

from surface_gym.config import PRESETS
from surface_gym.tasks.benchmark import PARCELS, Column, SpeedGrid

from ..library import task_label
from .benchmark import Summaries, Summary, find_benchmark
from .methods import FIXED

NOTHING = "-"
SHOWN_SPEEDS = np.arange(3, 28, 2) / 10.0  # [m/s] rows of the table by entry speed
DECISIONS = "decisions.md"


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]], others: str = "---") -> str:
    """Write rows as a Markdown table; `others` aligns all columns but the first."""
    lines = [header, ["---"] + [others] * (len(header) - 1), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


BOLD = "**"  # on either side, as in Markdown


def bold(text: str) -> str:
    """Mark a cell as bold."""
    return f"{BOLD}{text}{BOLD}"


@dataclass(frozen=True)
class Table:
    """Texts in rows and columns, some in bold; the first column names the rows."""

    title: str
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def heading(self) -> str:
        return self.title.capitalize()

    def markdown(self) -> str:
        text = markdown(self.header, self.rows, "---:")
        return f"## {self.heading}\n\n{self.caption}\n\n{text}\n"

    def html(self) -> str:
        def line(tag: str, texts: Sequence[str]) -> str:
            each = (f"<{tag}>{escape(text)}</{tag}>" for text in texts)
            return re.sub(r"\*\*(.*?)\*\*", r"<b>\1</b>", f"<tr>{''.join(each)}</tr>")

        body = "".join(line("td", row) for row in self.rows)
        return f"<table><thead>{line('th', self.header)}</thead><tbody>{body}</tbody></table>"

    def show(self, console: Console) -> None:
        """Print the table; where it is too wide, in parts that repeat the first column."""
        columns = list(zip(self.header, *self.rows, strict=True))
        # A cell stands in one line; a heading may be broken between words.
        widths = [max(map(len, (*head.split(), *cells))) for head, *cells in columns]
        parts, used = [[0]], widths[0]
        for k, width in enumerate(widths[1:], 1):
            if used + width + 4 > console.width and len(parts[-1]) > 1:
                parts.append([0])
                used = widths[0]
            parts[-1].append(k)
            used += width + 3
        for number, part in enumerate(parts, 1):
            screen = Screen(
                title=self.heading if number == 1 else None,
                caption=Text(self.caption) if number == len(parts) else None,
                box=SIMPLE,
            )
            for k in part:
                screen.add_column(
                    Text(self.header[k]), justify="right" if k else "left", min_width=widths[k]
                )
            for row in self.rows:
                screen.add_row(*(_shown(row[k]) for k in part))
            console.print(screen)


def _shown(text: str) -> Text:
    plain = text.removeprefix(BOLD).removesuffix(BOLD)
    return Text(plain, style="" if plain == text else "bold")


def write_markdown(tables: Iterable[Table], file: Path, title: str = "") -> None:
    """Write tables one below the other."""
    file.write_text(title + "\n".join(table.markdown() for table in tables))


def write_numbers(rows: Sequence[dict[str, Any]], *files: Path) -> None:
    """Write rows of numbers into CSV and JSON files; what is not finite stays empty."""
    finite = [
        {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in row.items()
        }
        for row in rows
    ]
    for file in files:
        if file.suffix == ".json":
            file.write_text(json.dumps(finite, indent=1, allow_nan=False) + "\n")
            continue
        with file.open("w", newline="") as text:
            table = csv.DictWriter(text, list(finite[0]))
            table.writeheader()
            table.writerows(finite)


def list_methods(task: str, summaries: Summaries) -> list[str]:
    """List the methods that ran on a task, in their order."""
    return list(dict.fromkeys(method for of_task, method, _ in summaries if of_task == task))


def task_table(task: str, summaries: Summaries) -> Table:
    """Make a row for each method: success by preset, the task's columns by exact sensors.

    Decision times stand in a table of their own, since they are never the same.
    """
    benchmark, methods = find_benchmark(task), list_methods(task, summaries)
    fixed = summaries[task, FIXED, "exact"]
    shown = [
        preset
        for preset in PRESETS.values()
        if any((task, method, preset.name) in summaries for method in methods)
    ]
    labels = ["success (95 % interval)" if p.name == "exact" else p.label for p in shown]
    header = ("controller", "seeds", *labels, *(column.label for column in benchmark.columns))
    rows = []
    for method in methods:
        exact = summaries[task, method, "exact"]
        starts = exact.success.shape[1]
        fewer = starts != fixed.success.shape[1]
        rows.append(
            (
                f"{method} ({starts} starts)" if fewer else method,
                str(len(exact.results)),
                *(_rate(summaries.get((task, method, p.name)), p.name) for p in shown),
                *(_text(column, exact, fixed) for column in benchmark.columns),
            )
        )
    return Table(task_label(task), benchmark.description, header, tuple(rows))


def _rate(summary: Summary | None, preset: str) -> str:
    if summary is None:
        return NOTHING
    if preset != "exact":
        return f"{summary.rate:.3f}"
    low, high = summary.interval
    return f"{summary.rate:.3f} ({low:.3f}-{high:.3f})"


def _text(column: Column, summary: Summary, fixed: Summary) -> str:
    value = summary.value(column, fixed)
    if math.isnan(value):
        return NOTHING
    return "fails" if math.isinf(value) else format(column.scale * value, column.form)


def task_numbers(task: str, summaries: Summaries) -> list[dict[str, Any]]:
    """List every number of a task, a row for each."""
    columns = find_benchmark(task).columns
    rows = []
    for (of_task, method, preset), summary in summaries.items():
        if of_task != task:
            continue
        fixed = summaries[task, FIXED, preset]
        low, high = summary.interval
        values = {
            "success": summary.rate,
            "success_low": low,
            "success_high": high,
            **{column.name: summary.value(column, fixed) for column in columns},
            "decision_time": summary.decision_time,
        }
        rows += [
            {
                "task": task,
                "controller": method,
                "preset": preset,
                "seeds": len(summary.results),
                "starts": summary.success.shape[1],
                "metric": name,
                "value": value,
            }
            for name, value in values.items()
        ]
    return rows


def speed_table(grid: SpeedGrid, summaries: dict[str, Summary]) -> Table:
    """Show the time to sort by entry speed: a column for each box and method."""
    pairs = [(parcel, name) for parcel in PARCELS for name in summaries]

    def time(name: str, parcel: str, speed: float) -> str:
        place = int(np.argmin(np.abs(grid.speeds - speed)))
        slowest = float(grid.slower_time(summaries[name], parcel)[:, place].max())
        if np.isfinite(slowest):
            return f"{slowest:.3f}"
        some = grid.success(summaries[name], parcel)[:, place].any()
        return "some seeds" if some else "fails"

    rows = [
        (f"{speed:.1f}", *(time(name, parcel, speed) for parcel, name in pairs))
        for speed in SHOWN_SPEEDS
    ]
    least = [grid.minimum_speed(summaries[name], parcel) for parcel, name in pairs]
    rates = [grid.success_rate(summaries[name], parcel) for parcel, name in pairs]
    rows.append(("minimum [m/s]", *(NOTHING if np.isnan(v) else f"{v:.2f}" for v in least)))
    rows.append(("success", *(f"{rate:.3f}" for rate in rates)))
    speeds = grid.speeds
    return Table(
        "sorting by entry speed",
        "time to sort [s], the slower of both sides and the slowest seed; minimum and success over "
        f"{len(speeds)} speeds from {speeds[0]:g} to {speeds[-1]:g} m/s",
        ("entry speed [m/s]", *(f"{parcel}-box, {name}" for parcel, name in pairs)),
        tuple(rows),
    )


def decision_table(tasks: Sequence[str], summaries: Summaries) -> Table:
    """Show decision times: a row for each method, a column for each task, exact sensors.

    They are measured, and differ from run to run: this table has a file of its own, so that the
    others can be compared byte for byte.
    """

    def time(task: str, method: str) -> str:
        summary = summaries.get((task, method, "exact"))
        return NOTHING if summary is None else f"{1e6 * summary.decision_time:.1f}"

    return Table(
        "decisions",
        "time of one decision in one environment [us], decided many at a time, median; it differs "
        "from run to run, as nothing else here does",
        ("controller", *map(task_label, tasks)),
        tuple(
            (method, *(time(task, method) for task in tasks))
            for method in dict.fromkeys(name for _, name, _ in summaries)
        ),
    )
