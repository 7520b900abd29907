"""The figure of a trajectory by matplotlib, in the style of the study's Figures 7 and 10."""

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import ArrayLike

from surface_gym.parcel import Base
from surface_gym.physics.types import Array
from surface_gym.surface import Surface

if TYPE_CHECKING:
    from surface_gym.trajectory import Trajectory

HEIGHT, LEAST_HEIGHT = 5.2, 3.8  # [in] height of the figure, and its minimum for a long strip
LENGTH = 8.5  # [in] width of a long strip
LONGEST, SHORTEST = 3.0, 0.7  # [-] the window's length over its width
OUTLINES = 7  # number of outlines, including the first and the last
STROKE = 0.6  # [pitch] length of the stroke through a rotor's centre
LEAST_PITCH = 1.5  # [pt] elements are drawn only if their pitch on paper is larger
LEAST_RANGE = 0.02  # [m/s, rad/s] minimum range of an axis, so that round-off is not visible
PATH, TIPPING = "tab:blue", "darkorange"
POINTS_PER_INCH = 72.0


def draw_trajectory(trajectory: "Trajectory") -> Figure:
    """Draw a panel with the path over the surface, and two panels with speeds over time."""
    outlines = _outlines(trajectory)
    low, high = _window(trajectory, outlines)
    shape = float((high[0] - low[0]) / (high[1] - low[1]))
    share = 0.82  # of the figure's height, without labels and title
    height = min(HEIGHT, max(LEAST_HEIGHT, LENGTH / (share * shape)))
    width = share * height * shape  # [in] of the surface's panel
    figure = Figure(figsize=(width + 6.0, height), layout="constrained")
    panels = figure.subplot_mosaic([["way", "linear"], ["way", "turning"]], width_ratios=[width, 4])
    way = panels["way"]
    if trajectory.run is not None:
        pitch = POINTS_PER_INCH * width / (high[0] - low[0]) * trajectory.run.surface.pitch_x
        _draw_elements(way, trajectory.run.surface, low, high, float(pitch))
    _draw_path(way, trajectory, outlines)
    way.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    way.set(xlabel="x [m]", ylabel="y [m]")
    _draw_velocity(panels["linear"], panels["turning"], trajectory)
    end = "the duration is over" if trajectory.end == "duration" else trajectory.end
    figure.suptitle(f"after {trajectory.time[-1]:.4g} s: {end}")
    return figure


def _outlines(trajectory: "Trajectory") -> list[Array]:
    """Compute the outlines (points, 2) [m] of the base at evenly spaced instants."""
    if trajectory.run is None:
        return []
    base = trajectory.run.parcel.base
    shown = np.unique(np.linspace(0, len(trajectory.time) - 1, OUTLINES).round().astype(int))
    return [outline_at(base, pose) for pose in trajectory.pose[shown]]


def outline_at(base: Base, pose: ArrayLike) -> Array:
    """Compute the outline (points, 2) [m] of a base at a pose (x, y, theta) [m, m, rad]."""
    x, y, theta = np.asarray(pose)
    cosine, sine = math.cos(theta), math.sin(theta)
    return base.outline @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([x, y])


def axis_strokes(centre: Array, axis: Array, half: float) -> list[Array]:
    """Return the ends (2, 2) [m] of a stroke per axis [rad]. A stroke is 2 * `half` [m] long."""
    reach = half * np.stack([np.cos(axis), np.sin(axis)], axis=-1)
    return list(np.stack([centre - reach, centre + reach], axis=-2).reshape(-1, 2, 2))


def _window(trajectory: "Trajectory", outlines: list[Array]) -> tuple[Array, Array]:
    """Compute the lower left and the upper right corner (2,) [m] of the shown area.

    The area contains the path and the outlines with a margin. Its proportions are limited.
    """
    points = np.concatenate([trajectory.pose[:, :2], *outlines])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * (high - low).max()
    if trajectory.run is not None:
        margin = max(margin, trajectory.run.surface.pitch_x, trajectory.run.surface.pitch_y)
    margin = max(margin, 0.01)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) + margin
    length, width = half
    half = np.array([max(length, SHORTEST * width), max(width, length / LONGEST)])
    return middle - half, middle + half


def _draw_elements(panel: Axes, surface: Surface, low: Array, high: Array, pitch: float) -> None:
    """Draw each rotor as a red stroke along its axis, and each support as a dot.

    The elements lie between the corners `low` and `high` (2,) [m]. `pitch` [pt] is the grid's pitch
    on paper. If `pitch` is below `LEAST_PITCH`, draw nothing.
    """
    if pitch < LEAST_PITCH:
        return
    columns = _within(surface.x, low[0], high[0], surface.pitch_x)
    rows = _within(surface.y, low[1], high[1], surface.pitch_y)
    x, y = np.meshgrid(surface.x[columns], surface.y[rows])
    rotor, axis = surface.rotor[rows, columns], surface.axis[rows, columns]
    size = min(4.0, 0.16 * pitch)
    panel.plot(x[~rotor], y[~rotor], ".", color="0.65", markersize=size, zorder=1)
    centre = np.stack([x[rotor], y[rotor]], axis=-1)
    half = 0.5 * STROKE * min(surface.pitch_x, surface.pitch_y)
    strokes, width = axis_strokes(centre, axis[rotor], half), min(1.6, 0.08 * pitch)
    panel.add_collection(LineCollection(strokes, color="red", linewidth=width, zorder=1))


def _within(centres: Array, low: float, high: float, pitch: float) -> slice:
    """Select the rows or columns with centres from `low` - `pitch` to `high` + `pitch` [m]."""
    first, end = np.searchsorted(centres, (low - pitch, high + pitch)).tolist()
    return slice(first, end)


def _draw_path(panel: Axes, trajectory: "Trajectory", outlines: list[Array]) -> None:
    """Draw the base at some instants and the path of the base's origin; mark tipping by dots."""
    x, y = trajectory.pose[:, 0], trajectory.pose[:, 1]
    for k, outline in enumerate(outlines):
        outer = k in (0, len(outlines) - 1)
        edge, width = ("0.1", 1.6) if outer else ("0.45", 0.8)
        panel.add_patch(Polygon(outline, fill=False, edgecolor=edge, linewidth=width, zorder=2))
    panel.plot(x, y, color=PATH, linewidth=1.8, zorder=3)
    tips = trajectory.tipping
    panel.plot(np.where(tips, x, np.nan), y, ".", color=TIPPING, markersize=4, zorder=3)
    panel.plot(x[0], y[0], "o", color=PATH, markerfacecolor="white", markersize=6, zorder=4)
    panel.plot(x[-1], y[-1], "o", color=PATH, markersize=6, zorder=4)
    if tips.any():
        mark = Line2D([], [], marker=".", linestyle="", color=TIPPING, label="tipping")
        panel.legend(handles=[mark], loc="best", framealpha=1.0)


def _draw_velocity(linear: Axes, turning: Axes, trajectory: "Trajectory") -> None:
    """Draw the velocity along x and y on the axes `linear`, and omega on the axes `turning`."""
    time = trajectory.time
    style = "o" if len(time) == 1 else "-"
    vx, vy, omega = trajectory.velocity.T
    linear.plot(time, vx, style, color="tab:red", label="vx")
    linear.plot(time, vy, style, color="tab:blue", label="vy")
    turning.plot(time, omega, style, color="tab:green", label="omega")
    linear.set_ylabel("velocity [m/s]")
    turning.set(xlabel="time [s]", ylabel="omega [rad/s]")
    linear.sharex(turning)
    linear.tick_params(labelbottom=False)
    linear.legend(loc="best")
    for panel in (linear, turning):
        panel.grid(alpha=0.3)
        panel.axhline(0.0, color="0.5", linewidth=0.8, zorder=0)
        bottom, top = panel.get_ylim()
        panel.set_ylim(min(bottom, -LEAST_RANGE), max(top, LEAST_RANGE))
