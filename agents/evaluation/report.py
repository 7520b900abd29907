"""A comparison's folder: tables, plots, films and the page that holds them all."""

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

from surface_gym.sharing import Workers

from ..flow.report import FlowReport
from ..tasks import kind_of, label_of
from .by_speed import speed_table
from .cell import Cell, play
from .columns import columns_of
from .contenders import FIXED, PLANNER, Contender, only
from .decisions import decision_table, write_decisions
from .page import write_page
from .plots import draw_errors, draw_sorting, draw_success, has_errors
from .showing import film_of
from .summary import summarise
from .table import (
    Summaries,
    Table,
    make_table,
    markdown,
    print_table,
    write_tables,
)
from .trajectories import draw_trajectories
from .trials import make_trial
from .work import compute_cells

Pictures = list[tuple[Path, str]]
COMPARED = ("exact", "camera", "lab")  # conditions that a run's policies are compared under


def write_report(
    contenders: Sequence[Contender],
    cells: Sequence[Cell],
    folder: Path,
    console: Console,
    advance: Callable[[str], None] = lambda _: None,
    flow: FlowReport | None = None,
) -> None:
    """Write everything of a comparison into a folder, and show its tables.

    Args:
        contenders: who was compared.
        cells: what came of it.
        folder: to write into.
        console: to show on.
        advance: called with what is drawn next.
        flow: the comparison on streams of parcels, which comes first; None: there is none.
    """
    summaries = summarise(cells)
    names = list(dict.fromkeys(contender.task for contender in contenders))
    tables = [make_table(make_trial(name), summaries) for name in names]
    pictures = {}
    for name in names:
        advance(f"drawing {name}")
        pictures[label_of(name)] = _draw(name, contenders, summaries, folder)
    shown = []
    for name, table in zip(names, tables, strict=True):
        shown.append(table)
        if kind_of(name) == "sort":
            shown.append(_by_speed(name, summaries))
    if names:
        trials = [make_trial(name) for name in names]
        write_tables(trials, shown, summaries, folder)
        shown.append(decision_table(trials, summaries))
        write_decisions(shown[-1], folder)
    for table in shown:
        print_table(table, console)
    columns = {label_of(name): columns_of(name) for name in names}
    if flow is not None:
        shown = [*flow.tables, *shown]
        pictures = {flow.tables[0].task: list(flow.pictures), **pictures}
    write_page(shown, pictures, columns, folder / "report.html")


def _by_speed(task: str, summaries: Summaries) -> Table:
    return speed_table(
        {
            who: summary
            for (name, who, condition), summary in summaries.items()
            if (name, condition) == (task, "exact") and who != PLANNER
        }
    )


def _draw(
    name: str, contenders: Sequence[Contender], summaries: Summaries, folder: Path
) -> Pictures:
    """A task's plots and film."""
    mine = [contender for contender in contenders if contender.task == name]
    pictures: Pictures = []
    label = label_of(name)
    success = folder / f"{label}-success.png"
    draw_success(name, summaries, success)
    pictures.append((success, "Success by condition, with 95 % intervals."))
    if kind_of(name) == "sort":
        times, paths = folder / f"{label}-times.png", folder / f"{label}-trajectories.png"
        draw_sorting(name, summaries, times)
        pictures.append(
            (times, "Time to sort by entry speed; no line where a parcel is not sorted.")
        )
        draw_trajectories(
            {each.name: play(each, each.seeds[0], "exact")[1] for each in rivals(mine)}, paths
        )
        pictures.append((paths, "Trajectories by entry speed; dotted where it is not sorted."))
    elif has_errors(name):
        errors = folder / f"{label}-errors.png"
        draw_errors(name, summaries, errors)
        pictures.append((errors, "Share of starts by the size of the error, exact sensors."))
    pictures.append(film_of(rivals(mine), folder))
    return pictures


def rivals(contenders: Sequence[Contender]) -> list[Contender]:
    """The fixed layout and, of one task's other contenders, the first that learned or the last."""
    fixed = [contender for contender in contenders if contender.name == FIXED]
    others = [contender for contender in contenders if contender.name not in (FIXED, PLANNER)]
    learned = [contender for contender in others if contender.name == "PPO"]
    return [*fixed, *(learned or others[-1:])][:2]


def compare_run(
    fixed: Contender, trained: Contender, workers: Workers, folder: Path, console: Console
) -> Summaries:
    """Compare a run's policies with the fixed layout, the same byte for byte each time: table.md,
    table.json, the trajectories of Sort, and a film.
    """
    both = [only(each, COMPARED) for each in (fixed, trained)]
    summaries = summarise(compute_cells(both, workers))
    trial = make_trial(trained.task)
    tables = [make_table(trial, summaries)]
    if trial.kind == "sort":
        tables.append(_by_speed(trained.task, summaries))
        draw_trajectories(
            {each.name: play(each, each.seeds[0], "exact")[1] for each in both},
            folder / "trajectories.png",
        )
    for table in tables:
        print_table(table, console)
    (folder / "table.md").write_text("\n".join(map(markdown, tables)))
    file, told = film_of(both, folder)
    console.print(f"{file.name}: {told}")
    return summaries
