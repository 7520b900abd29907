"""Pictures of a search."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .sweep import Sweep
from .tried import PRUNED, Tried, best_of

DOTS = 150  # to the inch
BEST, COMPLETE, PRUNING = "#be1848", "#46327e", "#9a9a9a"  # colours


def draw_curves(sweep: Sweep, trials: Sequence[Tried], file: Path) -> None:
    """Values on the way, a line a trial: pruned ones dotted, the best bold; a dot at the end is the
    greedy policy's.
    """
    figure, panel = _panel()
    best = best_of(trials)
    for tried in trials:
        looks = sorted(tried.intermediate)
        steps = [_steps(sweep, look) for look in looks]
        values = [tried.intermediate[look] for look in looks]
        if tried == best:
            panel.plot(steps, values, color=BEST, linewidth=2.6, zorder=3)
        elif tried.state == PRUNED:
            panel.plot(steps, values, ":", color=PRUNING, linewidth=1.4)
            panel.plot(steps[-1:], values[-1:], "x", color=PRUNING)
        else:
            panel.plot(steps, values, color=COMPLETE, linewidth=1.0, alpha=0.6)
        if tried.value is not None:
            end = sweep.seeds * sweep.steps
            panel.plot([end], [tried.value], "o", color=BEST if tried == best else COMPLETE)
    _legend(
        panel,
        ("best", {"color": BEST, "linewidth": 2.6}),
        ("complete", {"color": COMPLETE, "linewidth": 1.0}),
        ("pruned", {"color": PRUNING, "linestyle": ":", "marker": "x"}),
        ("greedy, fresh starts", {"color": COMPLETE, "linestyle": "", "marker": "o"}),
    )
    of_each = "" if sweep.seeds == 1 else f", {sweep.seeds} seeds one after the other"
    panel.set(xlabel=f"control periods{of_each}", ylabel=sweep.metric, xlim=(0.0, None))
    panel.xaxis.set_major_formatter(lambda steps, _: f"{steps:,.0f}")
    figure.savefig(file, dpi=DOTS)


def draw_history(sweep: Sweep, trials: Sequence[Tried], file: Path) -> None:
    """Value of each trial by its number, a line through the best so far; pruned ones where they
    were pruned.
    """
    figure, panel = _panel()
    complete = [tried for tried in trials if tried.value is not None]
    numbers = [tried.number for tried in complete]
    values = np.array([tried.value for tried in complete], dtype=np.float64)
    pruned = [tried for tried in trials if tried.state == PRUNED]
    where = [tried.intermediate[max(tried.intermediate)] for tried in pruned]
    panel.plot(numbers, values, "o", color=COMPLETE)
    panel.plot([tried.number for tried in pruned], where, "x", color=PRUNING)
    if complete:
        so_far = np.maximum.accumulate(values)
        panel.step(
            [*numbers, len(trials) - 1], [*so_far, so_far[-1]], where="post", color=BEST, zorder=1
        )
    _legend(
        panel,
        ("best so far", {"color": BEST}),
        ("complete", {"color": COMPLETE, "linestyle": "", "marker": "o"}),
        ("pruned, its latest", {"color": PRUNING, "linestyle": "", "marker": "x"}),
    )
    panel.set(xlabel="trial", ylabel=sweep.metric, xlim=(-0.5, len(trials) - 0.5))
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.savefig(file, dpi=DOTS)


def draw_importance(shares: Mapping[str, float], file: Path) -> None:
    """A bar a hyper-parameter, the most important on top."""
    figure = Figure(figsize=(8.0, 0.8 + 0.35 * len(shares)), layout="constrained")
    panel = figure.subplots()
    names = list(shares)[::-1]
    bars = panel.barh(names, [shares[name] for name in names], 0.7, color=COMPLETE)
    panel.bar_label(bars, [f"{100.0 * shares[name]:.0f} %" for name in names], padding=4)
    panel.set(xlabel="importance", xlim=(0.0, 1.1 * max(shares.values())))
    panel.xaxis.set_major_formatter(lambda share, _: f"{100.0 * share:.0f} %")
    panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=DOTS)


def _panel() -> tuple[Figure, Axes]:
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    panel = figure.subplots()
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="#eeeeee")
    panel.set_axisbelow(True)
    return figure, panel


def _legend(panel: Axes, *entries: tuple[str, dict[str, Any]]) -> None:
    for label, style in entries:
        panel.plot([], [], label=label, **style)
    panel.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _steps(sweep: Sweep, look: int) -> float:
    """Control periods at a look, those of earlier seeds included."""
    seed, nth = divmod(look - 1, sweep.evaluations)
    return sweep.steps * (seed + (nth + 1) / (sweep.evaluations + 1))
