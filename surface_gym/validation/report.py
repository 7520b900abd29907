"""A study as tables for a terminal."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from rich import box
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.table import Table

from surface_gym.validation.comparison import Errors, Summary, errors, paper_errors
from surface_gym.validation.study import Study
from surface_gym.validation.touching import STEPS, MeetingRun, apart
from surface_gym.validation.unevenness import root_mean_square

LIMITS = (
    "What this cannot show: the base is flat and every support as high and as stiff as the next, "
    "which is Eq. (1)'s own hypothesis. So it checks stick and slip, contact made and lost, and "
    "the dynamics, not how a real parcel loads real supports: heights off by micrometres move "
    "the end pose by centimetres (--heights measures it)."
)


def show(study: Study, console: Console) -> None:
    """Print a study."""
    for part in _parts(study):
        console.print(part)
        console.print()


def _parts(study: Study) -> Iterator[RenderableType]:
    paper = paper_errors()
    yield _table7((paper.table7, *study.summaries), len(study.sweep))
    yield _single_runs(study)
    yield _targets(study)
    found = ", ".join(f"{name} {_degrees(tilt)}" for name, tilt in study.sorts_from.items())
    yield (
        f"No rotor is left under the base after 1 s, so that the sort is complete, from: "
        f"Adams (printed) {_degrees(paper.sorts_from)}, {found}."
    )
    yield _convergence(study)
    yield _speeds(study)
    if study.spreads:
        yield _spreads(study)
    if study.meetings:
        yield _meetings(study.meetings)
    yield LIMITS


def _degrees(tilt: float | None) -> str:
    return "no tilt" if tilt is None else f"{tilt:g} deg"


def _new_table(title: str, *columns: str, labels: int = 1) -> Table:
    """A table whose first columns are labels, the others numbers."""
    table = Table(
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for k, column in enumerate(columns):
        table.add_column(escape(column), justify="left" if k < labels else "right", no_wrap=True)
    return table


def _numbers(values: Iterable[float], digits: int = 2) -> list[str]:
    return [f"{value:.{digits}f}" for value in values]


def _table7(summaries: Iterable[Summary], runs: int) -> Table:
    table = _new_table(
        f"Table 7: errors over {runs} tilts, Eq. (5)",
        "",
        "",
        "x\n[%]",
        "y\n[%]",
        "theta\n[%]",
        "x\n[mm]",
        "y\n[mm]",
        "theta\n[deg]",
        labels=2,
    )
    for summary in summaries:
        for k, row in enumerate(("mean", "SD")):
            table.add_row(
                "" if k else summary.title,
                row,
                *_numbers(summary.percent[k]),
                *_numbers(summary.absolute[k]),
                end_section=k == 1,
            )
    return table


def _single_runs(study: Study) -> Table:
    table = _new_table(
        "Single runs: errors without sign, as Section 6.2 prints them",
        "",
        "x\n[mm]",
        "y\n[mm]",
        "theta\n[deg]",
        "x\n[%]",
        "y\n[%]",
        "theta\n[%]",
    )
    paper = paper_errors()
    runs = [("v0 = 0.9 m/s", study.pushed, paper.pushed)]
    runs[:0] = [("10 deg", run, paper.tilted) for run in study.sweep if run.case.tilt == 10.0]
    for name, run, printed in runs:
        rows: list[tuple[str, Errors]] = [
            ("Adams / MATLAB, printed", printed),
            ("MuJoCo / implicit", errors([run], lambda run: run.implicit)),
            ("MuJoCo / explicit", errors([run], lambda run: run.explicit)),
        ]
        for k, (who, error) in enumerate(rows):
            table.add_row(
                f"{name}, {who}",
                *_numbers(np.abs(error.absolute[0])),
                *_numbers(np.abs(error.percent[0])),
                end_section=k == 2,
            )
    return table


def _targets(study: Study) -> Table:
    table = _new_table(
        "MuJoCo against implicit at 1 ms: what was asked for", "", "at most", "measured", ""
    )
    for target in study.targets:
        table.add_row(
            target.what,
            f"{target.bound:g} {target.unit}",
            f"{target.measured:.2f} {target.unit}",
            "reached" if target.is_reached else "missed",
        )
    return table


def _convergence(study: Study) -> Table:
    table = _new_table(
        "MuJoCo's own convergence: end pose moved by a change; error against implicit",
        "case",
        "change",
        "moved\nx [mm]",
        "\ny [mm]",
        "theta\n[deg]",
        "error\nx [mm]",
        "\ny [mm]",
        "theta\n[deg]",
        labels=2,
    )
    last = None
    for variant in study.convergence:
        if last is not None and variant.case != last:
            table.add_section()
        table.add_row(
            variant.case.name if variant.case != last else "",
            variant.change,
            *_numbers(variant.shift),
            *_numbers(variant.error),
        )
        last = variant.case
    return table


def _speeds(study: Study) -> Table:
    table = _new_table(
        "One core, at the largest step within 1 % of the own fine solution",
        "method",
        "step [ms]",
        "error [%]",
        "simulated s per s",
    )
    for speed in study.speeds:
        table.add_row(
            speed.method, f"{1e3 * speed.step:g}", f"{speed.error:.2f}", f"{speed.rate:,.0f}"
        )
    return table


def _spreads(study: Study) -> Table:
    table = _new_table(
        "Uneven supports: distance from the even surface's end pose, root mean square of "
        f"{len(study.spreads[0].mujoco)} draws",
        "case",
        "SD of",
        "MuJoCo\n[mm]",
        "\n[deg]",
        "model\n[mm]",
        "\n[deg]",
        "apart\n[mm]",
        "\n[deg]",
        labels=2,
    )
    for spread in study.spreads:
        table.add_row(
            spread.case.name,
            spread.unevenness.name,
            *_numbers(root_mean_square(spread.mujoco), 1),
            *_numbers(root_mean_square(spread.analytic), 1),
            *_numbers(root_mean_square(spread.mujoco - spread.analytic), 1),
        )
    return table


def _meetings(runs: Sequence[MeetingRun]) -> Table:
    table = _new_table(
        f"Two parcels that push each other, {len(runs)} drawn meetings of 0.5 s: distance from "
        "MuJoCo's end pose, the worse parcel",
        "",
        "median\n[mm]",
        "\n[deg]",
        "worst\n[mm]",
        "\n[deg]",
    )
    rows = [
        (f"implicit, {1e3 * dt:g} ms", [apart(run.analytic[k]) for run in runs])
        for k, dt in enumerate(STEPS)
    ]
    rows.append(("MuJoCo, step / 2, sides x 2", [apart(run.harder) for run in runs]))
    for name, differences in rows:
        table.add_row(
            name,
            *_numbers(np.median(differences, axis=0)),
            *_numbers(np.max(differences, axis=0)),
        )
    tipped = sum(run.tips for run in runs)
    if tipped:
        table.caption = f"{tipped} of them tip in MuJoCo, which the analytic parcels do not."
    return table
