"""Figures 7, 8 and 10 of the paper, and all of them written to a folder."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from surface_gym import layouts
from surface_gym.paper.alignment_figure import draw_alignment
from surface_gym.paper.drawing import draw_box, draw_surface, element_marks
from surface_gym.paper.framing import COARSE_NAME
from surface_gym.paper.integration import COARSE, CONVERGED
from surface_gym.paper.layout_figures import (
    draw_kinds,
    draw_slowing_layouts,
    draw_validation_layout,
)
from surface_gym.paper.occupancy import rotor_columns
from surface_gym.paper.reproduction import TILTS, Reproduction
from surface_gym.paper.sorting import SortingCase, run_table2
from surface_gym.paper.targets import SIZES, SortingRun, load_targets
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory

SLOWING_TIME = 1.5  # [s] of Figure 10
COLOURS = {"7c black": "black", "7c magenta": "magenta"}
SUFFIXES = (".png", ".pdf")


def draw_figures(reproduction: Reproduction, folder: Path) -> list[Path]:
    """Write the figures into the folder; their paths."""
    figures = {
        "figure6": draw_kinds(),
        "figure7": draw_trajectories(),
        "figure8": draw_rates(reproduction),
        "figure9": draw_slowing_layouts(),
        "figure10": draw_slowing(),
        "figure11": draw_validation_layout(),
        "alignment": draw_alignment(),
    }
    paths = []
    for name, figure in figures.items():
        for suffix in SUFFIXES:
            path = folder / (name + suffix)
            figure.savefig(path, dpi=160)
            paths.append(path)
    return paths


def draw_trajectories() -> Figure:
    """Figure 7: trajectories and end poses of the sorting runs in Table 2."""
    figure = Figure(figsize=(13.0, 6.0), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for letter, panel in zip("abc", panels, strict=True):
        runs = [run for run in load_targets().sorting_runs if run.figure.startswith(f"7{letter}")]
        title = f"({letter}) axes at {-45 * runs[0].side:+}°, after {runs[0].time:g} s"
        draw_surface(panel, layouts.sorting("S", runs[0].side))
        for run in runs:
            _draw_sorting_run(panel, run)
        panel.set(xlim=(0.0, 1.4), ylim=(0.2, 1.8), aspect="equal", xlabel="x [m]", title=title)
        panel.legend(loc="lower left" if runs[0].side > 0 else "upper left", framealpha=1.0)
    panels[0].set_ylabel("y [m]")
    marks = [
        *element_marks(),
        Line2D([], [], color="gray", linewidth=2.0, label=COARSE_NAME),
        Line2D([], [], color="gray", linewidth=1.0, linestyle="--", label="converged"),
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=len(marks))
    return figure


def _draw_sorting_run(panel: Axes, run: SortingRun) -> None:
    colour = COLOURS.get(run.figure, "limegreen")
    coarse, fine = run_table2(run, COARSE), run_table2(run, CONVERGED)
    label = f"{run.speed:g} m/s" if run.speed > 0.0 else f"tilted by {run.tilt:g}°"
    panel.plot(coarse.pose[:, 0], coarse.pose[:, 1], color=colour, linewidth=2.0, label=label)
    panel.plot(fine.pose[:, 0], fine.pose[:, 1], "--", color=colour, linewidth=1.0)
    draw_box(panel, "S", coarse.pose[-1], colour, "-", 2.0)
    draw_box(panel, "S", fine.pose[-1], colour, "--", 1.0)
    panel.plot(*coarse.pose[-1, :2], "o", color=colour, markersize=4)


def draw_rates(reproduction: Reproduction) -> Figure:
    """Figure 8: sorting rates over v0 (red) and over tilt (blue), one panel a box."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for letter, size, panel in zip("ab", SIZES, panels, strict=True):
        panel.axhspan(*load_targets().medium_rates, color="0.9", label="torsional discs [45]")
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
    panel: Axes, cases: tuple[SortingCase, ...], size: str, over: str, colour: str
) -> None:
    """Dots at the coarse step, crosses converged; a box that is not sorted has none."""
    mine = [case for case in cases if case.size == size]
    x = [getattr(case, over) for case in mine]
    panel.plot(x, [case.ours[0].rate or math.nan for case in mine], "o", color=colour)
    panel.plot(x, [case.ours[1].rate or math.nan for case in mine], "k+", markersize=5)


def draw_slowing() -> Figure:
    """Figure 10: velocity while slowing and stopping, at 0 deg (red) and +-45 deg (blue)."""
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    tasks = (("slowing", layouts.slowing, 0), ("stopping", layouts.stopping, 1))
    letters = iter("abcd")
    columns = load_targets().ratio_columns
    for row, size in zip(panels, SIZES, strict=True):
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
    """Velocity at both steps, and when the base is first and last over the task's columns."""
    speed = load_targets().ratio_speed
    coarse = COARSE.run(surface, size, speed, SLOWING_TIME)
    fine = CONVERGED.run(surface, size, speed, SLOWING_TIME)
    panel.plot(*_velocity(coarse), color=colour, linewidth=2.0)
    panel.plot(*_velocity(fine), "--", color=colour, linewidth=1.0)
    first, last = rotor_columns(surface, size, coarse.pose)
    begin = layouts.LEAD_IN[size]
    for there in (last >= begin, first >= begin + task_columns):
        if there.any():
            panel.axvline(coarse.time[np.argmax(there)], color=colour, linestyle=":")


def _velocity(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Time and velocity along x; a stopped parcel rests to the end."""
    time, velocity = trajectory.time, trajectory.velocity[:, 0]
    if trajectory.end == "stopped":
        time = np.append(time, [time[-1], SLOWING_TIME])
        velocity = np.append(velocity, [0.0, 0.0])
    return time, velocity
