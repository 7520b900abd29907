"""A task's table: as rows of text, on screen, as Markdown, CSV and JSON."""

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Screen

from surface_gym.conditions import CONDITIONS, Condition

from .columns import Column, columns_of
from .contenders import FIXED
from .summary import Summary
from .trials import Trial

Summaries = dict[tuple[str, str, str], Summary]
NOTHING = "-"


@dataclass(frozen=True)
class Table:
    """One task: a row a contender."""

    task: str
    told: str  # the starts, in a sentence
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def make_table(trial: Trial, summaries: Summaries) -> Table:
    """The table of a task; what a decision takes is told apart, since it is never the same.

    Args:
        trial: the task and its starts.
        summaries: of all contenders and conditions.
    """
    names = list(dict.fromkeys(who for task, who, _ in summaries if task == trial.name))
    fixed = summaries[trial.name, FIXED, "exact"]
    shown = [
        condition
        for condition in CONDITIONS.values()
        if any((trial.name, who, condition.name) in summaries for who in names)
    ]
    columns = columns_of(trial.name)
    header = (
        "controller", "seeds", *_success_labels(shown), *(column.label for column in columns),
    )  # fmt: skip
    rows = []
    for who in names:
        exact = summaries[trial.name, who, "exact"]
        rates = [
            _rate(summaries.get((trial.name, who, condition.name)), condition)
            for condition in shown
        ]
        rows.append(
            (
                _name(who, exact, fixed),
                str(len(exact.cells)),
                *rates,
                *(_text(column, exact, fixed) for column in columns),
            )
        )
    return Table(trial.label, trial.told, header, tuple(rows))


def _name(who: str, exact: Summary, fixed: Summary) -> str:
    fewer = exact.success.shape[1] != fixed.success.shape[1]
    return f"{who} ({exact.success.shape[1]} starts)" if fewer else who


def _success_labels(conditions: Sequence[Condition]) -> list[str]:
    return [
        "success (95 % interval)" if condition.name == "exact" else condition.label
        for condition in conditions
    ]


def _rate(summary: Summary | None, condition: Condition) -> str:
    if summary is None:
        return NOTHING
    if condition.name != "exact":
        return f"{summary.rate:.3f}"
    low, high = summary.interval
    return f"{summary.rate:.3f} ({low:.3f}-{high:.3f})"


def value_of(column: Column, summary: Summary, fixed: Summary) -> float:
    """A column's number, unscaled; nan where it has none: it needs every start of both boxes, and
    saw some, or other parcels.
    """
    fewer = summary.success.shape[1] != fixed.success.shape[1]
    others = bool(CONDITIONS[summary.cells[0].condition].parcels)
    if column.every_start and (fewer or others):
        return math.nan
    return column.value(summary, fixed)


def _text(column: Column, summary: Summary, fixed: Summary) -> str:
    value = value_of(column, summary, fixed)
    if math.isnan(value):
        return NOTHING
    return "fails" if math.isinf(value) else format(column.scale * value, column.form)


def print_table(table: Table, console: Console) -> None:
    """Show a table on screen; where it is too wide, in parts that repeat the first column."""
    parts = _parts(table, console.width)
    for number, part in enumerate(parts):
        last = number == len(parts) - 1
        screen = Screen(
            title=None if number else table.task.capitalize(),
            caption=escape(table.told) if last else None,
            box=SIMPLE,
        )
        for column in part:
            screen.add_column(
                escape(table.header[column]),
                justify="right" if column else "left",
                min_width=_width(table, column),
            )
        for row in table.rows:
            screen.add_row(*(escape(row[column]) for column in part))
        console.print(screen)


def _width(table: Table, column: int) -> int:
    """Letters that a column needs: a cell stands in one line, a heading may be broken."""
    words = table.header[column].split()
    return max(len(text) for text in (*words, *(row[column] for row in table.rows)))


def _parts(table: Table, width: int) -> list[list[int]]:
    """Columns that stand beside each other on a screen."""
    apart = 3  # blanks about a column
    parts = [[0]]
    used = first = _width(table, 0) + 4
    for column in range(1, len(table.header)):
        needed = _width(table, column) + apart
        if used + needed > width and len(parts[-1]) > 1:
            parts.append([0])
            used = first
        parts[-1].append(column)
        used += needed
    return parts


def markdown(table: Table) -> str:
    """A table as Markdown."""
    lines = [table.header, ["---"] + ["---:"] * (len(table.header) - 1), *table.rows]
    text = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return f"## {table.task.capitalize()}\n\n{table.told}\n\n{text}\n"


def write_tables(
    trials: Sequence[Trial], tables: Sequence[Table], summaries: Summaries, folder: Path
) -> None:
    """Write comparison.md, .csv and .json: the last two hold every number, a row each."""
    (folder / "comparison.md").write_text("\n".join(map(markdown, tables)))
    numbers = [row for trial in trials for row in _numbers(trial, summaries)]
    with (folder / "comparison.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(numbers[0]))
        table.writeheader()
        table.writerows(numbers)
    (folder / "comparison.json").write_text(json.dumps(numbers, indent=1, allow_nan=False) + "\n")


def _numbers(trial: Trial, summaries: Summaries) -> list[dict[str, Any]]:
    rows = []
    for (task, who, condition), summary in summaries.items():
        if task != trial.name:
            continue
        fixed = summaries[task, FIXED, condition]
        low, high = summary.interval
        values = {
            "success": summary.rate,
            "success_low": low,
            "success_high": high,
            **{column.name: value_of(column, summary, fixed) for column in columns_of(task)},
            "decision_time": summary.decision_time,
        }
        rows += [
            {
                "task": task,
                "controller": who,
                "condition": condition,
                "seeds": len(summary.cells),
                "starts": summary.success.shape[1],
                "figure": name,
                "value": value if math.isfinite(value) else None,
            }
            for name, value in values.items()
        ]
    return rows
