"""The content of Figures 12 to 16, MuJoCo in the place of Adams, and the end poses on unequal
supports.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from surface_gym.paper import figures
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation.comparison import (
    PARCEL,
    Model,
    Run,
    compute_errors,
    displacement,
    is_sorted,
)
from surface_gym.validation.study import Study
from surface_gym.validation.unevenness import Spread

MUJOCO = "tab:red"  # the paper's colours: Adams red, MATLAB blue, errors green and magenta
MODEL = "tab:blue"
ABSOLUTE = "tab:green"
PERCENT = "m"
AXES = ("x [m]", "y [m]", "theta [deg]")


def draw_all(study: Study, folder: Path) -> list[Path]:
    """Write the figures as PNG; the paths."""
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
    """Figure 12: plan views of MuJoCo's runs at 10 deg, with a push, and at 5 deg for 1.8 s."""
    runs = [*_at_ten_degrees(study), study.pushed, study.long]
    figure = Figure(figsize=(4.6 * len(runs), 4.0), layout="constrained")
    for axes, run in zip(_row(figure, len(runs)), runs, strict=True):
        _draw_surface(axes, run.case.surface)
        _draw_path(axes, run.mujoco, MUJOCO, "MuJoCo")
        axes.set_title(
            f"tilt {run.case.tilt:g} deg, v0 = {run.case.speed:g} m/s, t = {run.case.duration:g} s"
        )
    return figure


def final_positions(study: Study) -> Figure:
    """Figure 13: where the box ends in each run that completes the sort."""
    figure = Figure(figsize=(10.0, 4.3), layout="constrained")
    sides: tuple[tuple[str, str, Model], ...] = (
        ("MuJoCo", MUJOCO, lambda run: run.mujoco),
        ("implicit", MODEL, lambda run: run.implicit),
    )
    for axes, (name, colour, side) in zip(_row(figure, 2), sides, strict=True):
        done = [run for run in study.sweep if is_sorted(run.case, side(run))]
        _draw_surface(axes, study.pushed.case.surface)
        for run in done:
            _draw_box(axes, side(run).pose[-1], colour)
            axes.plot(*side(run).pose[-1, :2], ".", color=colour)
        tilts = f", {done[0].case.tilt:g} to {done[-1].case.tilt:g} deg" if done else ""
        axes.set_title(f"{name}: {len(done)} sorted of {len(study.sweep)}{tilts}")
    return figure


def compared_trajectories(study: Study) -> Figure:
    """Figure 14: the paths of Figure 12a and 12b over the analytic model's."""
    runs = [*_at_ten_degrees(study), study.pushed]
    figure = Figure(figsize=(5.5 * len(runs), 4.6), layout="constrained")
    for axes, run in zip(_row(figure, len(runs)), runs, strict=True):
        _draw_surface(axes, run.case.surface)
        _draw_path(axes, run.implicit, MODEL, "implicit")
        _draw_path(axes, run.mujoco, MUJOCO, "MuJoCo", "--")
        axes.set_title(f"tilt {run.case.tilt:g} deg, v0 = {run.case.speed:g} m/s")
        axes.legend(loc="upper right")
    return figure


def final_displacements(study: Study) -> Figure:
    """Figure 15: displacements after 1 s over the tilt."""
    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    tilts = [run.case.tilt for run in study.sweep]
    mujoco = np.array([displacement(run.mujoco) for run in study.sweep])
    implicit = np.array([displacement(run.implicit) for run in study.sweep])
    for k, axes in enumerate(_row(figure, 3)):
        axes.plot(tilts, mujoco[:, k], "o-", color=MUJOCO, markersize=4, label="MuJoCo")
        axes.plot(tilts, implicit[:, k], "x--", color=MODEL, markersize=5, label="implicit")
        axes.set(xlabel="tilt [deg]", ylabel=AXES[k])
        axes.grid(alpha=0.3)
        axes.legend()
    return figure


def displacement_errors(study: Study) -> Figure:
    """Figure 16: absolute and percentage errors over the tilt, Eq. (5)."""
    figure = Figure(figsize=(13.0, 3.8), layout="constrained")
    tilts = [run.case.tilt for run in study.sweep]
    error = compute_errors(study.sweep, lambda run: run.implicit)
    names = ("x", "y", "theta")
    for k, axes in enumerate(_row(figure, 3)):
        unit = "deg" if k == 2 else "mm"
        axes.plot(tilts, error.absolute[:, k], "o-", color=ABSOLUTE, markersize=4)
        axes.set_xlabel("tilt [deg]")
        axes.set_ylabel(f"error in {names[k]} [{unit}]", color=ABSOLUTE)
        axes.grid(alpha=0.3)
        percent = axes.twinx()
        percent.plot(tilts, error.percent[:, k], "s--", color=PERCENT, markersize=3)
        percent.set_ylabel(f"error in {names[k]} [%]", color=PERCENT)
    return figure


def end_places(spreads: Sequence[Spread]) -> Figure:
    """End places on unequal supports; a line joins the two methods on the same supports."""
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


def _at_ten_degrees(study: Study) -> list[Run]:
    """Find the run of Figure 12a, if the sweep holds it."""
    return [run for run in study.sweep if run.case.tilt == 10.0]


def _row(figure: Figure, panels: int) -> Sequence[Any]:
    return list(figure.subplots(1, panels, squeeze=False)[0])


def _draw_surface(axes: Axes, surface: Surface) -> None:
    figures.draw_surface(axes, surface, rotor="darkorange", support="pink", width=2.5)
    axes.set(xlim=(0.0, 1.2), ylim=(0.45, 1.35), aspect="equal", xlabel="x [m]", ylabel="y [m]")


def _draw_box(axes: Axes, pose: Sequence[float], colour: str) -> None:
    figures.draw_base(axes, PARCEL.base, pose, colour, width=1.0)


def _draw_path(
    axes: Axes, trajectory: Trajectory, colour: str, label: str, style: str = "-"
) -> None:
    """Draw the path of the box's centre, and the box at its ends."""
    axes.plot(*trajectory.pose.T[:2], style, color=colour, label=label)
    _draw_box(axes, trajectory.pose[0], "0.5")
    _draw_box(axes, trajectory.pose[-1], colour)
