"""The paper's tables and Figure 8 on a terminal."""

from collections.abc import Sequence

from rich.table import Table as TextTable
from rich.text import Text

from surface_gym.paper.comparison import Cell, Found, Table
from surface_gym.paper.framing import COARSE_NAME, NAMES, OURS, framed, marked, percent, shown
from surface_gym.paper.reproduction import Reproduction
from surface_gym.paper.sorting import SortingCase
from surface_gym.paper.targets import SIZES, load_targets

BY_SPEED = ("table3", "table4", "stopping")  # long tables, printed with both boxes side by side


def table_of(table: Table) -> TextTable:
    """A table of the paper beside ours."""
    return _by_speed(table) if table.key in BY_SPEED else _by_cell(table)


def tipping_of(table: Table) -> str:
    """Share of the steps in which Eq. (1) has no solution, by box and integration."""
    boxes = []
    for size in SIZES:
        shares = [table.tipping(k).get(size) for k in range(len(NAMES))]
        told = [
            f"{name} {percent(*share)}"
            for share, name in zip(shares, NAMES, strict=True)
            if share is not None
        ]
        if told:
            boxes.append(f"  {size}-box: " + ", ".join(told))
    return "\n".join(["steps in which Eq. (1) has no solution:", *boxes])


def _heading(table: Table) -> TextTable:
    count = len(table.cells)
    return framed(
        table.title,
        f"{table.rule}\nagree: {table.agreeing(0)} of {count} at {COARSE_NAME}, "
        f"{table.agreeing(1)} of {count} converged\n{tipping_of(table)}",
    )


def _decimals(cell: Cell) -> int:
    """One more than the paper prints, if it prints any."""
    return cell.decimals + 1 if cell.decimals else 0


def _ours(cell: Cell) -> list[Text]:
    return [
        marked(shown(cell.ours[k].value, _decimals(cell)), cell.agrees(k)) for k in range(len(OURS))
    ]


def _difference(ours: Found, cell: Cell) -> str:
    if isinstance(ours.value, (int, float)) and isinstance(cell.paper, (int, float)):
        return f"{ours.value - cell.paper:+.{_decimals(cell)}f}"
    return ""


def _by_cell(table: Table) -> TextTable:
    """One line a cell, with differences."""
    result = _heading(table)
    for name in ("", ""):
        result.add_column(name)
    for name in ("paper", OURS[0], "- paper", OURS[1], "- paper"):
        result.add_column(name, justify="right")
    row = table.cells[0].row
    for k, cell in enumerate(table.cells):
        if cell.row != row:
            result.add_section()
        coarse, converged = _ours(cell)
        result.add_row(
            "" if k > 0 and cell.row == row else cell.row,
            Text(cell.column),
            shown(cell.paper, cell.decimals),
            coarse,
            _difference(cell.ours[0], cell),
            converged,
            _difference(cell.ours[1], cell),
        )
        row = cell.row
    return result


def _by_speed(table: Table) -> TextTable:
    """One line a speed, both boxes side by side."""
    result = _heading(table)
    result.add_column("\nv0")
    for size in SIZES:
        for name in (f"{size}-box\npaper", f"\n{OURS[0]}", f"\n{OURS[1]}"):
            result.add_column(name, justify="right")
    for row in dict.fromkeys(cell.row for cell in table.cells):
        entries: list[str | Text] = []
        for cell in table.cells:
            if cell.row == row:
                entries += [shown(cell.paper, cell.decimals), *_ours(cell)]
        result.add_row(row, *entries)
    return result


def rates(reproduction: Reproduction) -> TextTable:
    """Figure 8, of which the paper prints no numbers but a band."""
    low, high = load_targets().medium_rates
    by_input = {"v0": reproduction.sorted_by_speed, "tilt": reproduction.sorted_by_tilt}
    counts = "\n".join(
        f"  {size}-box by {name}: {_count_medium([case for case in cases if case.size == size])}"
        for name, cases in by_input.items()
        for size in SIZES
    )
    result = framed(
        "Figure 8: sorting rate [pcs/h], by v0 on the level or by tilt from standstill",
        f"* outside the paper's band for torsional discs, {low:g} to {high:g} pcs/h\n"
        f"in the band at {COARSE_NAME}, and converged:\n{counts}",
    )
    result.add_column("\nv0 or tilt")
    for size in SIZES:
        for name in (f"{size}-box\n{OURS[0]}", f"\n{OURS[1]}"):
            result.add_column(name, justify="right")
    for cases in by_input.values():
        half = len(cases) // len(SIZES)
        for small, big in zip(cases[:half], cases[half:], strict=True):
            row = f"{small.speed:.1f} m/s" if small.speed > 0.0 else f"{small.tilt:g}°"
            both = (*small.ours[: len(OURS)], *big.ours[: len(OURS)])
            result.add_row(row, *(_rate(sorted_.rate) for sorted_ in both))
        result.add_section()
    return result


def _is_medium(rate: float) -> bool:
    low, high = load_targets().medium_rates
    return low <= rate <= high


def _rate(rate: float | None) -> Text:
    return Text("/ ") if rate is None else marked(f"{rate:.0f}", _is_medium(rate))


def _count_medium(cases: Sequence[SortingCase]) -> str:
    """How many of those sorted lie in the band, at the coarse step and converged."""
    counts = []
    for k in range(len(OURS)):
        done = [rate for case in cases if (rate := case.ours[k].rate) is not None]
        counts.append(f"{sum(map(_is_medium, done))} of {len(done)}")
    return ", ".join(counts)
