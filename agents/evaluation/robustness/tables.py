"""The sweep as tables: for the screen, as Markdown, CSV and JSON."""

import csv
import json
from pathlib import Path
from typing import Any

from ...tasks import label_of
from ..contenders import PLANNER
from ..table import NOTHING, Table, markdown
from .factors import FACTORS, Factor, Level
from .results import SHAPES, Rate, Sweep

TITLE = "# Robustness\n\nSuccess where one thing at a time is otherwise than as trained.\n\n"


def sweep_tables(sweep: Sweep) -> list[Table]:
    """Three a task: by factor, by the size of squares, and by the shape of the lab's parcels."""
    made = (factor_table, square_table, shape_table)
    return [make(sweep, task) for task in sweep.tasks for make in made]


def factor_table(sweep: Sweep, task: str) -> Table:
    """A row a contender, a column a factor with the levels that are told."""
    names = sweep.contenders(task)
    factors = [
        factor
        for factor in FACTORS.values()
        if any(sweep.rate(task, who, factor.name, factor.told[0]) for who in names)
    ]
    rows = [
        (who, *(" / ".join(_text(each) for each in _told(sweep, task, who, f)) for f in factors))
        for who in names
    ]
    header = ("controller", *map(_heading, factors))
    told = f"success of {_starts(sweep, task)}, one factor changed at a time"
    return Table(label_of(task), told, header, tuple(rows))


def _told(sweep: Sweep, task: str, who: str, factor: Factor) -> list[Rate | None]:
    return [sweep.rate(task, who, factor.name, level) for level in factor.told]


def _heading(factor: Factor) -> str:
    if len(factor.told) == 1:
        return factor.label
    levels = " / ".join(map(level_text, factor.told))
    return f"{factor.label}: {levels} {factor.unit}".rstrip()


def level_text(level: Level) -> str:
    """A level as it is told."""
    return level if isinstance(level, str) else f"{level:g}"


def _text(rate: Rate | None) -> str:
    return NOTHING if rate is None else f"{rate.value:.2f}"


def _starts(sweep: Sweep, task: str) -> str:
    """How many starts each was tried on, in words."""
    counts: dict[int, list[str]] = {}
    for cell in sweep.cells:
        if cell.task == task and cell.contender not in counts.setdefault(cell.starts, []):
            counts[cell.starts].append(cell.contender)
    most = max(counts)
    fewer = [f"{', '.join(who)}: {count}" for count, who in counts.items() if count != most]
    return f"{most} starts" + (f" ({'; '.join(fewer)})" if fewer else "")


def square_table(sweep: Sweep, task: str) -> Table:
    """A row a contender: where squares are sorted worst, and beside the planner."""
    squares = FACTORS["square"]
    rows = []
    for who in sweep.contenders(task):
        rates = {
            level: rate
            for level in squares.levels
            if (rate := sweep.rate(task, who, "square", level)) is not None
        }
        if not rates:
            continue
        worst = min(rates, key=lambda level: rates[level].value)
        shares = [
            share
            for level in rates
            if (share := _share_of_planner(sweep, task, who, level)) is not None
        ]
        rows.append(
            (
                who,
                f"{rates[worst].value:.2f} at {level_text(worst)}",
                f"{sum(rate.value for rate in rates.values()) / len(rates):.2f}",
                f"{min(shares):.2f}" if shares else NOTHING,
            )
        )
    header = ("controller", "worst, at [m]", "mean over sizes", "least share of the planner's")
    first, last = squares.levels[0], squares.levels[-1]
    told = (
        f"success on squares of {first:g} to {last:g} m; beside the planner's on the starts and "
        "sizes that it was tried on"
    )
    return Table(f"{label_of(task)}: squares", told, header, tuple(rows))


def _share_of_planner(sweep: Sweep, task: str, who: str, level: Level) -> float | None:
    """Successes over the planner's, on the starts of its own; None where it was not tried, or in
    vain.
    """
    planned = sweep.success(task, PLANNER, "square", level)
    success = sweep.success(task, who, "square", level)
    if planned is None or success is None or not planned.any():
        return None
    return float(success[:, : planned.shape[1]].mean() / planned.mean())


def shape_table(sweep: Sweep, task: str) -> Table:
    """A row a contender, a column a shape of the lab's parcels."""
    rows = []
    for who in sweep.contenders(task):
        shapes = sweep.by_shape(task, who)
        if not shapes:
            continue
        whole = sweep.rate(task, who, "lab", "lab")
        assert whole is not None
        rows.append(
            (
                who,
                f"{whole.value:.3f} ({whole.low:.3f}-{whole.high:.3f})",
                *(_text(shapes.get(shape)) for shape in SHAPES),
            )
        )
    header = ("controller", "success (95 % interval)", *SHAPES)
    return Table(f"{label_of(task)}: lab", "success in the lab, by shape", header, tuple(rows))


def write_tables(sweep: Sweep, tables: list[Table], folder: Path) -> None:
    """Write robustness.md, .csv and .json: the last two hold every level, a row each."""
    (folder / "robustness.md").write_text(TITLE + "\n".join(map(markdown, tables)))
    numbers = _numbers(sweep)
    with (folder / "robustness.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(numbers[0]))
        table.writeheader()
        table.writerows(numbers)
    (folder / "robustness.json").write_text(json.dumps(numbers, indent=1, allow_nan=False) + "\n")


def _numbers(sweep: Sweep) -> list[dict[str, Any]]:
    rows = []
    for task in sweep.tasks:
        for who in sweep.contenders(task):
            for factor in FACTORS.values():
                for level in factor.levels:
                    rate = sweep.rate(task, who, factor.name, level)
                    error = sweep.error(task, who, factor.name, level)
                    if rate is not None:
                        rows.append(_row(task, who, factor, level, rate, error))
            for shape, rate in sweep.by_shape(task, who).items():
                rows.append(_row(task, who, FACTORS["lab"], shape, rate, None))
    return rows


def _row(
    task: str, who: str, factor: Factor, level: Level, rate: Rate, error: float | None
) -> dict[str, Any]:
    return {
        "task": task,
        "controller": who,
        "factor": factor.name,
        "level": level,
        "unit": factor.unit,
        "seeds": rate.seeds,
        "starts": rate.starts,
        "success": rate.value,
        "success_low": rate.low,
        "success_high": rate.high,
        "median_error": error,
    }
