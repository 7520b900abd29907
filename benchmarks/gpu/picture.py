"""Decisions a second against lanes, drawn."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from benchmarks.gpu.windows import Rate

DOTS = 150  # to the inch


def draw(rates: Sequence[Rate], file: Path) -> None:
    """A line for what was measured with several numbers of lanes, a dashed level for what was
    measured with one, such as the CPU.
    """
    names = list(dict.fromkeys(rate.name for rate in rates))
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    panel = figure.subplots()
    colours = colormaps["viridis"](np.linspace(0.0, 0.92, len(names)))
    for name, colour in zip(names, colours, strict=True):
        own = sorted((rate.lanes, rate.decisions) for rate in rates if rate.name == name)
        if len(own) == 1:
            panel.axhline(own[0][1], color=colour, linestyle="--", linewidth=1.0, label=name)
        else:
            panel.plot(*zip(*own, strict=True), "o-", color=colour, label=name)
    panel.set(xscale="log", yscale="log", xlabel="lanes", ylabel="decisions a second")
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(which="major", color="#dddddd", linewidth=0.6)
    figure.legend(loc="outside right center", frameon=False)
    figure.savefig(file, dpi=DOTS)
