"""Report of a reproduction of the paper: tables for the terminal, and figures."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table
from rich.text import Text

from surface_gym import layouts, trajectory_plot
from surface_gym.cli import make_table
from surface_gym.paper import reproduction as paper, runs
from surface_gym.paper.runs import OFFSETS, TURNS, PaperTable
from surface_gym.parcel import Base
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory

COARSE_NAME = paper.NAMES[0]
OURS = paper.NAMES[:2]  # columns of a table
BY_SPEED = ("table3", "table4", "stopping")  # printed with both boxes side by side
SUFFIXES = (".png", ".pdf")
ROTOR, SUPPORT, BOX = "red", "tab:blue", "limegreen"  # colours
SLOWING_TIME = 1.5  # [s] duration in Figure 10
ALIGNING_COLUMNS = 6  # columns of the alignment figure
ALIGNING_SPEED = 2.5  # [m/s]
SHOWN_TURN = 10.0  # [deg] initial turn of the box drawn from above
COLOURS = ("#1b6ca8", "#e07a1f", "#7a3b8f")


def print_report(found: paper.Reproduction, console: Console) -> None:
    """Print tables, rates, counts of cells that agree with the paper, and effects of time steps."""
    console.print(
        f"{runs.load_data()['source']}\n\n"
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
        *(_by_speed(table) if table.key in BY_SPEED else _by_cell(table) for table in found.tables),
        _rates(found), _self_stops(found.self_stopping),
        _alignment(found.alignment), _counts(found), _other_steps(found),
    ):  # fmt: skip
        console.print(part)
        console.print()
    for line in _spreads(found):
        console.print(line, highlight=False)


def _caption(table: PaperTable) -> str:
    """Return the text above a table's cells.

    The text states the rule of agreement, the number of agreeing cells, and the share of steps in
    which Eq. (1) has no solution.
    """
    count = len(table.cells)
    shares = [table.tipping(k) for k in range(len(paper.NAMES))]
    boxes = []
    for size in runs.SIZES:
        ranges = [
            f"{name} {_percent(*share[size])}"
            for name, share in zip(paper.NAMES, shares, strict=True)
            if size in share
        ]
        boxes += [f"\n  {size}-box: {', '.join(ranges)}"] if ranges else []
    return (
        f"{table.rule}\nagree: {table.agreeing(0)} of {count} at {COARSE_NAME}, "
        f"{table.agreeing(1)} of {count} converged\n"
        f"steps in which Eq. (1) has no solution:{''.join(boxes)}"
    )


def _percent(least: float, largest: float) -> str:
    """Return the range of shares from `least` to `largest` [-] as a text, e.g. "20 to 30 %"."""
    low, high = f"{100.0 * least:.0f}", f"{100.0 * largest:.0f}"
    return f"{low} %" if low == high else f"{low} to {high} %"


def _text(value: runs.Value, decimals: int) -> str:
    """Return a value as text with a number of decimals. For None, return "/"."""
    if value is None:
        return "/"
    return str(value) if isinstance(value, runs.SlowingLayout) else f"{value:.{decimals}f}"


def _mark(text: str, agrees: bool) -> Text:
    """Add a star to the text of a value if `agrees` is false."""
    return Text(text + " ") if agrees else Text(text + "*", style="bold yellow")


def _ours(cell: runs.TableCell) -> list[Text]:
    """Return our values of a cell as texts. If the paper prints decimals, we print one more."""
    decimals = cell.decimals + 1 if cell.decimals else 0
    ours = enumerate(cell.ours[: len(OURS)])
    return [_mark(_text(each.value, decimals), cell.agrees(k)) for k, each in ours]


def _by_cell(table: PaperTable) -> Table:
    """Make a terminal table in which each cell of the paper's table is a row."""
    result = make_table(table.title, "", "", "paper", *OURS, caption=_caption(table), labels=2)
    row = ""
    for cell in table.cells:
        if row and cell.row != row:
            result.add_section()
        label = Text("" if cell.row == row else cell.row)
        paper_value = _text(cell.paper, cell.decimals)
        result.add_row(label, Text(cell.column), paper_value, *_ours(cell))
        row = cell.row
    return result


def _by_speed(table: PaperTable) -> Table:
    """Make a terminal table with one row per speed, and the two boxes side by side."""
    names = ("paper", *OURS)
    columns = (f"{size}-box\n{name}" for size in runs.SIZES for name in names)
    result = make_table(table.title, "\nv0", *columns, caption=_caption(table))
    rows: dict[str, list[str | Text]] = {}
    for cell in table.cells:
        rows.setdefault(cell.row, []).extend([_text(cell.paper, cell.decimals), *_ours(cell)])
    for row, entries in rows.items():
        result.add_row(row, *entries)
    return result


def _rates(found: paper.Reproduction) -> Table:
    """Tabulate the sorting rates of Figure 8; the paper prints only a band of rates."""
    low, high = runs.load_targets().medium_rates
    by_input = {"v0": found.sorted_by_speed, "tilt": found.sorted_by_tilt}
    counts = "\n".join(
        f"  {size}-box by {name}: {_count_medium([case for case in cases if case.size == size])}"
        for name, cases in by_input.items()
        for size in runs.SIZES
    )
    result = make_table(
        "Figure 8: sorting rate [pcs/h], by v0 on the level or by tilt from standstill",
        "\nv0 or tilt",
        *(f"{size}-box\n{name}" for size in runs.SIZES for name in OURS),
        caption=f"* outside the paper's band for torsional discs, {low:g} to {high:g} pcs/h\n"
        f"in the band at {COARSE_NAME}, and converged:\n{counts}",
    )
    for cases in by_input.values():
        half = len(cases) // len(runs.SIZES)
        for small, big in zip(cases[:half], cases[half:], strict=True):
            row = f"{small.speed:.1f} m/s" if small.speed > 0.0 else f"{small.tilt:g}°"
            rates = (done.rate for case in (small, big) for done in case.ours[: len(OURS)])
            texts = (
                Text("/ ") if rate is None else _mark(f"{rate:.0f}", low <= rate <= high)
                for rate in rates
            )
            result.add_row(row, *texts)
        result.add_section()
    return result


def _count_medium(cases: Sequence[runs.SortingCase]) -> str:
    """Return how many sorting rates lie in the paper's band, e.g. "3 of 9, 4 of 9".

    The first count is for coarse integration, the second for converged integration.
    """
    counts = []
    low, high = runs.load_targets().medium_rates
    for k in range(len(OURS)):
        done = [rate for case in cases if (rate := case.ours[k].rate) is not None]
        counts.append(f"{sum(low <= rate <= high for rate in done)} of {len(done)}")
    return ", ".join(counts)


def _self_stops(cases: Sequence[runs.SelfStop]) -> Table:
    """Tabulate the steepest tilt at which a pushed box stops by itself."""
    result = make_table(
        "Section 6.2: steepest tilt at which the S-box stops by itself",
        "axes", "method", "paper", "expected", "ours", labels=2,
        caption="expected: tan = sqrt(2) mu_min where all axes stand at +45°, tan = (mu_max + "
        "mu_min) / sqrt(2) in alternate rows. The paper's sin = mu_min / sqrt(2) leaves out the "
        "part along x of the friction along the axes.",
    )  # fmt: skip
    for case in cases:
        tilts = (case.study, case.expected, case.measured)
        degrees = ("" if tilt is None else f"{tilt:.2f}°" for tilt in tilts)
        result.add_row(case.layout, str(case.integration), *degrees)
    return result


def _alignment(cases: Sequence[runs.Alignment]) -> Table:
    """Tabulate the end poses of boxes that enter a zone with an offset or a turn."""
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
    for case in cases:
        zone = case.zone
        towards = "inwards" if zone.towards == runs.INWARDS else "outwards"
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


def _counts(found: paper.Reproduction) -> Table:
    result = make_table("Cells that agree", "", "cells", *paper.NAMES)
    for table in found.tables:
        counts = (len(table.cells), *map(table.agreeing, range(len(paper.NAMES))))
        result.add_row(Text(table.title), *map(str, counts))
    return result


def _other_steps(found: paper.Reproduction) -> Table:
    """Tabulate, by time step, how many cells of each table agree with the paper."""
    counts = {
        f"{1000 * each.integration.dt:g}": list(each.agreeing.values()) for each in found.by_step
    }
    most = max(map(sum, counts.values()))
    best = " and ".join(step for step, each in counts.items() if sum(each) == most)
    tables = [found.table(key) for key in found.by_step[0].agreeing]
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


def _spreads(found: paper.Reproduction) -> Iterator[str]:
    for spread in found.near_the_limit:
        yield (
            f"Table 2, converged against {spread.integrations[1]}: "
            f"at most {spread.position:.1f} mm and {spread.angle:.2f}° apart."
        )
    about, last = found.about_coarse, found.last_digits
    steps = [1000 * integration.dt for integration in about.integrations]
    yield (
        f"Table 2, explicit steps of {min(steps):g} to {max(steps):g} ms: "
        f"up to {about.position:.0f} mm and {about.angle:.1f}° apart; the sign function chatters."
    )
    yield (
        f"Table 2, {runs.COARSE}, all axes turned by 4e-15 rad either way: up to "
        f"{last.position:.0f} mm and {last.angle:.1f}° apart; cos(90°) as computers round it is "
        "off by as little."
    )


def draw_figures(found: paper.Reproduction, folder: Path) -> list[Path]:
    """Write the figures of a reproduction into the folder, and return their paths."""
    figures = {
        "figure7": draw_trajectories(),
        "figure8": draw_rates(found),
        "figure10": draw_slowing(),
        "alignment": draw_alignment(),
    }
    paths = []
    for name, figure in figures.items():
        for suffix in SUFFIXES:
            path = folder / (name + suffix)
            figure.savefig(path, dpi=160)
            paths.append(path)
    return paths


def draw_surface(
    panel: Axes, surface: Surface, rotor: str = ROTOR, support: str = SUPPORT, width: float = 1.2
) -> None:
    """Draw a surface from above, with the symbols of Figure 6 for rotor axes and supports.

    `rotor` and `support` are colours, `width` [pt] is the width of a rotor's stroke.
    """
    x, y = np.meshgrid(surface.x, surface.y)
    is_rotor = surface.rotor
    panel.plot(x[~is_rotor], y[~is_rotor], ".", color=support, markersize=4)
    panel.plot(x[is_rotor], y[is_rotor], ".", color=rotor, markersize=4)
    strokes = trajectory_plot.axis_strokes(
        np.stack([x, y], axis=-1)[is_rotor], surface.axis[is_rotor], 0.03
    )
    panel.add_collection(LineCollection(strokes, color=rotor, linewidth=width))


def draw_base(
    panel: Axes, base: Base, pose: ArrayLike, colour: str, style: str = "-", width: float = 2.0
) -> None:
    """Draw the perimeter of a base at a pose (x, y, theta) [m, m, rad] on matplotlib axes `panel`.

    The line has matplotlib's line style `style` and the width `width` [pt].
    """
    outline = trajectory_plot.outline_at(base, pose)
    corners = np.vstack([outline, outline[:1]])
    panel.plot(corners[:, 0], corners[:, 1], style, color=colour, linewidth=width)


def _draw_box(
    panel: Axes, size: str, pose: ArrayLike, colour: str, style: str = "-", width: float = 2.0
) -> None:
    draw_base(panel, layouts.box(size).base, pose, colour, style, width)


def draw_trajectories() -> Figure:
    """Draw Figure 7: trajectories and end poses of the sorting runs in Table 2."""
    figure = Figure(figsize=(13.0, 6.0), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for letter, panel in zip("abc", panels, strict=True):
        rows = [
            run for run in runs.load_targets().sorting_runs if run.figure.startswith(f"7{letter}")
        ]
        title = f"({letter}) axes at {-45 * rows[0].side:+}°, after {rows[0].time:g} s"
        draw_surface(panel, layouts.sorting("S", rows[0].side))
        for run in rows:
            _draw_sorting_run(panel, run)
        panel.set(xlim=(0.0, 1.4), ylim=(0.2, 1.8), aspect="equal", xlabel="x [m]", title=title)
        panel.legend(loc="lower left" if rows[0].side > 0 else "upper left", framealpha=1.0)
    panels[0].set_ylabel("y [m]")
    marks = [
        Line2D([], [], marker="|", color=ROTOR, markersize=10, linestyle="", label="rotor axis"),
        Line2D([], [], marker=".", color=SUPPORT, linestyle="", label="support"),
        Line2D([], [], color="gray", linewidth=2.0, label=COARSE_NAME),
        Line2D([], [], color="gray", linewidth=1.0, linestyle="--", label="converged"),
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=len(marks))
    return figure


def _draw_sorting_run(panel: Axes, run: runs.SortingRun) -> None:
    colour = {"7c black": "black", "7c magenta": "magenta"}.get(run.figure, BOX)
    coarse, fine = runs.run_table2(run, runs.COARSE), runs.run_table2(run, runs.CONVERGED)
    label = f"{run.speed:g} m/s" if run.speed > 0.0 else f"tilted by {run.tilt:g}°"
    panel.plot(coarse.pose[:, 0], coarse.pose[:, 1], color=colour, linewidth=2.0, label=label)
    panel.plot(fine.pose[:, 0], fine.pose[:, 1], "--", color=colour, linewidth=1.0)
    _draw_box(panel, "S", coarse.pose[-1], colour, "-", 2.0)
    _draw_box(panel, "S", fine.pose[-1], colour, "--", 1.0)
    panel.plot(*coarse.pose[-1, :2], "o", color=colour, markersize=4)


def draw_rates(found: paper.Reproduction) -> Figure:
    """Draw Figure 8: sorting rates over v0 (red) and over tilt (blue), one panel per box."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for letter, size, panel in zip("ab", runs.SIZES, panels, strict=True):
        panel.axhspan(*runs.load_targets().medium_rates, color="0.9", label="torsional discs [45]")
        _draw_cases(panel, found.sorted_by_speed, size, "speed", "red")
        over_tilt = panel.twiny()
        _draw_cases(over_tilt, found.sorted_by_tilt, size, "tilt", "blue")
        panel.set(xlabel="initial velocity [m/s]", xlim=(0.7, 2.8), ylim=(0.0, 7000.0))
        panel.xaxis.label.set_color("red")
        over_tilt.set_xlabel("inclination [°]", color="blue")
        over_tilt.set(xlim=(4.0, 16.0), xticks=paper.TILTS)
        panel.set_title(f"({letter}) {size}-box")
    panels[0].set_ylabel("sorting rate [pcs/h]")
    marks = [
        Line2D([], [], marker="o", linestyle="", color="red", label="initial velocity"),
        Line2D([], [], marker="o", linestyle="", color="blue", label="inclination"),
        Line2D([], [], marker="+", linestyle="", color="black", label="converged"),
    ]
    band = panels[0].get_legend_handles_labels()[0]
    panels[1].legend(handles=[*marks, *band], loc="upper left")
    return figure


def _draw_cases(
    panel: Axes, cases: Sequence[runs.SortingCase], size: str, over: str, colour: str
) -> None:
    """Plot the sorting rates of box `size` over the entry speed or tilt of the cases.

    `over` is "speed" or "tilt". Dots are rates computed with the coarse step. Crosses are converged
    rates. Unsorted boxes have no mark.
    """
    mine = [case for case in cases if case.size == size]
    x = [getattr(case, over) for case in mine]
    panel.plot(x, [case.ours[0].rate or math.nan for case in mine], "o", color=colour)
    panel.plot(x, [case.ours[1].rate or math.nan for case in mine], "k+", markersize=5)


def draw_slowing() -> Figure:
    """Draw Figure 10: velocity while slowing and stopping by axes at 0 (red) or +-45 deg (blue)."""
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    tasks = (("slowing", layouts.slowing, 0), ("stopping", layouts.stopping, 1))
    letters = iter("abcd")
    columns = runs.load_targets().ratio_columns
    for row, size in zip(panels, runs.SIZES, strict=True):
        for panel, (name, layout, extra) in zip(row, tasks, strict=True):
            for angle, colour in ((0, "red"), (45, "blue")):
                surface = layout(size, math.radians(angle), columns)
                _draw_velocity(panel, surface, size, columns + extra, colour)
            panel.set_title(f"({next(letters)}) {size}-box, {name}")
            panel.set(xlim=(0.0, SLOWING_TIME), ylim=(-0.03, 1.6))
            panel.grid(alpha=0.3)
            panel.label_outer()
    figure.supxlabel("time [s]")
    figure.supylabel("velocity along x [m/s]")
    marks = [
        Line2D([], [], color="red", label="0°"),
        Line2D([], [], color="blue", label="±45°"),
        Line2D([], [], color="black", linestyle="--", linewidth=1.0, label="converged"),
        Line2D([], [], color="black", linestyle=":", label="start and end of slowing"),
    ]
    panels[0, 0].legend(handles=marks, loc="upper right")
    return figure


def _draw_velocity(
    panel: Axes, surface: Surface, size: str, task_columns: int, colour: str
) -> None:
    """Draw a box's velocity, computed with two step lengths. Mark start and end of slowing."""
    speed = runs.load_targets().ratio_speed
    coarse = runs.COARSE.run(surface, size, speed, SLOWING_TIME)
    fine = runs.CONVERGED.run(surface, size, speed, SLOWING_TIME)
    panel.plot(*_velocity(coarse), color=colour, linewidth=2.0)
    panel.plot(*_velocity(fine), "--", color=colour, linewidth=1.0)
    first, last = runs.rotor_columns(surface, size, coarse.pose)
    begin = layouts.LEAD_IN[size]
    for there in (last >= begin, first >= begin + task_columns):
        if there.any():
            panel.axvline(coarse.time[np.argmax(there)], color=colour, linestyle=":")


def _velocity(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return time [s] and velocity along x [m/s]. After a stop, add 0 m/s until `SLOWING_TIME`."""
    time, velocity = trajectory.time, trajectory.velocity[:, 0]
    if trajectory.end == "stopped":
        time = np.append(time, [time[-1], SLOWING_TIME])
        velocity = np.append(velocity, [0.0, 0.0])
    return time, velocity


def draw_alignment() -> Figure:
    """Draw how boxes cross a zone whose outer rows push inwards, or push outwards.

    The boxes enter with an offset from the middle of the line, or turned by an angle.
    """
    figure = Figure(figsize=(11.0, 8.4), layout="constrained")
    panels = figure.subplots(
        3, 2, sharex=True, sharey="row", gridspec_kw={"height_ratios": (1.25, 1.0, 1.0)}
    )
    sides = ((runs.INWARDS, "rows push inwards"), (runs.OUTWARDS, "rows push outwards"))
    for (above, off, turned), (towards, title) in zip(panels.T, sides, strict=True):
        zone = runs.Zone("S", towards, ALIGNING_COLUMNS, ALIGNING_SPEED, 0.0)
        _draw_above(above, zone)
        above.set_title(title)
        for offset, colour in zip(OFFSETS, COLOURS, strict=True):
            run = runs.cross(zone, offset, 0.0)
            y = 1000.0 * (run.pose[:, 1] - layouts.LINE_Y)
            label = f"comes {1000.0 * offset:.0f} mm off, straight"
            off.plot(run.pose[:, 0], y, color=colour, linewidth=2.0, label=label)
        for turn, colour in zip(TURNS, COLOURS, strict=False):
            run = runs.cross(zone, 0.0, turn)
            label = f"comes in the middle, turned by {turn:.0f}°"
            theta = np.degrees(run.pose[:, 2])
            turned.plot(run.pose[:, 0], theta, color=colour, linewidth=2.0, label=label)
        for panel in (off, turned):
            _shade(panel, zone)
        turned.set_xlabel("x [m]")
    above, off, turned = panels[:, 0]
    above.set_ylabel("y [m]")
    off.set_ylabel("off the middle [mm]")
    turned.set_ylabel("turned [°]")
    off.legend(loc="lower left", framealpha=1.0)
    turned.legend(loc="upper left", framealpha=1.0)
    figure.suptitle(
        f"S-box at {ALIGNING_SPEED:g} m/s over {ALIGNING_COLUMNS} columns at ±45° in alternate "
        "rows (shaded), level"
    )
    return figure


def _draw_above(panel: Axes, zone: runs.Zone) -> None:
    """Draw a box from above at five evenly spaced times. It enters at an angle, in the middle."""
    draw_surface(panel, zone.surface)
    run = runs.cross(zone, 0.0, SHOWN_TURN)
    for k in np.linspace(0, len(run.pose) - 1, 5).astype(int):
        shade = 0.25 + 0.75 * k / len(run.pose)
        _draw_box(panel, "S", run.pose[k], "limegreen", width=0.8 + 1.4 * shade)
    panel.plot(run.pose[:, 0], run.pose[:, 1], color="green", linewidth=1.2)
    panel.axhline(layouts.LINE_Y, color="0.5", linewidth=0.8, linestyle=":")
    panel.set(ylim=(0.76, 1.24), xlim=(0.0, 1.2), aspect="equal")
    text = f"comes in the middle, turned by {SHOWN_TURN:.0f}°"
    panel.text(0.02, 0.795, text, bbox={"facecolor": "white", "edgecolor": "none"})


def _shade(panel: Axes, zone: runs.Zone) -> None:
    """Shade the zone's columns."""
    surface = zone.surface
    first = layouts.LEAD_IN[zone.size]
    edges = surface.x[[first, first + zone.columns - 1]]
    half = 0.5 * surface.pitch_x
    panel.axvspan(edges[0] - half, edges[1] + half, color="0.93", zorder=0)
    panel.axhline(0.0, color="0.5", linewidth=0.8, linestyle=":")
    panel.grid(alpha=0.3)
