"""What was found as tables: for a terminal, and as CSV."""

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from surface_gym.design.case import GROUPS, TOGETHER, WORST, enough
from surface_gym.design.columns import Columns
from surface_gym.design.limits import FrictionRange, Limits
from surface_gym.design.purposes import Purpose
from surface_gym.design.sensitivity import Sensitivity
from surface_gym.design.size_map import SuccessMap
from surface_gym.design.telling import field_told

Cell = str | float | int | bool | None
NOTHING = "-"
SHOWN = 11  # sizes of a map that a terminal shows
IN_DRAWS = f"{1.0 - WORST:.0%} of draws"


@dataclass(frozen=True)
class Table:
    """A header and rows; shown in a terminal, written as CSV, or both."""

    name: str  # of the file, without the ending
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    shown: bool = True  # in a terminal
    written: bool = True  # as CSV


def write_csv(table: Table, folder: Path) -> Path:
    """Write a table into a folder, numbers as they are, a cell with nothing in it empty; where."""
    path = folder / f"{table.name}.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table.header)
        for row in table.rows:
            writer.writerow("" if _is_nothing(cell) else cell for cell in row)
    return path


def text_of(cell: Cell) -> str:
    """A cell for a terminal."""
    if _is_nothing(cell):
        return NOTHING
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)


def columns_tables(
    purpose: Purpose, by_rows: Sequence[Columns], by_speed: Sequence[tuple[float, Columns]]
) -> tuple[Table, ...]:
    """Of how many columns: where something is unknown, by the number of rows, by entry speed.

    Args:
        purpose: what they are for.
        by_rows: the last has the rows that are taken.
        by_speed: entry speeds [m/s] and what they take.
    """
    own = by_rows[-1]
    together = [each.group for each in own.worst[-1:]]
    groups = [each.group for each in own.worst]
    return (
        Table(
            "columns",
            f"With {own.rows} rows",
            ("unknown", "columns it takes", f"success with {text_of(own.columns)}"),
            (
                ("nothing", own.columns, float(own.columns is not None)),
                *((group_told(each.group), each.columns, each.success) for each in own.worst),
            ),
        ),
        Table(
            "columns_by_rows",
            "By the rows of the line",
            _columns_header(purpose, together),
            tuple(_columns_row(purpose, each, together) for each in by_rows),
        ),
        Table(
            "columns_by_speed",
            "By entry speed",
            ("speed [m/s]", *_columns_header(purpose, groups)),
            tuple((speed, *_columns_row(purpose, each, groups)) for speed, each in by_speed),
            shown=False,
        ),
    )


def limits_tables(name: str, limits: Limits) -> tuple[Table, ...]:
    """Of how slow or how flat: the spans, and the curves they come from."""
    unit = limits.unit
    return (
        Table(
            name,
            f"Limits of {limits.varied}",
            ("unknown", f"least [{unit}]", f"most [{unit}]", "success as it comes"),
            tuple(_limits_rows(limits)),
        ),
        Table(
            f"{name}_curve",
            f"Success by {limits.varied}",
            ("unknown", f"{limits.varied} [{unit}]", "success"),
            tuple(_curve_rows(limits)),
            shown=False,
        ),
    )


def friction_tables(found: FrictionRange) -> tuple[Table, ...]:
    """Of how far friction may be off: the spans of both coefficients, and their curves."""
    both = (found.along, found.across)
    return (
        Table(
            "friction",
            "Limits of friction, as factors",
            ("varied", "unknown", "least [-]", "most [-]", "success as it comes"),
            tuple((limits.varied, *row) for limits in both for row in _limits_rows(limits)),
        ),
        Table(
            "friction_curve",
            "Success by friction",
            ("varied", "unknown", "factor [-]", "success"),
            tuple((limits.varied, *row) for limits in both for row in _curve_rows(limits)),
            shown=False,
        ),
    )


def map_tables(found: SuccessMap) -> tuple[Table, ...]:
    """Of a map: the speeds that succeed at some sizes, and each cell."""
    places = sorted({round(k * (len(found.sizes) - 1) / (SHOWN - 1)) for k in range(SHOWN)})
    rows: list[tuple[Cell, ...]] = []
    for k in places:
        speeds = found.speeds[enough(found.share[k])]
        ends = (speeds[0], speeds[-1]) if len(speeds) else (math.nan, math.nan)
        rows.append((float(found.sizes[k]), *map(float, ends), float(found.share[k].mean())))
    cells = tuple(
        (size, speed, bool(found.nominal[k, i]), float(found.share[k, i]))
        for k, size in enumerate(found.sizes.tolist())
        for i, speed in enumerate(found.speeds.tolist())
    )
    return (
        Table(
            "map_sizes",
            f"Least and most entry speed that does it in {IN_DRAWS}",
            ("size [-]", "least [m/s]", "most [m/s]", "success over all speeds"),
            tuple(rows),
            written=False,
        ),
        Table(
            "map",
            "Success by size and speed",
            ("size [-]", "speed [m/s]", "nothing unknown", "success"),
            cells,
            shown=False,
        ),
    )


def sensitivity_tables(found: Sensitivity) -> tuple[Table, ...]:
    """Of what each thing that is not known does alone."""
    purpose = found.arrangement.case.purpose
    known = purpose.scale * found.measure
    quantiles = [f"{share:.0%} of draws below" for share in (WORST, 1.0 - WORST)]
    header = ("unknown alone", *quantiles, "success", "spread is")
    first: tuple[Cell, ...] = ("nothing", known, known, float(found.success), "")
    rows = [
        (
            field_told(bar),
            purpose.scale * bar.low,
            purpose.scale * bar.high,
            bar.success,
            "usual" if bar.usual else "the case's",
        )
        for bar in found.bars
    ]
    title = f"{purpose.measured.capitalize()} [{purpose.unit}]"
    return (Table("sensitivity", title, header, (first, *rows)),)


def _columns_header(purpose: Purpose, groups: Sequence[str]) -> tuple[str, ...]:
    worst = [(f"for {IN_DRAWS}, {group}", f"success, {group}") for group in groups]
    return (
        "rows", "columns", "modules", "axes", f"{purpose.measured} [{purpose.unit}]",
        "steps that tip", *(name for pair in worst for name in pair),
    )  # fmt: skip


def _columns_row(purpose: Purpose, found: Columns, groups: Sequence[str]) -> tuple[Cell, ...]:
    worst = [(each.columns, each.success) for each in found.worst if each.group in groups]
    return (
        found.rows, found.columns, found.modules, found.layout, purpose.scale * found.measure,
        found.tipping, *(value for pair in worst for value in pair),
    )  # fmt: skip


def _limits_rows(limits: Limits) -> Iterable[tuple[Cell, ...]]:
    for span in limits.spans:
        own = float(span.share[abs(span.values - limits.own).argmin()])
        ends = [None if end is None else limits.scale * end for end in (span.least, span.most)]
        yield (group_told(span.group), *ends, own)


def _curve_rows(limits: Limits) -> Iterable[tuple[Cell, ...]]:
    for span in limits.spans:
        for value, share in zip(span.values.tolist(), span.share.tolist(), strict=True):
            yield (group_told(span.group), limits.scale * value, share)


def group_told(group: str) -> str:
    """A group of what is not known, as a label."""
    if group == TOGETHER:
        return "all together"
    return group if group in GROUPS else "nothing"


def _is_nothing(cell: Cell) -> bool:
    return cell is None or (isinstance(cell, float) and math.isnan(cell))
