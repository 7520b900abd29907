"""Plots of the comparison on flows."""

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from ..evaluation.plots import DOTS
from .cases import CURVE, LOADS, cases
from .contenders import FIXED
from .results import BOUND, Results

LIMIT = "#be1848"
INK = "#333333"

Colours = dict[str, tuple[float, ...]]


def _colours(names: tuple[str, ...]) -> Colours:
    chosen = colormaps["viridis"](np.linspace(0.0, 0.92, len(names)))
    return {name: tuple(colour) for name, colour in zip(names, chosen, strict=True)}


def draw_rates(results: Results, file: Path) -> None:
    """Rate delivered right against the load, a line a contender, with 95 % intervals."""
    colours = _colours(results.names)
    figure = Figure(figsize=(10.0, 4.4), layout="constrained")
    panel = figure.subplots()
    offered = CURVE.ceiling * np.array(LOADS)
    panel.plot([0.0, CURVE.ceiling], [0.0, CURVE.ceiling], color="#c3ccd6", linewidth=1.0)
    panel.annotate(
        "all that come", (0.5 * CURVE.ceiling, 0.5 * CURVE.ceiling), (-6, 4),
        textcoords="offset points", ha="right", color="#8795a5",
    )  # fmt: skip
    for name in results.names:
        points = [
            (load, each.rate, each.margin)
            for load, each in zip(offered, results.curve(name), strict=True)
            if each is not None
        ]
        if not points:
            continue
        load, rate, margin = np.array(points).T
        panel.errorbar(
            load, rate, margin, color=colours[name], label=name, marker="o", markersize=3.5,
            linewidth=1.6, elinewidth=0.9, capsize=2.0,
        )  # fmt: skip
    bound = results.rate(BOUND, CURVE)
    panel.axhline(bound, color=LIMIT, linestyle="--", linewidth=1.0, label=BOUND)
    panel.set(
        xlim=(0.0, 1.02 * CURVE.ceiling), ylim=(0.0, None),
        xlabel=f"parcels offered an hour ({CURVE.label}; up to the ceiling)",
        ylabel="delivered right an hour",
    )  # fmt: skip
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="#eeeeee")
    figure.legend(loc="outside right center", frameon=False)
    figure.savefig(file, dpi=DOTS)


def draw_capacities(results: Results, file: Path) -> None:
    """Capacities of all streams, exact: a bar a contender, the bound above them."""
    names = tuple(name for name in results.names if name != FIXED)
    colours = _colours(results.names)
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    panel = figure.subplots()
    streams = cases()
    width = 0.84 / len(names)
    for place, case in enumerate(streams):
        for k, name in enumerate(names):
            x = place + (k - 0.5 * (len(names) - 1)) * width
            cell = results.cell(name, case)
            label = name if place == 0 else None
            if cell is None or cell.capacity is None:
                panel.bar(x, 0.0, 0.92 * width, color=colours[name], label=label)
                panel.annotate(
                    "0" if cell is not None and cell.can else "cannot", (x, 0.0), (0, 3),
                    textcoords="offset points", ha="center", va="bottom", rotation=90, color=INK,
                    fontsize=8,
                )  # fmt: skip
                continue
            rate, margin = cell.capacity.rate, cell.capacity.margin
            panel.bar(x, rate, 0.92 * width, color=colours[name], label=label)
            panel.errorbar(x, rate, margin, color=INK, elinewidth=0.8)
        panel.hlines(
            results.rate(BOUND, case), place - 0.45, place + 0.45, color=LIMIT, linestyle="--",
            linewidth=1.2, label=BOUND if place == 0 else "_again",
        )  # fmt: skip
    panel.set_xticks(range(len(streams)), [case.label for case in streams])
    panel.set(ylabel="capacity [parcels/h]")
    panel.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right center", frameon=False)
    figure.savefig(file, dpi=DOTS)
