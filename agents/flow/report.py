"""What the comparison on flows leaves in its folder."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from ..evaluation.table import Table, markdown, print_table
from .cases import CURVE
from .contenders import EVENT, LEARNED, RESERVATION, FlowContender
from .plots import draw_capacities, draw_rates
from .results import Results, results_of
from .showing import write_flow_comparison, write_flow_picture
from .study import FlowCell
from .tables import flow_numbers, flow_tables

PRINTED = 4  # tables that are shown on screen
NEAR = 0.95  # [-] of the reservation's capacity, at which the film shows all


@dataclass(frozen=True)
class FlowReport:
    """What a page shows."""

    tables: tuple[Table, ...]
    pictures: tuple[tuple[Path, str], ...]  # plots and films of the first, each with what it shows


def write_flow_report(
    contenders: Sequence[FlowContender],
    cells: Sequence[FlowCell],
    folder: Path,
    console: Console,
) -> FlowReport:
    """Write flow.md, flow.csv, plots, a picture and a film into a folder, and show tables.

    Args:
        contenders: who was compared.
        cells: what came of it.
        folder: to write into.
        console: to show on.
    """
    results = results_of(contenders, cells)
    tables = flow_tables(results)
    for table in tables[:PRINTED]:
        print_table(table, console)
    (folder / "flow.md").write_text("\n".join(map(markdown, tables)))
    numbers = flow_numbers(results)
    with (folder / "flow.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(numbers[0]))
        writer.writeheader()
        writer.writerows(numbers)
    return FlowReport(tuple(tables), tuple(_draw(contenders, results, folder)))


def _draw(
    contenders: Sequence[FlowContender], results: Results, folder: Path
) -> list[tuple[Path, str]]:
    rates, capacities = folder / "flow-rate.png", folder / "flow-capacity.png"
    draw_rates(results, rates)
    draw_capacities(results, capacities)
    rate = NEAR * results.rate(RESERVATION, CURVE)
    named = {contender.name: contender for contender in contenders}
    picture, film = folder / "flow.png", folder / "flow.mp4"
    write_flow_picture(named[RESERVATION], rate, picture)
    shown = [named[name] for name in (EVENT, RESERVATION, LEARNED) if name in named]
    write_flow_comparison(shown, CURVE, rate, film)
    told = f"{CURVE.label}, {rate:.0f} parcels an hour offered"
    return [
        (capacities, "Capacity by stream, exact sensors, with 95 % intervals."),
        (rates, f"Rate delivered right by the rate offered, {CURVE.label}, exact sensors."),
        (picture, f"The reservation at work: {told}."),
        (film, f"The same stream under {', '.join(each.name for each in shown)}: {told}."),
    ]
