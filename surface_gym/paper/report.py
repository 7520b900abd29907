"""Terminal tables of a reproduction."""

from collections.abc import Iterator, Sequence

from rich import box
from rich.console import Console
from rich.table import Table as TextTable
from rich.text import Text

from surface_gym.paper import runs
from surface_gym.paper.claims import INWARDS, OFFSETS, TURNS, Alignment, SelfStop
from surface_gym.paper.reproduction import NAMES, Reproduction
from surface_gym.paper.runs import (
    ComputedValue,
    PaperTable,
    SlowingLayout,
    SortingCase,
    TableCell,
    Value,
)

COARSE_NAME = NAMES[0]
OURS = NAMES[:2]  # columns of a table
# keys of long tables, printed with both boxes side by side
BY_SPEED = ("table3", "table4", "stopping")


def make_table(title: str, *columns: str, caption: str = "", labels: int = 1) -> TextTable:
    """Make a table with title and caption; the first `labels` columns are text."""
    table = TextTable(  # Text, since bracketed units in a str would be markup
        title=Text(title, style="bold not italic"),
        caption=Text(caption, style="not italic not dim") if caption else None,
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for k, column in enumerate(columns):
        number = k >= labels
        table.add_column(Text(column), justify="right" if number else "left", no_wrap=number)
    return table


def print_report(reproduction: Reproduction, console: Console) -> None:
    """Print every table, the sorting rates, the agreement and the effect of steps."""
    console.print(
        f"{runs.load_targets().source}\n\n"
        f"The paper prints no step. Ours at {COARSE_NAME} ({runs.COARSE}), which we infer that it "
        f"took, and converged ({runs.CONVERGED}).\n"
        "* differs from the paper; / is the paper's mark for a task that fails.\n"
        "Where Eq. (1) has no solution the box would tip; taken instead are the forces that bear "
        "its weight and come nearest to the moments, on which the values then hang. Shares "
        "of the steps up to the value stand below each table, as well by the method that does not "
        f"chatter ({runs.SMOOTH}).\n",
        highlight=False,
    )
    for part in (
        *(
            (_by_speed if table.key in BY_SPEED else _by_cell)(table)
            for table in reproduction.tables
        ),
        _rates(reproduction),
        _self_stops(reproduction.self_stopping),
        _alignment(reproduction.alignment),
        _counts(reproduction),
        _other_steps(reproduction),
    ):
        console.print(part)
        console.print()
    for line in _spreads(reproduction):
        console.print(line, highlight=False)


def _caption(table: PaperTable) -> str:
    """Return the text above a table's cells.

    It states the rule of agreement, the number of agreeing cells, and the share of steps in which
    Eq. (1) has no solution.
    """
    count = len(table.cells)
    shares = [table.tipping(k) for k in range(len(NAMES))]
    boxes = []
    for size in runs.SIZES:
        ranges = [
            f"{name} {_percent(*share[size])}"
            for name, share in zip(NAMES, shares, strict=True)
            if size in share
        ]
        boxes += [f"\n  {size}-box: {', '.join(ranges)}"] if ranges else []
    return (
        f"{table.rule}\nagree: {table.agreeing(0)} of {count} at {COARSE_NAME}, "
        f"{table.agreeing(1)} of {count} converged\n"
        f"steps in which Eq. (1) has no solution:{''.join(boxes)}"
    )


def _percent(least: float, largest: float) -> str:
    """Return two shares as a range."""
    low, high = f"{100.0 * least:.0f}", f"{100.0 * largest:.0f}"
    return f"{low} %" if low == high else f"{low} to {high} %"


def _text(value: Value, decimals: int) -> str:
    """Return a value as text; / for None."""
    if value is None:
        return "/"
    return str(value) if isinstance(value, SlowingLayout) else f"{value:.{decimals}f}"


def _mark(text: str, agrees: bool) -> Text:
    """Add a star to a value that differs."""
    return Text(text + " ") if agrees else Text(text + "*", style="bold yellow")


def _decimals(cell: TableCell) -> int:
    """Return one decimal more than the paper prints, if it prints any."""
    return cell.decimals + 1 if cell.decimals else 0


def _ours(cell: TableCell) -> list[Text]:
    return [
        _mark(_text(cell.ours[k].value, _decimals(cell)), cell.agrees(k)) for k in range(len(OURS))
    ]


def _difference(ours: ComputedValue, cell: TableCell) -> str:
    if isinstance(ours.value, (int, float)) and isinstance(cell.paper, (int, float)):
        return f"{ours.value - cell.paper:+.{_decimals(cell)}f}"
    return ""


def _by_cell(table: PaperTable) -> TextTable:
    """Make a table with one line per cell, and differences."""
    columns = ("", "", "paper", OURS[0], "- paper", OURS[1], "- paper")
    result = make_table(table.title, *columns, caption=_caption(table), labels=2)
    row = ""
    for cell in table.cells:
        if row and cell.row != row:
            result.add_section()
        coarse, converged = _ours(cell)
        result.add_row(
            Text("" if cell.row == row else cell.row), Text(cell.column),
            _text(cell.paper, cell.decimals), coarse, _difference(cell.ours[0], cell), converged,
            _difference(cell.ours[1], cell),
        )  # fmt: skip
        row = cell.row
    return result


def _by_speed(table: PaperTable) -> TextTable:
    """Make a table with one line per speed, both boxes side by side."""
    columns = [
        name
        for size in runs.SIZES
        for name in (f"{size}-box\npaper", f"\n{OURS[0]}", f"\n{OURS[1]}")
    ]
    result = make_table(table.title, "\nv0", *columns, caption=_caption(table))
    rows: dict[str, list[str | Text]] = {}
    for cell in table.cells:
        rows.setdefault(cell.row, []).extend([_text(cell.paper, cell.decimals), *_ours(cell)])
    for row, entries in rows.items():
        result.add_row(row, *entries)
    return result


def _rates(reproduction: Reproduction) -> TextTable:
    """Tabulate Figure 8; the paper prints only a band of it."""
    low, high = runs.load_targets().medium_rates
    by_input = {"v0": reproduction.sorted_by_speed, "tilt": reproduction.sorted_by_tilt}
    counts = "\n".join(
        f"  {size}-box by {name}: {_count_medium([case for case in cases if case.size == size])}"
        for name, cases in by_input.items()
        for size in runs.SIZES
    )
    result = make_table(
        "Figure 8: sorting rate [pcs/h], by v0 on the level or by tilt from standstill",
        "\nv0 or tilt",
        *(name for size in runs.SIZES for name in (f"{size}-box\n{OURS[0]}", f"\n{OURS[1]}")),
        caption=f"* outside the paper's band for torsional discs, {low:g} to {high:g} pcs/h\n"
        f"in the band at {COARSE_NAME}, and converged:\n{counts}",
    )
    for cases in by_input.values():
        half = len(cases) // len(runs.SIZES)
        for small, big in zip(cases[:half], cases[half:], strict=True):
            row = f"{small.speed:.1f} m/s" if small.speed > 0.0 else f"{small.tilt:g}°"
            found = [done.rate for case in (small, big) for done in case.ours[: len(OURS)]]
            result.add_row(
                row,
                *(
                    Text("/ ") if rate is None else _mark(f"{rate:.0f}", _is_medium(rate))
                    for rate in found
                ),
            )
        result.add_section()
    return result


def _is_medium(rate: float) -> bool:
    low, high = runs.load_targets().medium_rates
    return low <= rate <= high


def _count_medium(cases: Sequence[SortingCase]) -> str:
    """Count the sorted boxes with rates in the band, at the coarse step and converged."""
    counts = []
    for k in range(len(OURS)):
        done = [rate for case in cases if (rate := case.ours[k].rate) is not None]
        counts.append(f"{sum(map(_is_medium, done))} of {len(done)}")
    return ", ".join(counts)


def _self_stops(cases: Sequence[SelfStop]) -> TextTable:
    """Tabulate the steepest tilt at which a pushed box stops by itself."""
    result = make_table(
        "Section 6.2: steepest tilt at which the S-box stops by itself",
        "axes",
        "paper",
        "expected",
        *(str(case.integration) for case in cases[:2]),
        caption="expected: tan = sqrt(2) mu_min where all axes stand at +45°, tan = (mu_max + "
        "mu_min) / sqrt(2) in alternate rows. The paper's sin = mu_min / sqrt(2) leaves out the "
        "part along x of the friction along the axes.",
    )
    for case, other in zip(cases[::2], cases[1::2], strict=True):
        result.add_row(
            case.layout,
            "" if case.study is None else f"{case.study:.2f}°",
            *(f"{tilt:.2f}°" for tilt in (case.expected, case.measured, other.measured)),
        )
    return result


def _alignment(cases: Sequence[Alignment]) -> TextTable:
    """List the end poses of boxes that enter a zone at +-45 deg with an offset or a turn."""
    result = make_table(
        "Section 5.2: do rows at ±45° in turn align a box? Implicit, 1 ms",
        "rows push,\ncolumns, v0",
        "\ntilt",
        *(f"from\n{1000 * offset:.0f} mm" for offset in OFFSETS),
        *(f"from\n{turn:.0f}°" for turn in TURNS),
        "\nboth",
        caption="As it leaves the zone, or rests in it: off the middle [mm] if it came straight, "
        "turned [°] if it came in the middle; * no nearer than it came. Both: of those that came "
        "off the middle and turned, how many end nearer by a tenth in both.",
    )
    size = cases[0].zone.size
    for case in cases:
        zone = case.zone
        if zone.size != size:
            result.add_section()
        size = zone.size
        towards = "inwards" if zone.towards == INWARDS else "outwards"
        ends = (
            *((1000 * end[0], 1000 * o) for end, o in zip(case.straight, OFFSETS, strict=True)),
            *((end[1], turn) for end, turn in zip(case.centred, TURNS, strict=True)),
        )
        result.add_row(
            f"{zone.size} {towards}, {zone.columns}, {zone.speed:g}",
            f"{zone.tilt:g}°",
            *(_mark(f"{value:.1f}", round(abs(value), 1) < came) for value, came in ends),
            f"{case.nearer}/{case.mixed}",
        )
    return result


def _counts(reproduction: Reproduction) -> TextTable:
    result = make_table("Cells that agree", "", "cells", *NAMES)
    for table in reproduction.tables:
        counts = (len(table.cells), *map(table.agreeing, range(len(NAMES))))
        result.add_row(Text(table.title), *map(str, counts))
    return result


def _other_steps(reproduction: Reproduction) -> TextTable:
    """Tabulate the number of agreeing cells by step."""
    counts = {
        f"{1000 * each.integration.dt:g}": list(each.agreeing.values())
        for each in reproduction.by_step
    }
    most = max(map(sum, counts.values()))
    best = " and ".join(step for step, each in counts.items() if sum(each) == most)
    tables = [reproduction.table(key) for key in reproduction.by_step[0].agreeing]
    result = make_table(
        "The paper prints no step: cells that agree by explicit steps of",
        "step",
        *(f"{table.title.partition(':')[0]}, of {len(table.cells)}" for table in tables),
        "all",
        caption=f"The most that one step brings is {most}, at {best} ms. That the paper took "
        "about 5 ms is our inference.",
    )
    for step, each in counts.items():
        result.add_row(f"{step} ms", *map(str, each), str(sum(each)))
    return result


def _spreads(reproduction: Reproduction) -> Iterator[str]:
    for spread in reproduction.near_the_limit:
        yield (
            f"Table 2, converged against {spread.integrations[1]}: "
            f"at most {spread.position:.1f} mm and {spread.angle:.2f}° apart."
        )
    about = reproduction.about_coarse
    steps = [1000 * integration.dt for integration in about.integrations]
    yield (
        f"Table 2, explicit steps of {min(steps):g} to {max(steps):g} ms: "
        f"up to {about.position:.0f} mm and {about.angle:.1f}° apart; the sign function chatters."
    )
    last = reproduction.last_digits
    yield (
        f"Table 2, {runs.COARSE}, all axes turned by 4e-15 rad either way: up to "
        f"{last.position:.0f} mm and {last.angle:.1f}° apart; cos(90°) as computers round it is "
        "off by as little."
    )
