"""The whole comparison with MuJoCo: its runs, tables, figures and data."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console, RenderableType
from rich.progress import track
from rich.table import Table
from rich.text import Text

from surface_gym import parallel
from surface_gym.cli import make_table
from surface_gym.paper.report import draw_base, draw_surface
from surface_gym.paper.runs import displacement
from surface_gym.validation import comparison, drawn
from surface_gym.validation.comparison import (
    EXPLICIT,
    IMPLICIT,
    INTEGRATIONS,
    MUJOCO,
    ComparedRun,
    Errors,
    MethodSpeed,
    Variant,
    compute_errors,
    displacements,
)
from surface_gym.validation.drawn import PoseShifts, TouchingRun, distances, root_mean_square

DRAWS = 20  # surfaces per unevenness
MEETINGS, CROWDS = 30, 24  # numbers of meetings of two parcels, and of crowds
MODELS = (MUJOCO, IMPLICIT, EXPLICIT)
ADAMS = {comparison.SlopeCase(10.0): "gamma10", comparison.PUSHED: "v09"}  # runs in the paper
ABSOLUTE = ("x\n[mm]", "y\n[mm]", "theta\n[deg]")
PERCENT = ("x\n[%]", "y\n[%]", "theta\n[%]")
LIMITS = (
    "What this cannot show: the base is flat and every support as high and as stiff as the next, "
    "which is Eq. (1)'s own hypothesis. So it checks stick and slip, contact made and lost, and "
    "the dynamics, not how a real parcel loads real supports: heights off by micrometres move "
    "the end pose by centimetres (--heights measures it)."
)


@dataclass(frozen=True, eq=False)
class Study:
    """Results of `python -m surface_gym.validation`."""

    sweep: tuple[ComparedRun, ...]  # one run per tilt
    pushed: ComparedRun  # v0 = 0.9 m/s on the level
    long: ComparedRun  # Figure 12c
    convergence: tuple[Variant, ...]
    speeds: tuple[MethodSpeed, ...]
    # The others are empty unless requested.
    spreads: tuple[PoseShifts, ...] = ()
    meetings: tuple[TouchingRun, ...] = ()
    crowds: tuple[TouchingRun, ...] = ()

    @property
    def table7(self) -> dict[str, Errors]:
        """Rows of Table 7 by title, with mean and standard deviation of errors over all tilts."""
        return {
            "Adams / MATLAB, printed": comparison.load_paper_errors().table7,
            **{
                f"{MUJOCO} / {each}": compute_errors(self.sweep, name).summary()
                for name, each in INTEGRATIONS.items()
            },
        }

    @property
    def sorts_from(self) -> dict[str, float | None]:
        """The lowest tilt [deg] for sorting the box, by the name of the model.

        The model sorts the box at this tilt and at all larger tilts of the sweep. If the model does
        not sort the box at the largest tilt, the value is None.
        """
        return {name: comparison.sorts_from(self.sweep, name) for name in MODELS}

    @property
    def printed_runs(self) -> list[ComparedRun]:
        """Runs of Figures 12a and 12b. If no run has the tilt of Figure 12a, only 12b is listed."""
        return [*(run for run in self.sweep if run.case in ADAMS), self.pushed]


def run_study(
    tilts: tuple[float, ...], with_unevenness: bool, with_touching: bool, workers: parallel.Workers,
    seed: int, console: Console,
) -> Study:  # fmt: skip
    """Run the comparison at `tilts` [deg] on `workers`. Then time all methods on one core.

    `with_unevenness` adds runs on random uneven surfaces. `with_touching` adds runs of random
    parcels that touch. `seed` seeds all random draws. The console shows the progress.
    """
    cases = [
        *map(comparison.SlopeCase, tilts), comparison.PUSHED, comparison.LONG,
    ]  # fmt: skip
    draws = drawn.draw_surfaces(DRAWS, seed) if with_unevenness else ()
    meetings = [drawn.Meeting(seed + k) for k in range(MEETINGS if with_touching else 0)]
    crowds = [drawn.Crowd(seed + k) for k in range(CROWDS if with_touching else 0)]
    parts: tuple[tuple[Any, Sequence[Any]], ...] = (
        (comparison.run_case, cases),
        (comparison.run_variant, comparison.JOBS),
        (drawn.run_draw, draws),
        (drawn.run_touching, meetings),
        (drawn.run_touching, crowds),
    )
    jobs = [
        partial(parallel.without_report, partial(function, each))
        for function, group in parts
        for each in group
    ]
    done = track(
        parallel.map_jobs(jobs, workers), "MuJoCo and the analytic model", total=len(jobs),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip
    found: dict[int, Any] = dict(done)
    results = iter(found[place] for place in range(len(jobs)))
    runs, variants, ends, *touching = (tuple(next(results) for _ in group) for _, group in parts)
    with console.status("timing, one core"):
        speeds = tuple(comparison.measure(method) for method in comparison.METHODS)
    return Study(
        runs[:-2], runs[-2], runs[-1], comparison.compare_variants(variants), speeds,
        drawn.compare_draws(draws, ends) if draws else (), *touching,
    )  # fmt: skip


def print_report(study: Study, console: Console) -> None:
    """Print every table of a study."""
    for part in _parts(study):
        console.print(part)
        console.print()


def _parts(study: Study) -> Iterator[RenderableType]:
    yield _table7(study)
    yield _single_runs(study)
    yield _beside_adams(study)
    printed = comparison.load_paper_errors().sorts_from
    found = ", ".join(f"{name} {_degrees(tilt)}" for name, tilt in study.sorts_from.items())
    yield (
        f"No rotor is left under the base after 1 s, so that the sort is complete, from: "
        f"Adams (printed) {_degrees(printed)}, {found}."
    )
    yield _convergence(study)
    yield _speeds(study)
    if study.spreads:
        yield _spreads(study)
    if study.meetings:
        yield _touching(
            f"Two parcels that push each other, {len(study.meetings)} drawn meetings of "
            f"{drawn.MEETING:g} s: distance from MuJoCo's end pose, the worse parcel",
            study.meetings, {"median": 50, "worst": 100}, is_worst_only=True,
        )  # fmt: skip
    if study.crowds:
        parcels = sum(len(run.harder) for run in study.crowds)
        yield _touching(
            f"Crowds held and let go, {len(study.crowds)} drawn, {parcels} parcels, "
            f"{drawn.CROWD:g} s: distance from MuJoCo's end pose, of each parcel",
            study.crowds, {"median": 50, "p90": 90, "worst": 100},
        )  # fmt: skip
    yield LIMITS


def _degrees(tilt: float | None) -> str:
    return "no tilt" if tilt is None else f"{tilt:g} deg"


def _numbers(values: Iterable[float], digits: int = 2) -> list[str]:
    return [f"{value:.{digits}f}" for value in values]


def _pairs(*names: str) -> list[str]:
    """Return two column headings for each name: a heading in mm and a heading in deg."""
    return [each for name in names for each in (f"{name}\n[mm]", "\n[deg]")]


def _table7(study: Study) -> Table:
    """Make Table 7: mean and standard deviation of the errors (Eq. (5)) over all tilts."""
    table = make_table(
        f"Table 7: errors over {len(study.sweep)} tilts, Eq. (5)", "", "", *PERCENT, *ABSOLUTE,
        labels=2,
    )  # fmt: skip
    for title, errors in study.table7.items():
        for k, row in enumerate(("mean", "SD")):
            values = _numbers((*errors.percent[k], *errors.absolute[k]))
            table.add_row("" if k else title, row, *values, end_section=k == 1)
    return table


def _single_runs(study: Study) -> Table:
    """Make a table of errors in the two runs for which the paper states errors."""
    table = make_table(
        "Single runs: errors without sign, as Section 6.2 prints them", "", *ABSOLUTE, *PERCENT
    )
    paper = comparison.load_paper_errors()
    for run in study.printed_runs:
        rows = {
            "Adams / MATLAB, printed": (
                paper.pushed if run.case == comparison.PUSHED else paper.tilted
            ),
            **{f"{MUJOCO} / {name}": compute_errors([run], name) for name in INTEGRATIONS},
        }
        for k, (title, error) in enumerate(rows.items()):
            values = _numbers(np.abs((*error.absolute[0], *error.percent[0])))
            table.add_row(f"{run.case.name}, {title}", *values, end_section=k == len(rows) - 1)
    return table


def _beside_adams(study: Study) -> Table:
    """Tabulate our displacements after 1 s, and bounds on the displacements that Adams computed."""
    table = make_table(
        "Displacements after 1 s, without sign; Adams's are what its printed errors in mm, deg "
        "and % leave open",
        *("", "", "x [m]", "y [m]", "theta [deg]"),
        labels=2,
    )
    for run in study.printed_runs:
        bounds = zip(*comparison.adams_displacement(ADAMS[run.case]), (3, 3, 2), strict=True)
        shown = [f"{low:.{digits}f} to {high:.{digits}f}" for low, high, digits in bounds]
        table.add_row(run.case.name, "Adams", *shown)
        for name, label in (
            (MUJOCO, MUJOCO), (IMPLICIT, "implicit, 1 ms"), (EXPLICIT, "explicit, 5 ms"),
        ):  # fmt: skip
            x, y, theta = np.abs(displacement(run.by[name]))
            table.add_row("", label, f"{x:.3f}", f"{y:.3f}", f"{theta:.2f}")
        table.add_section()
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
    for case, variants in groupby(study.convergence, attrgetter("case")):
        for k, each in enumerate(variants):
            name = "" if k else case.name
            table.add_row(name, each.change, *_numbers((*each.shift, *each.error)))
        table.add_section()
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
        *("case", "SD of", *_pairs("MuJoCo", "model", "apart")),
        labels=2,
    )
    for each in study.spreads:
        shifts = (each.mujoco, each.analytic, each.mujoco - each.analytic)
        values = [value for shift in shifts for value in root_mean_square(shift)]
        table.add_row(each.case.name, each.unevenness.name, *_numbers(values, 1))
    return table


def _touching(
    title: str, runs: Sequence[TouchingRun], percentiles: dict[str, int],
    is_worst_only: bool = False,
) -> Table:  # fmt: skip
    """Make a table of percentiles of the distances and angles between our and MuJoCo's end poses.

    Args:
        runs: runs of meetings (two parcels), or runs of crowds (more parcels).
        percentiles: column headings and their percentiles, e.g. {"median": 50}.
        is_worst_only: whether only the largest distance and the largest angle of a run count.
    """
    table = make_table(title, "", *_pairs(*percentiles))
    rows = {
        f"implicit, {1e3 * dt:g} ms": [run.analytic[k] for run in runs]
        for k, dt in enumerate(drawn.STEPS)
    }
    for name, shifts in {**rows, "MuJoCo, step / 2, sides x 2": [r.harder for r in runs]}.items():
        apart = [distances(each) for each in shifts]
        counted = [each.max(axis=0) for each in apart] if is_worst_only else np.concatenate(apart)
        table.add_row(
            name, *_numbers(np.percentile(counted, list(percentiles.values()), axis=0).ravel())
        )
    if tipped := sum(run.tips for run in runs):
        table.caption = Text(f"{tipped} of them tip in MuJoCo, the analytic parcels do not.")
    return table


def as_data(study: Study) -> dict[str, Any]:
    """Return a study as numbers, strings, lists and mappings.

    Displacements are in m and degrees, unless a name gives other units.
    """
    printed = comparison.load_paper_errors().sorts_from

    def summary(values: Any) -> dict[str, list[float]]:
        return {"mean": values[0].tolist(), "sd": values[1].tolist()}

    def touching(runs: Sequence[TouchingRun]) -> list[dict[str, Any]]:
        return [
            {
                "seed": run.seed,
                "tips_in_mujoco": run.tips,
                "step_s": list(drawn.STEPS),
                "error_mm_mm_deg": run.analytic.tolist(),
                "mujoco_shift_mm_mm_deg": run.harder.tolist(),
            }
            for run in runs
        ]

    return {
        "table7": [
            {
                "title": title,
                "percent": summary(errors.percent),
                "mm_mm_deg": summary(errors.absolute),
            }
            for title, errors in study.table7.items()
        ],
        "runs": [
            {
                "tilt_deg": run.case.tilt,
                "speed_m_per_s": run.case.speed,
                "duration_s": run.case.duration,
                **{name.lower(): list(displacement(run.by[name])) for name in MODELS},
            }
            for run in (*study.sweep, study.pushed, study.long)
        ],
        "sorts_from_deg": {"Adams, as printed": printed, **study.sorts_from},
        "adams_displacements": {
            run: {"low": low.tolist(), "high": high.tolist()}
            for run in ADAMS.values()
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
        "meetings": touching(study.meetings),
        "crowds": touching(study.crowds),
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


# The paper's colours: Adams red, MATLAB blue, errors green and magenta.
COLOURS = {MUJOCO: "tab:red", IMPLICIT: "tab:blue"}
ABSOLUTE_AXIS, PERCENT_AXIS = "tab:green", "m"


def draw_all(study: Study, folder: Path) -> list[Path]:
    """Write the figures as PNG, and return their paths."""
    drawn_as = {
        "figure14": draw_trajectories(study),
        "figure15": draw_displacements(study),
        "figure16": draw_errors(study),
    }
    paths = []
    for name, figure in drawn_as.items():
        paths.append(folder / f"{name}.png")
        figure.savefig(paths[-1], dpi=150)
    return paths


def draw_trajectories(study: Study) -> Figure:
    """Draw a box's paths in Figures 12 and 14. A panel's title states tilt, speed and duration."""
    runs = [*study.printed_runs, study.long]
    figure, panels = _row(len(runs), (5.5 * len(runs), 4.6))
    for axes, run in zip(panels, runs, strict=True):
        surface = run.case.surface
        draw_surface(axes, surface, rotor="darkorange", support="pink", width=2.5)
        for name, style in ((IMPLICIT, "-"), (MUJOCO, "--")):
            pose, colour = run.by[name].pose, COLOURS[name]
            axes.plot(*pose.T[:2], style, color=colour, label=name)
            for place, shade in ((0, "0.5"), (-1, colour)):
                draw_base(axes, comparison.PARCEL.base, pose[place], shade, width=1.0)
        case = run.case
        axes.set(
            xlim=(0.0, 1.2), ylim=(0.45, 1.35), aspect="equal", xlabel="x [m]", ylabel="y [m]",
            title=f"tilt {case.tilt:g} deg, v0 = {case.speed:g} m/s, t = {case.duration:g} s",
        )  # fmt: skip
        axes.legend(loc="upper right")
    return figure


def draw_displacements(study: Study) -> Figure:
    """Draw Figure 15, the displacements after 1 s as functions of the tilt."""
    figure, panels = _row(3, (12.0, 3.8))
    tilts = [run.case.tilt for run in study.sweep]
    styles: dict[str, tuple[str, int]] = {MUJOCO: ("o-", 4), IMPLICIT: ("x--", 5)}
    for name, (style, size) in styles.items():
        moved = displacements(study.sweep, name)
        for axes, values in zip(panels, moved.T, strict=True):
            axes.plot(tilts, values, style, color=COLOURS[name], markersize=size, label=name)
    for axes, label in zip(panels, ("x [m]", "y [m]", "theta [deg]"), strict=True):
        axes.set(xlabel="tilt [deg]", ylabel=label)
        axes.grid(alpha=0.3)
        axes.legend()
    return figure


def draw_errors(study: Study) -> Figure:
    """Draw Figure 16, the absolute and percentage errors of Eq. (5) as functions of the tilt."""
    figure, panels = _row(3, (13.0, 3.8))
    tilts = [run.case.tilt for run in study.sweep]
    error = compute_errors(study.sweep, IMPLICIT)
    for k, (axes, name) in enumerate(zip(panels, ("x", "y", "theta"), strict=True)):
        unit = "deg" if k == 2 else "mm"
        axes.plot(tilts, error.absolute[:, k], "o-", color=ABSOLUTE_AXIS, markersize=4)
        axes.set_xlabel("tilt [deg]")
        axes.set_ylabel(f"error in {name} [{unit}]", color=ABSOLUTE_AXIS)
        axes.grid(alpha=0.3)
        percent = axes.twinx()
        percent.plot(tilts, error.percent[:, k], "s--", color=PERCENT_AXIS, markersize=3)
        percent.set_ylabel(f"error in {name} [%]", color=PERCENT_AXIS)
    return figure


def _row(panels: int, size: tuple[float, float]) -> tuple[Figure, Sequence[Any]]:
    """Make a figure with a row of panels."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, list(figure.subplots(1, panels, squeeze=False)[0])
