"""Figures 6 to 10 of the paper, and the alignment of boxes on axes at +-45 deg."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from surface_gym import layouts, trajectory_plot
from surface_gym.paper import runs
from surface_gym.paper.claims import INWARDS, OFFSETS, OUTWARDS, TURNS, Zone, cross
from surface_gym.paper.reproduction import NAMES, TILTS, Reproduction
from surface_gym.parcel import Base
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory

SUFFIXES = (".png", ".pdf")
ROTOR = "red"
SUPPORT = "tab:blue"
BOX = "limegreen"
SLOWING_TIME = 1.5  # [s] duration in Figure 10
EIGHTH = 0.25 * math.pi  # [rad] axis angle in Figures 6 and 9
SHOWN = 14  # columns in Figures 6 and 9
ALIGNING_COLUMNS = 6  # columns of the alignment figure
ALIGNING_SPEED = 2.5  # [m/s]
SHOWN_TURN = 10.0  # [deg] initial turn of the box drawn from above
COLOURS = ("#1b6ca8", "#e07a1f", "#7a3b8f")


def draw_figures(reproduction: Reproduction, folder: Path) -> list[Path]:
    """Write the figures into the folder, and return their paths."""
    figures = {
        "figure6": draw_kinds(),
        "figure7": draw_trajectories(),
        "figure8": draw_rates(reproduction),
        "figure9": draw_slowing_layouts(),
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
    """Draw a surface from above in the symbols of Figure 6: rotors with their axes, supports."""
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
    """Draw the perimeter of a base at (x, y, theta) [m, m, rad]."""
    outline = trajectory_plot.outline_at(base, pose)
    corners = np.vstack([outline, outline[:1]])
    panel.plot(corners[:, 0], corners[:, 1], style, color=colour, linewidth=width)


def _draw_box(
    panel: Axes, size: str, pose: ArrayLike, colour: str, style: str = "-", width: float = 2.0
) -> None:
    draw_base(panel, layouts.box(size).base, pose, colour, style, width)


def _element_marks() -> list[Line2D]:
    """Make entries of a legend for rotors and supports."""
    return [
        Line2D([], [], marker="|", color=ROTOR, markersize=10, linestyle="", label="rotor axis"),
        Line2D([], [], marker=".", color=SUPPORT, linestyle="", label="support"),
    ]


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
        *_element_marks(),
        Line2D([], [], color="gray", linewidth=2.0, label=NAMES[0]),
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


def draw_rates(reproduction: Reproduction) -> Figure:
    """Draw Figure 8: sorting rates over v0 (red) and over tilt (blue), one panel per box."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for letter, size, panel in zip("ab", runs.SIZES, panels, strict=True):
        panel.axhspan(*runs.load_targets().medium_rates, color="0.9", label="torsional discs [45]")
        _draw_cases(panel, reproduction.sorted_by_speed, size, "speed", "red")
        over_tilt = panel.twiny()
        _draw_cases(over_tilt, reproduction.sorted_by_tilt, size, "tilt", "blue")
        panel.set(xlabel="initial velocity [m/s]", xlim=(0.7, 2.8), ylim=(0.0, 7000.0))
        panel.xaxis.label.set_color("red")
        over_tilt.set_xlabel("inclination [°]", color="blue")
        over_tilt.set(xlim=(4.0, 16.0), xticks=TILTS)
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
    panel: Axes, cases: tuple[runs.SortingCase, ...], size: str, over: str, colour: str
) -> None:
    """Draw dots for the coarse step and crosses for converged runs; none for unsorted boxes."""
    mine = [case for case in cases if case.size == size]
    x = [getattr(case, over) for case in mine]
    panel.plot(x, [case.ours[0].rate or math.nan for case in mine], "o", color=colour)
    panel.plot(x, [case.ours[1].rate or math.nan for case in mine], "k+", markersize=5)


def draw_slowing() -> Figure:
    """Draw Figure 10: velocity while slowing and stopping, at 0 deg (red) and +-45 deg (blue)."""
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
    """Draw the velocity at both time steps; mark the entry to the task's columns and the exit."""
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
    """Return time and velocity along x; a stopped parcel rests to the end."""
    time, velocity = trajectory.time, trajectory.velocity[:, 0]
    if trajectory.end == "stopped":
        time = np.append(time, [time[-1], SLOWING_TIME])
        velocity = np.append(velocity, [0.0, 0.0])
    return time, velocity


def draw_kinds() -> Figure:
    """Draw Figure 6: sorting, slowing at 0 deg and at +-45 deg."""
    figure = Figure(figsize=(13.0, 3.9), layout="constrained")
    kinds = (
        ("(a) sorting", layouts.sorting("S", task_columns=SHOWN - 3, columns=SHOWN)),
        ("(b) slowing or stopping, 0°", layouts.slowing("S", 0.0, columns=SHOWN)),
        ("(c) slowing or stopping, ±45°", layouts.slowing("S", EIGHTH, columns=SHOWN)),
    )
    for panel, (title, surface) in zip(figure.subplots(1, 3, sharey=True), kinds, strict=True):
        _draw_layout(panel, "S", surface, title)
    _finish(figure)
    return figure


def draw_slowing_layouts() -> Figure:
    """Draw Figure 9: slowing layouts of both boxes."""
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    columns = runs.load_targets().ratio_columns
    cases = [(size, angle) for size in runs.SIZES for angle in (0.0, EIGHTH)]
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for letter, panel, (size, angle) in zip("abcd", panels.flat, cases, strict=True):
        title = f"({letter}) {size}-box, {'±45' if angle else '0'}°"
        _draw_layout(panel, size, layouts.slowing(size, angle, columns, columns=SHOWN), title)
    _finish(figure)
    return figure


def _draw_layout(panel: Axes, size: str, surface: Surface, title: str) -> None:
    draw_surface(panel, surface)
    _draw_box(panel, size, layouts.start(size), BOX)
    panel.plot(*layouts.start(size)[:2], "o", color=BOX, markersize=4)
    panel.set(xlim=(-0.05, 1.4), ylim=(0.5, 1.5), aspect="equal", title=title)
    panel.set(xlabel="x [m]", ylabel="y [m]")
    panel.label_outer()


def _finish(figure: Figure) -> None:
    marks = [*_element_marks(), Line2D([], [], color=BOX, linewidth=2.0, label="base at the start")]
    figure.legend(handles=marks, loc="outside lower center", ncols=len(marks))


def draw_alignment() -> Figure:
    """Draw boxes with an offset or a turn from above, for rows that push inwards and outwards."""
    figure = Figure(figsize=(11.0, 8.4), layout="constrained")
    panels = figure.subplots(
        3, 2, sharex=True, sharey="row", gridspec_kw={"height_ratios": (1.25, 1.0, 1.0)}
    )
    sides = ((INWARDS, "rows push inwards"), (OUTWARDS, "rows push outwards"))
    for (above, off, turned), (towards, title) in zip(panels.T, sides, strict=True):
        zone = Zone("S", towards, ALIGNING_COLUMNS, ALIGNING_SPEED, 0.0)
        _draw_above(above, zone)
        above.set_title(title)
        for offset, colour in zip(OFFSETS, COLOURS, strict=True):
            run = cross(zone, offset, 0.0)
            y = 1000.0 * (run.pose[:, 1] - layouts.LINE_Y)
            label = f"comes {1000.0 * offset:.0f} mm off, straight"
            off.plot(run.pose[:, 0], y, color=colour, linewidth=2.0, label=label)
        for turn, colour in zip(TURNS, COLOURS, strict=False):
            run = cross(zone, 0.0, turn)
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


def _draw_above(panel: Axes, zone: Zone) -> None:
    """Draw a turned box from the middle, at equal time intervals."""
    draw_surface(panel, zone.surface)
    run = cross(zone, 0.0, SHOWN_TURN)
    for k in np.linspace(0, len(run.pose) - 1, 5).astype(int):
        shade = 0.25 + 0.75 * k / len(run.pose)
        _draw_box(panel, "S", run.pose[k], "limegreen", width=0.8 + 1.4 * shade)
    panel.plot(run.pose[:, 0], run.pose[:, 1], color="green", linewidth=1.2)
    panel.axhline(layouts.LINE_Y, color="0.5", linewidth=0.8, linestyle=":")
    panel.set(ylim=(0.76, 1.24), xlim=(0.0, 1.2), aspect="equal")
    text = f"comes in the middle, turned by {SHOWN_TURN:.0f}°"
    panel.text(0.02, 0.795, text, bbox={"facecolor": "white", "edgecolor": "none"})


def _shade(panel: Axes, zone: Zone) -> None:
    """Shade the zone's columns."""
    surface = zone.surface
    first = layouts.LEAD_IN[zone.size]
    edges = surface.x[[first, first + zone.columns - 1]]
    half = 0.5 * surface.pitch_x
    panel.axvspan(edges[0] - half, edges[1] + half, color="0.93", zorder=0)
    panel.axhline(0.0, color="0.5", linewidth=0.8, linestyle=":")
    panel.grid(alpha=0.3)
