"""Figures 6, 9 and 11 of the paper: its layouts."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from surface_gym import layouts
from surface_gym.paper.drawing import BOX, draw_box, draw_surface, element_marks
from surface_gym.paper.targets import SIZES, load_targets
from surface_gym.surface import Surface

EIGHTH = 0.25 * math.pi  # [rad]
# Figure 11b, drawn from Table 5.
ROTOR_RADIUS = 0.01  # [m]
ROTOR_LENGTH = 0.01  # [m]
BOX_HEIGHT = 0.2  # [m] twice the height of its centre of mass
ENLARGED = 3.0  # [-] rotors as drawn
SHOWN = 14  # columns


def draw_kinds() -> Figure:
    """Figure 6: sorting, slowing at 0 deg and at +-45 deg."""
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
    """Figure 9: slowing layouts of both boxes."""
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    columns = load_targets().ratio_columns
    cases = [(size, angle) for size in SIZES for angle in (0.0, EIGHTH)]
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for letter, panel, (size, angle) in zip("abcd", panels.flat, cases, strict=True):
        title = f"({letter}) {size}-box, {'±45' if angle else '0'}°"
        _draw_layout(panel, size, layouts.slowing(size, angle, columns, columns=SHOWN), title)
    _finish(figure)
    return figure


def draw_validation_layout() -> Figure:
    """Figure 11: the sorting layout (a) from above and (b) as the bodies of Table 5."""
    figure = Figure(figsize=(13.0, 4.6), layout="constrained")
    surface = layouts.sorting("S", task_columns=SHOWN - 3, columns=SHOWN)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.25))
    _draw_layout(figure.add_subplot(grid[0, 0]), "S", surface, "(a) the model")
    _draw_bodies(figure.add_subplot(grid[0, 1], projection="3d"), surface)
    _finish(figure)
    return figure


def _draw_layout(panel: Axes, size: str, surface: Surface, title: str) -> None:
    draw_surface(panel, surface)
    draw_box(panel, size, layouts.start(size), BOX)
    panel.plot(*layouts.start(size)[:2], "o", color=BOX, markersize=4)
    panel.set(
        xlim=(-0.05, 1.4),
        ylim=(0.5, 1.5),
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
        title=title,
    )
    panel.label_outer()


def _finish(figure: Figure) -> None:
    marks = [*element_marks(), Line2D([], [], color=BOX, linewidth=2.0, label="base at the start")]
    figure.legend(handles=marks, loc="outside lower center", ncols=len(marks))


def _draw_bodies(space: Any, surface: Surface) -> None:
    """Cylinders on their axes, spheres for the supports and the box as a wire frame."""
    near = np.abs(surface.y - layouts.LINE_Y) < 0.4
    x, y = np.meshgrid(surface.x, surface.y[near])
    rotor, axis = surface.rotor[near], surface.axis[near]
    space.scatter(
        x[~rotor], y[~rotor], -ROTOR_RADIUS, s=22, color="pink", edgecolor="palevioletred"
    )
    colours = np.array(["tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:cyan"])
    for k, (px, py, angle) in enumerate(zip(x[rotor], y[rotor], axis[rotor], strict=True)):
        _draw_cylinder(space, px, py, angle, str(colours[k % len(colours)]))
    _draw_wire_frame(space)
    space.set(
        xlabel="x [m]",
        ylabel="y [m]",
        zlabel="z [m]",
        title="(b) the bodies of Table 5, rotors drawn three times as large",
        xlim=(-0.05, 1.45),
        ylim=(0.6, 1.4),
        zlim=(-0.05, 0.25),
    )
    space.set(yticks=(0.6, 1.0, 1.4), zticks=(0.0, 0.2))
    space.set_box_aspect((1.5, 0.8, 0.3), zoom=1.3)
    space.view_init(elev=32.0, azim=-62.0)


def _draw_cylinder(space: Any, x: float, y: float, angle: float, colour: str) -> None:
    """With its top in the plane, three times as large as it is so that it can be seen."""
    around = np.linspace(0.0, 2.0 * math.pi, 25)
    # From the middle of one face over the side to the middle of the other.
    radius = ENLARGED * ROTOR_RADIUS * np.array([[0.0], [1.0], [1.0], [0.0]])
    along = 0.5 * ENLARGED * ROTOR_LENGTH * np.array([[-1.0], [-1.0], [1.0], [1.0]])
    side = radius * np.cos(around)
    space.plot_surface(
        x + along * math.cos(angle) - side * math.sin(angle),
        y + along * math.sin(angle) + side * math.cos(angle),
        radius * np.sin(around) - ENLARGED * ROTOR_RADIUS,
        color=colour,
        linewidth=0.0,
        rstride=1,
        cstride=1,
    )


def _draw_wire_frame(space: Any) -> None:
    x, y, _ = layouts.start("S")
    corners = layouts.box("S").base.outline + np.array([x, y])
    ring = np.vstack([corners, corners[:1]])
    for z in (0.0, BOX_HEIGHT):
        space.plot(ring[:, 0], ring[:, 1], z, color="darkorange", linewidth=1.8)
    for corner in corners:
        space.plot(
            [corner[0]] * 2, [corner[1]] * 2, [0.0, BOX_HEIGHT], color="darkorange", linewidth=1.8
        )
