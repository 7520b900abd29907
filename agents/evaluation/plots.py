"""Plots of the comparison."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from surface_gym.conditions import CONDITIONS

from ..tasks import find_task, kind_of
from .sorting import GRID, slower_time
from .table import Summaries
from .trials import PARCELS, SORT_SPEEDS

DOTS = 150  # to the inch

# The figure whose distribution tells most of a task, its label, scale and the limit of success.
ERRORS: dict[str, tuple[str, str, float, float | None]] = {
    "slow": ("ratio_error", "error of the speed ratio", 1.0, 0.01),
    "stop": ("stop_error", "error of the place [mm]", 1e3, 5.0),
    "track": ("rms_error", "rms error across the path [mm]", 1e3, None),
    "orient": ("angle_error", "error of the angle [deg]", 180.0 / np.pi, 2.0),
}


def has_errors(task: str) -> bool:
    """Whether a task has a figure whose distribution is drawn."""
    return kind_of(task) in ERRORS or bool(find_task(task).figures)


def _contenders(task: str, summaries: Summaries) -> list[str]:
    return list(dict.fromkeys(who for of_task, who, _ in summaries if of_task == task))


def _colours(names: Sequence[str]) -> dict[str, tuple[float, ...]]:
    chosen = colormaps["viridis"](np.linspace(0.0, 0.92, len(names)))
    return {name: tuple(colour) for name, colour in zip(names, chosen, strict=True)}


def draw_success(task: str, summaries: Summaries, file: Path) -> None:
    """Success rates by condition with their 95 % intervals, a bar a contender."""
    names = _contenders(task, summaries)
    colours = _colours(names)
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    panel = figure.subplots()
    width = 0.84 / len(names)
    for k, name in enumerate(names):
        for place, condition in enumerate(CONDITIONS.values()):
            summary = summaries.get((task, name, condition.name))
            if summary is None:
                continue
            low, high = summary.interval
            x = place + (k - 0.5 * (len(names) - 1)) * width
            panel.bar(
                x, summary.rate, 0.92 * width, color=colours[name],
                label=name if condition.name == "exact" else None,
            )  # fmt: skip
            errors = [[max(0.0, summary.rate - low)], [max(0.0, high - summary.rate)]]
            panel.errorbar(x, summary.rate, errors, color="#333333", elinewidth=0.8)
    panel.set_xticks(range(len(CONDITIONS)), [condition.label for condition in CONDITIONS.values()])
    panel.set(ylim=(0.0, 1.03), ylabel="success")
    panel.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right center", frameon=False)
    figure.savefig(file, dpi=DOTS)


def draw_errors(task: str, summaries: Summaries, file: Path) -> None:
    """Share of starts by the size of their error, exact sensors."""
    kind = kind_of(task)
    first = find_task(task).figures[0]
    own = (first, first.replace("_", " "), 1.0, None)
    figure_name, label, scale, limit = ERRORS.get(kind, own)
    names = _contenders(task, summaries)
    colours = _colours(names)
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    panel = figure.subplots()
    errors = {
        name: np.sort(scale * summaries[task, name, "exact"].figure(figure_name).ravel())
        for name in names
    }
    for name, values in errors.items():
        share = np.arange(1, len(values) + 1) / len(values)
        panel.step(np.maximum(values, 1e-9), share, where="post", color=colours[name], label=name)
    if limit is not None:
        panel.axvline(limit, color="#be1848", linestyle="--", linewidth=1.0, label="success")
    everyone = np.concatenate(list(errors.values()))
    low, high = np.quantile(everyone[everyone > 0.0], (0.02, 1.0))
    panel.set(xscale="log", xlim=(low, high), ylim=(0.0, 1.0), xlabel=label, ylabel="of starts")
    panel.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right center", frameon=False)
    figure.savefig(file, dpi=DOTS)


def draw_sorting(task: str, summaries: Summaries, file: Path) -> None:
    """Time to sort by entry speed, the slower side of the first seed; no line where it fails."""
    names = [name for name in _contenders(task, summaries) if _is_whole(task, summaries, name)]
    colours = _colours(names)
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    panels = figure.subplots(1, len(PARCELS), sharey=True)
    for panel, parcel in zip(panels, PARCELS, strict=True):
        for name in names:
            time = slower_time(summaries[task, name, "exact"], parcel)[0]
            time = np.where(np.isfinite(time), time, np.nan)
            panel.plot(SORT_SPEEDS, time, color=colours[name], label=name, linewidth=1.6)
        panel.set(title=f"{parcel}-box", xlabel="entry speed [m/s]")
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(color="#eeeeee")
    panels[0].set(ylabel="time to sort [s]", ylim=(0.0, 3.0))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", frameon=False)
    figure.savefig(file, dpi=DOTS)


def _is_whole(task: str, summaries: Summaries, name: str) -> bool:
    starts = summaries[task, name, "exact"].success.shape[1]
    return starts == math.prod(GRID)
