"""The picture of sorting: where parcels go, by entry speed."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon as Patch

from surface_gym.layouts import LINE_Y, box
from surface_gym.lines import Line

from ..episodes import Episodes
from .plots import DOTS
from .sorting import GRID
from .trials import PARCELS, SIDES, SORT_SPEEDS

SHOWN_SPEEDS = (0.4, 0.6, 0.8, 1.2, 2.0)  # [m/s] one trajectory each
_COLOURS = ("#440154", "#3b528b", "#21918c", "#5ec962", "#c9a227")


def draw_trajectories(runs: dict[str, Episodes], file: Path) -> None:
    """Trajectories to y > 0 by entry speed: a row of panels a controller, a column a parcel."""
    figure = Figure(figsize=(12.0, 3.4 * len(runs)), layout="constrained")
    panels = figure.subplots(len(runs), len(PARCELS), sharex=True, sharey=True, squeeze=False)
    for row, (name, episodes) in zip(panels, runs.items(), strict=True):
        for panel, parcel in zip(row, PARCELS, strict=True):
            _draw_line(panel, parcel)
            for speed, colour in zip(SHOWN_SPEEDS, _COLOURS, strict=True):
                _draw_path(panel, episodes, parcel, speed, colour)
            panel.set_title(f"{name}, {parcel}-box")
    for panel in panels[-1]:
        panel.set_xlabel("x [m]")
    for panel in panels[:, 0]:
        panel.set_ylabel("y [m]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(file, dpi=DOTS)


def _draw_line(panel: Axes, parcel: str) -> None:
    """Rotors, supports and the zone that obeys."""
    line = Line()
    rotor, (_, rows, first, columns) = line.site(box(parcel).base)
    row, column = np.mgrid[: line.rows, : line.columns]
    x = line.origin[0] + line.pitch_x * column
    y = line.origin[1] + line.pitch_y * row
    zone = line.column_edge(first), line.column_edge(first + columns)
    middle, half = line.line_y, 0.5 * line.pitch_y * rows
    panel.axvspan(*zone, color="#eef2f7", zorder=0)
    panel.axhspan(middle - half, middle + half, color="#dde3ea", zorder=0)
    panel.plot(x[~rotor], y[~rotor], ".", color="#c3ccd6", markersize=1.5)
    panel.plot(x[rotor], y[rotor], ".", color="#8795a5", markersize=4)
    panel.set(xlim=(0.0, 2.2), ylim=(LINE_Y - 0.35, LINE_Y + 0.85), aspect="equal")


def _draw_path(panel: Axes, episodes: Episodes, parcel: str, speed: float, colour: str) -> None:
    place = (PARCELS.index(parcel), int(np.argmin(np.abs(SORT_SPEEDS - speed))), SIDES.index(1))
    start = int(np.ravel_multi_index(place, GRID))
    style: dict[str, Any] = {"linestyle": "-" if episodes.success[start] else ":"}
    path = episodes.path(start)
    panel.plot(path[:, 0], path[:, 1], label=f"{speed:g} m/s", color=colour, linewidth=1.6, **style)
    x, y, theta = path[-1]
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    outline = box(parcel).base.outline @ turn + (x, y)
    panel.add_patch(Patch(outline, fill=False, edgecolor=colour, linewidth=1.0, **style))
