"""A fixed layout beside the study's as a picture, by matplotlib."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from surface_gym.design.best_layout import BestLayout, OverSpeeds
from surface_gym.design.case import WORST
from surface_gym.design.line import DesignLine
from surface_gym.design.pictures import BLUE, ORANGE
from surface_gym.design.telling import base_told, purpose_met

STROKE = 0.38  # [-] of the pitch, half an axis' stroke


def draw_layout(found: BestLayout) -> Figure:
    """Axes of both zones, and at which entry speeds they succeed."""
    case = found.case
    figure = Figure(figsize=(8.0, 7.2), layout="constrained")
    figure.suptitle(
        f"Which fixed layout for it to {purpose_met(case.purpose)}?\n{base_told(case.parcel.base)}"
    )
    tall = 0.8 + 0.12 * found.line.rows
    above, below, curves = figure.subplots(3, 1, height_ratios=(tall, tall, 2.4))
    for axes, each, colour in ((above, found.best, BLUE), (below, found.study, ORANGE)):
        _draw_axes(axes, found.line, each, colour)
        _draw_success(curves, each, colour)
    below.set_xlabel("x from the zone's start [m]")
    curves.axhline(1.0 - WORST, color="black", linewidth=0.8)
    curves.set(xlabel="entry speed [m/s]", ylabel="success")
    curves.set_ylim(0.0, 1.03)
    curves.margins(x=0.0)
    curves.grid(alpha=0.25)
    curves.yaxis.set_major_formatter(PercentFormatter(1.0))
    figure.legend(*curves.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _draw_axes(axes: Axes, line: DesignLine, layout: OverSpeeds, colour: str) -> None:
    """A stroke along each axis: along it a rotor drags, across it rolls."""
    rows, columns = layout.axis.shape
    pitch = np.array([line.pitch_x, line.pitch_y])
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) - 0.5 * (rows - 1))
    centre = np.stack([x, y], axis=-1) * pitch
    half = STROKE * pitch.min() * np.stack([np.cos(layout.axis), np.sin(layout.axis)], axis=-1)
    strokes = np.stack([centre - half, centre + half], axis=-2).reshape(-1, 2, 2)
    axes.add_collection(LineCollection(list(strokes), colors=colour, linewidths=2.5))
    axes.set(xlim=(0.0, columns * pitch[0]), ylim=(-0.5 * rows * pitch[1], 0.5 * rows * pitch[1]))
    axes.set(aspect="equal", ylabel="y [m]")
    axes.set_title(layout.name, fontsize="small")


def _draw_success(axes: Axes, layout: OverSpeeds, colour: str) -> None:
    axes.plot(
        layout.speeds, layout.share, color=colour, linewidth=1.8,
        linestyle="-" if colour == BLUE else "--", label=f"{layout.name}, share of the draws",
    )  # fmt: skip
    axes.fill_between(
        layout.speeds, layout.success, step="mid", color=colour, alpha=0.15, linewidth=0.0,
        label=f"{layout.name}, nothing unknown",
    )  # fmt: skip
