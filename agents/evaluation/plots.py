"""Plots of the comparison: success, errors, times, trajectories and capacities."""

import math
from collections.abc import Iterable, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon as Patch

import surface_gym as sg
from surface_gym.config import PRESETS
from surface_gym.tasks.benchmark import PARCELS, SIDES, ErrorPlot, SpeedGrid

from ..rollout import Episodes
from .benchmark import Summaries
from .streams import BEST, CANNOT, ENTRANCE, SIX_MODULES, StreamResults, cases
from .tables import list_methods

DOTS = 150  # to the inch
LIMIT, INK, PALE = "#be1848", "#333333", "#eeeeee"
# Colours that the colour-blind tell apart, of Okabe and Ito.
BLUE, ORANGE, GREEN, RED, PINK, SKY = (
    "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9",
)  # fmt: skip
PALETTE = (BLUE, ORANGE, GREEN, PINK, INK, SKY, RED, "#999999", "#882255", "#a5a12c")
SHOWN_SPEEDS = {  # [m/s] one trajectory each, by colour
    0.4: "#440154", 0.6: "#3b528b", 0.8: "#21918c", 1.2: "#5ec962", 2.0: "#c9a227",
}  # fmt: skip


def choose_colours(names: Iterable[str]) -> dict[str, str]:
    """Choose a colour for each name; the first of them differ most."""
    return dict(zip(names, cycle(PALETTE), strict=False))


def _save(figure: Figure, file: Path, *panels: Axes, legend: Axes | None = None) -> None:
    """Write a figure with a legend at its right; `legend` says whose lines, if not everyone's."""
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
    handles: Sequence[Any] = () if legend is None else legend.get_legend_handles_labels()
    figure.legend(*handles, loc="outside right center", frameon=False)
    figure.savefig(file, dpi=DOTS)


def draw_success(task: str, summaries: Summaries, file: Path) -> None:
    """Draw success rates by preset with their 95 % intervals, a bar for each method."""
    names = list_methods(task, summaries)
    colours = choose_colours(names)
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    panel = figure.subplots()
    width = 0.84 / len(names)
    for k, name in enumerate(names):
        for place, preset in enumerate(PRESETS):
            summary = summaries.get((task, name, preset))
            if summary is None:
                continue
            low, high = summary.interval
            x = place + (k - 0.5 * (len(names) - 1)) * width
            label = name if preset == "exact" else None
            panel.bar(x, summary.rate, 0.92 * width, color=colours[name], label=label)
            errors = [[max(0.0, summary.rate - low)], [max(0.0, high - summary.rate)]]
            panel.errorbar(x, summary.rate, errors, color=INK, elinewidth=0.8)
    panel.set_xticks(range(len(PRESETS)), [preset.label for preset in PRESETS.values()])
    panel.set(ylim=(0.0, 1.03), ylabel="success")
    _save(figure, file, panel)


def draw_errors(task: str, error: ErrorPlot, summaries: Summaries, file: Path) -> None:
    """Draw the share of starts by the size of their error, exact sensors."""
    names = list_methods(task, summaries)
    colours = choose_colours(names)
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    panel = figure.subplots()
    errors = {
        name: np.sort(error.scale * summaries[task, name, "exact"].metric(error.metric).ravel())
        for name in names
    }
    for name, values in errors.items():
        share = np.arange(1, len(values) + 1) / len(values)
        panel.step(np.maximum(values, 1e-9), share, where="post", color=colours[name], label=name)
    if error.limit is not None:
        panel.axvline(error.limit, color=LIMIT, linestyle="--", linewidth=1.0, label="success")
    everyone = np.concatenate(list(errors.values()))
    low, high = np.quantile(everyone[everyone > 0.0], (0.02, 1.0))
    panel.set(
        xscale="log", xlim=(low, high), ylim=(0.0, 1.0), xlabel=error.label, ylabel="of starts"
    )
    _save(figure, file, panel)


def draw_times(task: str, grid: SpeedGrid, summaries: Summaries, file: Path) -> None:
    """Draw the time of success by entry speed, the slower side of the first seed.

    A line has gaps where the method fails; methods that did not run on all starts have none.
    """
    runs = {name: summaries[task, name, "exact"] for name in list_methods(task, summaries)}
    count = math.prod(grid.shape)
    whole = {name: each for name, each in runs.items() if each.success.shape[1] == count}
    colours = choose_colours(whole)
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    panels = figure.subplots(1, len(PARCELS), sharey=True)
    for panel, parcel in zip(panels, PARCELS, strict=True):
        for name, summary in whole.items():
            time = grid.slower_time(summary, parcel)[0]
            time = np.where(np.isfinite(time), time, np.nan)
            panel.plot(grid.speeds, time, color=colours[name], label=name, linewidth=1.6)
        panel.set(title=f"{parcel}-box", xlabel="entry speed [m/s]")
        panel.grid(color=PALE)
    panels[0].set(ylabel="time to sort [s]", ylim=(0.0, 3.0))
    _save(figure, file, *panels, legend=panels[0])


def draw_trajectories(grid: SpeedGrid, runs: dict[str, Episodes], file: Path) -> None:
    """Draw trajectories to y > 0 by entry speed: a row a method, a column a parcel."""
    figure = Figure(figsize=(12.0, 3.4 * len(runs)), layout="constrained")
    panels = figure.subplots(len(runs), len(PARCELS), sharex=True, sharey=True, squeeze=False)
    for row, (name, episodes) in zip(panels, runs.items(), strict=True):
        for panel, parcel in zip(row, PARCELS, strict=True):
            _draw_line(panel, parcel)
            for speed, colour in SHOWN_SPEEDS.items():
                at = (PARCELS.index(parcel), int(np.argmin(np.abs(grid.speeds - speed))))
                start = int(np.ravel_multi_index((*at, SIDES.index(1)), grid.shape))
                _draw_path(panel, episodes, start, parcel, colour, f"{speed:g} m/s")
            panel.set_title(f"{name}, {parcel}-box")
    for panel in panels[-1]:
        panel.set_xlabel("x [m]")
    for panel in panels[:, 0]:
        panel.set_ylabel("y [m]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(file, dpi=DOTS)


def _draw_line(panel: Axes, parcel: str) -> None:
    """Draw rotors, supports and the zone that obeys."""
    line = sg.lines.Line()
    rotor, (_, rows, first, columns) = line.site(sg.layouts.box(parcel).base)
    row, column = np.mgrid[: line.rows, : line.columns]
    x = line.origin[0] + line.pitch_x * column
    y = line.origin[1] + line.pitch_y * row
    zone = line.column_edge(first), line.column_edge(first + columns)
    middle, half = line.line_y, 0.5 * line.pitch_y * rows
    panel.axvspan(*zone, color="#eef2f7", zorder=0)
    panel.axhspan(middle - half, middle + half, color="#dde3ea", zorder=0)
    panel.plot(x[~rotor], y[~rotor], ".", color="#c3ccd6", markersize=1.5)
    panel.plot(x[rotor], y[rotor], ".", color="#8795a5", markersize=4)
    panel.set(
        xlim=(0.0, 2.2), ylim=(sg.layouts.LINE_Y - 0.35, sg.layouts.LINE_Y + 0.85), aspect="equal"
    )


def _draw_path(
    panel: Axes, episodes: Episodes, start: int, parcel: str, colour: str, label: str
) -> None:
    style: dict[str, Any] = {"linestyle": "-" if episodes.success[start] else ":"}
    path = episodes.path(start)
    panel.plot(path[:, 0], path[:, 1], label=label, color=colour, linewidth=1.6, **style)
    x, y, theta = path[-1]
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    outline = sg.layouts.box(parcel).base.outline @ turn + (x, y)
    panel.add_patch(Patch(outline, fill=False, edgecolor=colour, linewidth=1.0, **style))


def draw_capacities(results: StreamResults, file: Path, exits: str = "sides") -> None:
    """Draw the capacities of all streams, exact: a bar for each method, the bounds above them."""
    colours = choose_colours(results.names)
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    panel = figure.subplots()
    streams = cases(exits=exits)
    width = 0.84 / len(results.names)
    for place, case in enumerate(streams):
        for k, name in enumerate(results.names):
            x = place + (k - 0.5 * (len(results.names) - 1)) * width
            row = results.find(name, case)
            label = name if place == 0 else None
            rate = results.rate(name, case) if row is not None else 0.0
            panel.bar(x, rate, 0.92 * width, color=colours[name], label=label)
            if row is None or row.capacity is None:
                panel.annotate(
                    "0" if row is not None and row.actuators else CANNOT, (x, 0.0), (0, 3),
                    textcoords="offset points", ha="center", va="bottom", rotation=90, color=INK,
                    fontsize=8,
                )  # fmt: skip
            else:
                panel.errorbar(x, rate, row.capacity.margin, color=INK, elinewidth=0.8)
        row = results.find(SIX_MODULES, case)
        best = None if row is None else row.best
        for name, bound, style in (
            (ENTRANCE, case.ceiling, "-"), (BEST.format(SIX_MODULES), best, "--"),
        ):  # fmt: skip
            if bound is not None:
                panel.hlines(
                    bound, place - 0.45, place + 0.45, color=LIMIT, linestyle=style, linewidth=1.2,
                    label=name if place == 0 else "_again",
                )  # fmt: skip
    panel.set_xticks(range(len(streams)), [case.label for case in streams])
    panel.set(ylabel="capacity [parcels/h]")
    _save(figure, file, panel)
