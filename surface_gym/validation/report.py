"""Tables, figures and data of the comparison with MuJoCo."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from surface_gym.cli import make_table
from surface_gym.paper.report import draw_base, draw_surface
from surface_gym.physics.types import Array
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation import comparison
from surface_gym.validation.crowds import DURATION, CrowdRun
from surface_gym.validation.drawn import STEPS, MeetingRun, PoseShifts, apart, root_mean_square
from surface_gym.validation.study import Study

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
    paper = comparison.load_paper_errors()
    yield _table7((paper.table7, *study.summaries), len(study.sweep))
    yield _single_runs(study)
    yield _beside_adams(study)
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
    if study.crowds:
        yield _crowds(study.crowds)
    yield LIMITS


def _degrees(tilt: float | None) -> str:
    return "no tilt" if tilt is None else f"{tilt:g} deg"


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


def _crowds(runs: Sequence[CrowdRun]) -> Table:
    """Tabulate the distances of all crowds' end poses from MuJoCo's."""
    parcels = sum(len(run.harder) for run in runs)
    table = make_table(
        f"Crowds held and let go, {len(runs)} drawn, {parcels} parcels, {DURATION:g} s: distance "
        "from MuJoCo's end pose, of each parcel",
        *(
            "",
            *(name for each in ("median", "p90", "worst") for name in (f"{each}\n[mm]", "\n[deg]")),
        ),
    )
    rows = [
        (f"implicit, {1e3 * dt:g} ms", np.concatenate([run.analytic[k] for run in runs]))
        for k, dt in enumerate(STEPS)
    ]
    rows.append(("MuJoCo, step / 2, sides x 2", np.concatenate([run.harder for run in runs])))
    for name, shifts in rows:
        apart = np.column_stack([np.hypot(shifts[:, 0], shifts[:, 1]), np.abs(shifts[:, 2])])
        table.add_row(name, *_numbers(np.percentile(apart, (50, 90, 100), axis=0).ravel()))
    tipped = sum(run.tips for run in runs)
    if tipped:
        table.caption = Text(f"{tipped} of them tip in MuJoCo, the analytic parcels do not.")
    return table


def _table7(summaries: Iterable[comparison.ErrorSummary], runs: int) -> Table:
    """Tabulate mean and standard deviation over the tilts."""
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
    """Tabulate the errors of the two runs with errors stated in the paper."""
    table = make_table(
        "Single runs: errors without sign, as Section 6.2 prints them", "", *ABSOLUTE, *PERCENT
    )
    paper = comparison.load_paper_errors()
    for run in _printed_runs(study):
        name = run.case.name
        rows: list[tuple[str, comparison.DisplacementErrors]] = [
            (
                "Adams / MATLAB, printed",
                paper.pushed if run.case == comparison.PUSHED else paper.tilted,
            ),
            ("MuJoCo / implicit", comparison.compute_errors([run], lambda run: run.implicit)),
            ("MuJoCo / explicit", comparison.compute_errors([run], lambda run: run.explicit)),
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
    """Tabulate displacements after 1 s: Adams's bounds and ours."""
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
        low_high = comparison.adams_displacement(
            "v09" if run.case == comparison.PUSHED else "gamma10"
        )
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
            x, y, theta = np.abs(comparison.displacement(trajectory))
            table.add_row("", name, f"{x:.3f}", f"{y:.3f}", f"{theta:.2f}")
        table.add_section()
    return table


def _printed_runs(study: Study) -> list[comparison.ComparedRun]:
    """Select the runs of Figure 12a (if in the sweep) and 12b."""
    return [*(run for run in study.sweep if run.case.tilt == 10.0), study.pushed]


def _numbers(values: Iterable[float], digits: int = 2) -> list[str]:
    """Write numbers as text."""
    return [f"{value:.{digits}f}" for value in values]


def as_data(study: Study) -> dict[str, Any]:
    """Return a study as numbers, strings, lists and mappings; displacements in m and degrees."""
    paper = comparison.load_paper_errors()
    return {
        "table7": [_summary_data(summary) for summary in (paper.table7, *study.summaries)],
        "runs": [
            {
                "tilt_deg": run.case.tilt,
                "speed_m_per_s": run.case.speed,
                "duration_s": run.case.duration,
                "mujoco": comparison.displacement(run.mujoco).tolist(),
                "implicit": comparison.displacement(run.implicit).tolist(),
                "explicit": comparison.displacement(run.explicit).tolist(),
            }
            for run in (*study.sweep, study.pushed, study.long)
        ],
        "sorts_from_deg": {"Adams, as printed": paper.sorts_from, **study.sorts_from},
        "adams_displacements": {
            run: {"low": low.tolist(), "high": high.tolist()}
            for run in ("gamma10", "v09")
            for low, high in [comparison.adams_displacement(run)]
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
        "crowds": [
            {
                "seed": run.crowd.seed,
                "tips_in_mujoco": run.tips,
                "step_s": list(STEPS),
                "error_mm_mm_deg": run.analytic.tolist(),
                "mujoco_shift_mm_mm_deg": run.harder.tolist(),
            }
            for run in study.crowds
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


def _summary_data(summary: comparison.ErrorSummary) -> dict[str, Any]:
    def rows(values: Array) -> dict[str, list[float]]:
        return {"mean": values[0].tolist(), "sd": values[1].tolist()}

    return {
        "title": summary.title,
        "percent": rows(summary.percent),
        "mm_mm_deg": rows(summary.absolute),
    }


MUJOCO = "tab:red"  # the paper's colours: Adams red, MATLAB blue, errors green and magenta
MODEL = "tab:blue"
ABSOLUTE_AXIS = "tab:green"
PERCENT_AXIS = "m"
AXES = ("x [m]", "y [m]", "theta [deg]")


def draw_all(study: Study, folder: Path) -> list[Path]:
    """Write the figures as PNG, and return their paths."""
    drawn = {
        "figure12": trajectories(study),
        "figure13": final_positions(study),
        "figure14": compared_trajectories(study),
        "figure15": final_displacements(study),
        "figure16": displacement_errors(study),
    }
    if study.spreads:
        drawn["uneven_supports"] = end_places(study.spreads)
    paths = []
    for name, figure in drawn.items():
        paths.append(folder / f"{name}.png")
        figure.savefig(paths[-1], dpi=150)
    return paths


def trajectories(study: Study) -> Figure:
    """Draw Figure 12: plan views of MuJoCo's runs at 10 deg, pushed, and at 5 deg for 1.8 s."""
    runs = [*_printed_runs(study), study.long]
    figure = Figure(figsize=(4.6 * len(runs), 4.0), layout="constrained")
    for axes, run in zip(_row(figure, len(runs)), runs, strict=True):
        _draw_surface(axes, run.case.surface)
        _draw_path(axes, run.mujoco, MUJOCO, "MuJoCo")
        axes.set_title(
            f"tilt {run.case.tilt:g} deg, v0 = {run.case.speed:g} m/s, t = {run.case.duration:g} s"
        )
    return figure


def final_positions(study: Study) -> Figure:
    """Draw Figure 13: end positions of the runs that complete the sort."""
    figure = Figure(figsize=(10.0, 4.3), layout="constrained")
    sides: tuple[tuple[str, str, comparison.Model], ...] = (
        ("MuJoCo", MUJOCO, lambda run: run.mujoco),
        ("implicit", MODEL, lambda run: run.implicit),
    )
    for axes, (name, colour, side) in zip(_row(figure, 2), sides, strict=True):
        done = [run for run in study.sweep if comparison.is_sorted(run.case, side(run))]
        _draw_surface(axes, study.pushed.case.surface)
        for run in done:
            _draw_box(axes, side(run).pose[-1], colour)
            axes.plot(*side(run).pose[-1, :2], ".", color=colour)
        tilts = f", {done[0].case.tilt:g} to {done[-1].case.tilt:g} deg" if done else ""
        axes.set_title(f"{name}: {len(done)} sorted of {len(study.sweep)}{tilts}")
    return figure


def compared_trajectories(study: Study) -> Figure:
    """Draw Figure 14: the runs of Figure 12a and 12b, as paths by MuJoCo and the analytic model."""
    runs = _printed_runs(study)
    figure = Figure(figsize=(5.5 * len(runs), 4.6), layout="constrained")
    for axes, run in zip(_row(figure, len(runs)), runs, strict=True):
        _draw_surface(axes, run.case.surface)
        _draw_path(axes, run.implicit, MODEL, "implicit")
        _draw_path(axes, run.mujoco, MUJOCO, "MuJoCo", "--")
        axes.set_title(f"tilt {run.case.tilt:g} deg, v0 = {run.case.speed:g} m/s")
        axes.legend(loc="upper right")
    return figure


def final_displacements(study: Study) -> Figure:
    """Draw Figure 15: displacements after 1 s over the tilt."""
    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    tilts = [run.case.tilt for run in study.sweep]
    mujoco = np.array([comparison.displacement(run.mujoco) for run in study.sweep])
    implicit = np.array([comparison.displacement(run.implicit) for run in study.sweep])
    for k, axes in enumerate(_row(figure, 3)):
        axes.plot(tilts, mujoco[:, k], "o-", color=MUJOCO, markersize=4, label="MuJoCo")
        axes.plot(tilts, implicit[:, k], "x--", color=MODEL, markersize=5, label="implicit")
        axes.set(xlabel="tilt [deg]", ylabel=AXES[k])
        axes.grid(alpha=0.3)
        axes.legend()
    return figure


def displacement_errors(study: Study) -> Figure:
    """Draw Figure 16: absolute and percentage errors over the tilt, Eq. (5)."""
    figure = Figure(figsize=(13.0, 3.8), layout="constrained")
    tilts = [run.case.tilt for run in study.sweep]
    error = comparison.compute_errors(study.sweep, lambda run: run.implicit)
    names = ("x", "y", "theta")
    for k, axes in enumerate(_row(figure, 3)):
        unit = "deg" if k == 2 else "mm"
        axes.plot(tilts, error.absolute[:, k], "o-", color=ABSOLUTE_AXIS, markersize=4)
        axes.set_xlabel("tilt [deg]")
        axes.set_ylabel(f"error in {names[k]} [{unit}]", color=ABSOLUTE_AXIS)
        axes.grid(alpha=0.3)
        percent = axes.twinx()
        percent.plot(tilts, error.percent[:, k], "s--", color=PERCENT_AXIS, markersize=3)
        percent.set_ylabel(f"error in {names[k]} [%]", color=PERCENT_AXIS)
    return figure


def end_places(spreads: Sequence[PoseShifts]) -> Figure:
    """Draw end positions on uneven supports; lines join runs with the same supports."""
    rows = math.ceil(len(spreads) / 3)
    figure = Figure(figsize=(12.0, 3.6 * rows), layout="constrained")
    grid = figure.subplots(rows, 3, sharex=True, sharey=True)
    for axes, spread in zip(grid.flat, spreads, strict=True):
        pairs = np.stack([spread.mujoco[:, :2], spread.analytic[:, :2]], axis=1)
        axes.add_collection(LineCollection(list(pairs), colors="0.7", linewidths=0.8))
        axes.plot(*spread.mujoco.T[:2], "o", color=MUJOCO, markersize=4, label="MuJoCo")
        axes.plot(*spread.analytic.T[:2], "x", color=MODEL, label="model")
        axes.plot(0.0, 0.0, "k+", markersize=10, label="even")
        axes.set(
            title=f"{spread.case.name}, {spread.unevenness.name}",
            xlabel="x [mm]",
            ylabel="y [mm]",
            aspect="equal",
        )
        axes.grid(alpha=0.3)
    grid.flat[0].legend(fontsize="small")
    return figure


def _row(figure: Figure, panels: int) -> Sequence[Any]:
    return list(figure.subplots(1, panels, squeeze=False)[0])


def _draw_surface(axes: Axes, surface: Surface) -> None:
    draw_surface(axes, surface, rotor="darkorange", support="pink", width=2.5)
    axes.set(xlim=(0.0, 1.2), ylim=(0.45, 1.35), aspect="equal", xlabel="x [m]", ylabel="y [m]")


def _draw_box(axes: Axes, pose: Sequence[float], colour: str) -> None:
    draw_base(axes, comparison.PARCEL.base, pose, colour, width=1.0)


def _draw_path(
    axes: Axes, trajectory: Trajectory, colour: str, label: str, style: str = "-"
) -> None:
    """Draw the path of the box's centre, and the box at its ends."""
    axes.plot(*trajectory.pose.T[:2], style, color=colour, label=label)
    _draw_box(axes, trajectory.pose[0], "0.5")
    _draw_box(axes, trajectory.pose[-1], colour)
