"""A reproduction as tables on a terminal."""

from collections.abc import Iterator

from rich.console import Console
from rich.table import Table as TextTable
from rich.text import Text

from surface_gym.paper.comparison import Cell, SlowingLayout, Table, Value
from surface_gym.paper.integration import CONVERGED, PAPER_STEP, Integration
from surface_gym.paper.reproduction import Reproduction
from surface_gym.paper.sorting import SortingCase
from surface_gym.paper.targets import SIZES, load_targets

BY_SPEED = ("table3", "table4", "stopping")  # long tables, printed with both boxes side by side
OURS = (f"{1000 * PAPER_STEP.dt:g} ms", "converged")


def print_report(reproduction: Reproduction, console: Console) -> None:
    """Print every table, the sorting rates, how many cells agree, and what the steps do."""
    console.print(
        f"{load_targets().source}\n\n"
        f"Ours at the paper's step ({_integration(PAPER_STEP)}) and converged "
        f"({_integration(CONVERGED)}).\n"
        "* differs from the paper; / is the paper's mark for a task that fails.\n",
        highlight=False,
    )
    for table in reproduction.tables:
        console.print(_by_speed(table) if table.key in BY_SPEED else _by_cell(table))
        console.print()
    console.print(_rates(reproduction))
    console.print()
    console.print(_counts(reproduction))
    for line in _steps(reproduction):
        console.print(line, highlight=False)


def _integration(integration: Integration) -> str:
    return f"{integration.method}, {1000 * integration.dt:g} ms"


def _framed(title: str, caption: str = "") -> TextTable:
    """A table above whose columns the title stands, and the caption below."""
    return TextTable(  # Text, for a bracketed unit in a str would be read as markup
        title=Text(title, style="bold not italic"),
        caption=Text(caption, style="not italic not dim") if caption else None,
        title_justify="left",
        caption_justify="left",
    )


def _heading(table: Table) -> TextTable:
    count = len(table.cells)
    return _framed(
        table.title,
        f"{table.rule}\nagree: {table.paper_step_agreeing} of {count} at the paper's step, "
        f"{table.converged_agreeing} of {count} converged",
    )


def _value(value: Value, decimals: int) -> str:
    if value is None:
        return "/"
    if isinstance(value, SlowingLayout):
        return str(value)
    return f"{value:.{decimals}f}"


def _marked(text: str, agrees: bool) -> Text:
    return Text(text + " ") if agrees else Text(text + "*", style="bold yellow")


def _decimals(cell: Cell) -> int:
    """One more than the paper prints, if it prints any."""
    return cell.decimals + 1 if cell.decimals else 0


def _ours(cell: Cell) -> tuple[Text, Text]:
    return (
        _marked(_value(cell.paper_step, _decimals(cell)), cell.paper_step_agrees),
        _marked(_value(cell.converged, _decimals(cell)), cell.converged_agrees),
    )


def _difference(ours: Value, cell: Cell) -> str:
    if isinstance(ours, (int, float)) and isinstance(cell.paper, (int, float)):
        return f"{ours - cell.paper:+.{_decimals(cell)}f}"
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
        paper_step, converged = _ours(cell)
        result.add_row(
            "" if k > 0 and cell.row == row else cell.row,
            Text(cell.column),
            _value(cell.paper, cell.decimals),
            paper_step,
            _difference(cell.paper_step, cell),
            converged,
            _difference(cell.converged, cell),
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
                entries += [_value(cell.paper, cell.decimals), *_ours(cell)]
        result.add_row(row, *entries)
    return result


def _rates(reproduction: Reproduction) -> TextTable:
    """Figure 8, of which the paper prints no numbers but a band."""
    low, high = load_targets().medium_rates
    by_input = {"v0": reproduction.sorted_by_speed, "tilt": reproduction.sorted_by_tilt}
    counts = "\n".join(
        f"  {size}-box by {name}: {_count_medium([case for case in cases if case.size == size])}"
        for name, cases in by_input.items()
        for size in SIZES
    )
    result = _framed(
        "Figure 8: sorting rate [pcs/h], by v0 on the level or by tilt from standstill",
        f"* outside the paper's band for torsional discs, {low:g} to {high:g} pcs/h\n"
        f"in the band at the paper's step, and converged:\n{counts}",
    )
    result.add_column("\nv0 or tilt")
    for size in SIZES:
        for name in (f"{size}-box\n{OURS[0]}", f"\n{OURS[1]}"):
            result.add_column(name, justify="right")
    for cases in by_input.values():
        half = len(cases) // len(SIZES)
        for small, big in zip(cases[:half], cases[half:], strict=True):
            row = f"{small.speed:.1f} m/s" if small.speed > 0.0 else f"{small.tilt:g}°"
            rates = (small.paper_step, small.converged, big.paper_step, big.converged)
            result.add_row(row, *(_rate(sorted_.rate) for sorted_ in rates))
        result.add_section()
    return result


def _is_medium(rate: float) -> bool:
    low, high = load_targets().medium_rates
    return low <= rate <= high


def _rate(rate: float | None) -> Text:
    return Text("/ ") if rate is None else _marked(f"{rate:.0f}", _is_medium(rate))


def _count_medium(cases: list[SortingCase]) -> str:
    """How many of those sorted lie in the band, at the paper's step and converged."""
    counts = []
    for rates in (
        [case.paper_step.rate for case in cases],
        [case.converged.rate for case in cases],
    ):
        done = [rate for rate in rates if rate is not None]
        counts.append(f"{sum(map(_is_medium, done))} of {len(done)}")
    return ", ".join(counts)


def _counts(reproduction: Reproduction) -> TextTable:
    result = _framed("Cells that agree")
    result.add_column("")
    for name in ("cells", *OURS):
        result.add_column(name, justify="right")
    for table in reproduction.tables:
        counts = (len(table.cells), table.paper_step_agreeing, table.converged_agreeing)
        result.add_row(Text(table.title), *map(str, counts))
    return result


def _steps(reproduction: Reproduction) -> Iterator[str]:
    for spread in reproduction.near_the_limit:
        yield (
            f"Table 2, converged against {_integration(spread.integrations[1])}: "
            f"at most {spread.position:.1f} mm and {spread.angle:.2f}° apart."
        )
    spread = reproduction.about_paper_step
    steps = [1000 * integration.dt for integration in spread.integrations]
    yield (
        f"Table 2, explicit steps of {min(steps):g} to {max(steps):g} ms: "
        f"up to {spread.position:.0f} mm and {spread.angle:.1f}° apart; the sign function "
        "chatters."
    )
