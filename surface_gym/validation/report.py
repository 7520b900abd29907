"""The report of a study as tables for a terminal, and as plain data for JSON."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from surface_gym.paper.report import make_table
from surface_gym.validation.comparison import (
    PUSHED,
    Array,
    Errors,
    Run,
    Summary,
    adams_displacement,
    compute_errors,
    displacement,
    load_paper_errors,
)
from surface_gym.validation.study import Study
from surface_gym.validation.touching import STEPS, MeetingRun, apart
from surface_gym.validation.unevenness import root_mean_square

ABSOLUTE = ("x\n[mm]", "y\n[mm]", "theta\n[deg]")
PERCENT = ("x\n[%]", "y\n[%]", "theta\n[%]")
LIMITS = (
    "What this cannot show: the base is flat and every support as high and as stiff as the next, "
    "which is Eq. (1)'s own hypothesis. So it checks stick and slip, contact made and lost, and "
    "the dynamics, not how a real parcel loads real supports: heights off by micrometres move "
    "the end pose by centimetres (--heights measures it)."
)


def print_report(study: Study, console: Console) -> None:
    """Print every table of a study."""
    for part in _parts(study):
        console.print(part)
        console.print()


def _parts(study: Study) -> Iterator[RenderableType]:
    paper = load_paper_errors()
    yield _table7((paper.table7, *study.summaries), len(study.sweep))
    yield _single_runs(study)
    yield _beside_adams(study)
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
    table = make_table("MuJoCo against implicit at 1 ms: bounds", "", "at most", "measured", "")
    for target in study.targets:
        table.add_row(
            target.what,
            f"{target.bound:g} {target.unit}",
            f"{target.measured:.2f} {target.unit}",
            "reached" if target.is_reached else "missed",
        )
    return table


def _convergence(study: Study) -> Table:
    table = make_table(
        "MuJoCo's own convergence: end pose moved by a change; error against implicit",
        "case",
        "change",
        *("moved\nx [mm]", "\ny [mm]", "theta\n[deg]"),
        *("error\nx [mm]", "\ny [mm]", "theta\n[deg]"),
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
    table = make_table(
        "One core, at the largest step within 1 % of the own fine solution",
        *("method", "step [ms]", "error [%]", "simulated s per s"),
    )
    for speed in study.speeds:
        table.add_row(
            speed.method, f"{1e3 * speed.step:g}", f"{speed.error:.2f}", f"{speed.rate:,.0f}"
        )
    return table


def _spreads(study: Study) -> Table:
    table = make_table(
        "Uneven supports: distance from the even surface's end pose, root mean square of "
        f"{len(study.spreads[0].mujoco)} draws",
        "case",
        "SD of",
        *(name for each in ("MuJoCo", "model", "apart") for name in (f"{each}\n[mm]", "\n[deg]")),
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
    table = make_table(
        f"Two parcels that push each other, {len(runs)} drawn meetings of 0.5 s: distance from "
        "MuJoCo's end pose, the worse parcel",
        *("", "median\n[mm]", "\n[deg]", "worst\n[mm]", "\n[deg]"),
    )
    rows = [
        (f"implicit, {1e3 * dt:g} ms", [apart(run.analytic[k]) for run in runs])
        for k, dt in enumerate(STEPS)
    ]
    rows.append(("MuJoCo, step / 2, sides x 2", [apart(run.harder) for run in runs]))
    for name, differences in rows:
        table.add_row(
            name, *_numbers(np.median(differences, axis=0)), *_numbers(np.max(differences, axis=0))
        )
    tipped = sum(run.tips for run in runs)
    if tipped:
        table.caption = Text(f"{tipped} of them tip in MuJoCo, the analytic parcels do not.")
    return table


def _table7(summaries: Iterable[Summary], runs: int) -> Table:
    """Mean and standard deviation over the tilts."""
    table = make_table(
        f"Table 7: errors over {runs} tilts, Eq. (5)", "", "", *PERCENT, *ABSOLUTE, labels=2
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
    """Errors of the two runs for which the paper prints them."""
    table = make_table(
        "Single runs: errors without sign, as Section 6.2 prints them", "", *ABSOLUTE, *PERCENT
    )
    paper = load_paper_errors()
    for run in _printed_runs(study):
        name = run.case.name
        rows: list[tuple[str, Errors]] = [
            ("Adams / MATLAB, printed", paper.pushed if run.case == PUSHED else paper.tilted),
            ("MuJoCo / implicit", compute_errors([run], lambda run: run.implicit)),
            ("MuJoCo / explicit", compute_errors([run], lambda run: run.explicit)),
        ]
        for k, (title, error) in enumerate(rows):
            table.add_row(
                f"{name}, {title}",
                *_numbers(np.abs(error.absolute[0])),
                *_numbers(np.abs(error.percent[0])),
                end_section=k == 2,
            )
    return table


def _beside_adams(study: Study) -> Table:
    """Displacements after 1 s: Adams's, as far as they are printed, and ours."""
    table = make_table(
        "Displacements after 1 s, without sign; Adams's are what its printed errors in mm, deg "
        "and % leave open",
        "",
        "",
        "x [m]",
        "y [m]",
        "theta [deg]",
        labels=2,
    )
    for run in _printed_runs(study):
        low_high = adams_displacement("v09" if run.case == PUSHED else "gamma10")
        shown = [
            f"{low:.{digits}f} to {high:.{digits}f}"
            for low, high, digits in zip(*low_high, (3, 3, 2), strict=True)
        ]
        table.add_row(run.case.name, "Adams", *shown)
        for name, trajectory in (
            ("MuJoCo", run.mujoco),
            ("implicit, 1 ms", run.implicit),
            ("explicit, 5 ms", run.explicit),
        ):
            x, y, theta = np.abs(displacement(trajectory))
            table.add_row("", name, f"{x:.3f}", f"{y:.3f}", f"{theta:.2f}")
        table.add_section()
    return table


def _printed_runs(study: Study) -> list[Run]:
    """Figure 12a, if the sweep holds it, and 12b."""
    return [*(run for run in study.sweep if run.case.tilt == 10.0), study.pushed]


def _numbers(values: Iterable[float], digits: int = 2) -> list[str]:
    """Write numbers as text."""
    return [f"{value:.{digits}f}" for value in values]


def as_data(study: Study) -> dict[str, Any]:
    """List a study as numbers, strings, lists and mappings; displacements in m and degrees."""
    paper = load_paper_errors()
    return {
        "table7": [_summary_data(summary) for summary in (paper.table7, *study.summaries)],
        "runs": [
            {
                "tilt_deg": run.case.tilt,
                "speed_m_per_s": run.case.speed,
                "duration_s": run.case.duration,
                "mujoco": displacement(run.mujoco).tolist(),
                "implicit": displacement(run.implicit).tolist(),
                "explicit": displacement(run.explicit).tolist(),
            }
            for run in (*study.sweep, study.pushed, study.long)
        ],
        "targets": [{**asdict(target), "reached": target.is_reached} for target in study.targets],
        "sorts_from_deg": {"Adams, as printed": paper.sorts_from, **study.sorts_from},
        "adams_displacements": {
            run: dict(
                zip(
                    ("low", "high"),
                    (bound.tolist() for bound in adams_displacement(run)),
                    strict=True,
                )
            )
            for run in ("gamma10", "v09")
        },
        "convergence": [
            {
                "case": variant.case.name,
                "change": variant.change,
                "shift_mm_mm_deg": variant.shift.tolist(),
                "error_mm_mm_deg": variant.error.tolist(),
            }
            for variant in study.convergence
        ],
        "meetings": [
            {
                "seed": run.meeting.seed,
                "tips_in_mujoco": run.tips,
                "step_s": list(STEPS),
                "error_mm_mm_deg": run.analytic.tolist(),
                "mujoco_shift_mm_mm_deg": run.harder.tolist(),
            }
            for run in study.meetings
        ],
        "speed": [asdict(speed) for speed in study.speeds],
        "uneven_supports": [
            {
                "case": spread.case.name,
                "height_m": spread.unevenness.height,
                "log_stiffness": spread.unevenness.stiffness,
                "mujoco_mm_mm_deg": spread.mujoco.tolist(),
                "analytic_mm_mm_deg": spread.analytic.tolist(),
            }
            for spread in study.spreads
        ],
        "limits": LIMITS,
    }


def _summary_data(summary: Summary) -> dict[str, Any]:
    def rows(values: Array) -> dict[str, list[float]]:
        return {"mean": values[0].tolist(), "sd": values[1].tolist()}

    return {
        "title": summary.title,
        "percent": rows(summary.percent),
        "mm_mm_deg": rows(summary.absolute),
    }
