"""A study as tables for a terminal."""

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console, RenderableType
from rich.table import Table

from surface_gym.validation import report_errors
from surface_gym.validation.comparison import paper_errors
from surface_gym.validation.framing import new_table, numbers
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
    yield report_errors.table7((paper.table7, *study.summaries), len(study.sweep))
    yield report_errors.single_runs(study)
    yield report_errors.beside_adams(study)
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


def _targets(study: Study) -> Table:
    table = new_table(
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
    table = new_table(
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
            *numbers(variant.shift),
            *numbers(variant.error),
        )
        last = variant.case
    return table


def _speeds(study: Study) -> Table:
    table = new_table(
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
    table = new_table(
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
            *numbers(root_mean_square(spread.mujoco), 1),
            *numbers(root_mean_square(spread.analytic), 1),
            *numbers(root_mean_square(spread.mujoco - spread.analytic), 1),
        )
    return table


def _meetings(runs: Sequence[MeetingRun]) -> Table:
    table = new_table(
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
            *numbers(np.median(differences, axis=0)),
            *numbers(np.max(differences, axis=0)),
        )
    tipped = sum(run.tips for run in runs)
    if tipped:
        table.caption = f"{tipped} of them tip in MuJoCo, which the analytic parcels do not."
    return table
