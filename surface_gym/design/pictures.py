"""What was found as pictures, by matplotlib: one a question."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter

from surface_gym.design.case import TOGETHER, WORST, Case
from surface_gym.design.columns import MOST, Columns
from surface_gym.design.limits import FrictionRange, Limits
from surface_gym.design.purposes import Purpose
from surface_gym.design.sensitivity import Sensitivity
from surface_gym.design.sweep import NOMINAL
from surface_gym.design.tables import group_told
from surface_gym.design.telling import (
    base_told,
    coming_told,
    field_told,
    purpose_met,
    purpose_told,
    surface_told,
)

DPI = 120
# Okabe and Ito's colours, told apart by the colour-blind; a line style each besides.
LINES: dict[str, tuple[str, Any]] = {
    NOMINAL: ("#999999", "-"),
    "friction": ("#E69F00", "--"),
    "load": ("#56B4E9", "-."),
    "unevenness": ("#009E73", ":"),
    "entry": ("#CC79A7", (0, (3, 1, 1, 1))),
    TOGETHER: ("#000000", "-"),
}
BLUE, ORANGE = "#0072B2", "#D55E00"


def draw_columns(
    case: Case, rows: int, found: Sequence[tuple[float, Columns]], own: Columns
) -> Figure:
    """Columns against entry speed; a band up to what all but `WORST` of the draws take.

    Args:
        case: what they are for.
        rows: of rotors.
        found: entry speeds [m/s] and what they take.
        own: what the case's own takes.
    """
    figure, axes = new_picture(
        f"How many columns to {purpose_told(case.purpose)}?",
        f"{base_told(case.parcel.base)}, {rows} rows, the study's layouts",
    )
    speed = np.array([each for each, _ in found])
    needed = _counts([each.columns for _, each in found])
    worst = _counts([_together(each) for _, each in found])
    axes.fill_between(
        speed, needed, worst, step="mid", color=BLUE, alpha=0.2, linewidth=0.0,
        label=f"more for {1.0 - WORST:.0%} of the draws",
    )  # fmt: skip
    axes.step(speed, worst, where="mid", color=BLUE, linestyle="--", linewidth=1.0)
    axes.step(
        speed, needed, where="mid", color=BLUE, linewidth=2.0, marker=".", label="nothing unknown"
    )
    top = max(4.0, 1.1 * float(np.nanmax([*needed, *worst, 1.0])))
    lost = np.isnan(needed)
    axes.plot(
        speed[lost], np.full(lost.sum(), 0.5), "x", color=ORANGE, clip_on=False,
        label=f"no number up to {MOST}",
    )  # fmt: skip
    unsure = ~lost & np.isnan(worst)
    axes.plot(
        speed[unsure], needed[unsure], "o", color=ORANGE, fillstyle="none", markersize=9,
        label=f"none does it in {1.0 - WORST:.0%} of the draws",
    )  # fmt: skip
    if own.columns is not None:
        axes.plot(case.speed, own.columns, "*", color="black", markersize=13, label="as it comes")
    axes.set(
        xlabel="entry speed [m/s]", ylabel="columns of the zone", ylim=(0.0, top), xlim=(0.0, None)
    )
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    figure.legend(**_shown(axes), loc="outside lower center", ncols=3)
    return figure


def draw_limits(question: str, limits: Limits) -> Figure:
    """Success against what is varied, a line a group of what is unknown."""
    case = limits.arrangement.case
    figure, axes = new_picture(question, _under(limits))
    _draw_curves(axes, limits)
    axes.set(xlabel=f"{limits.varied} [{limits.unit}]", ylabel="success")
    axes.axvline(limits.scale * limits.own, color="black", linewidth=0.8, linestyle=":")
    axes.annotate(
        f" {coming_told(case)}", (limits.scale * limits.own, 0.02), fontsize="small", rotation=90.0,
        ha="left", va="bottom", bbox={"color": "white", "alpha": 0.7, "pad": 0.5},
    )  # fmt: skip
    axes.legend(**_shown(axes))
    return figure


def draw_friction(found: FrictionRange) -> Figure:
    """Success against factors on mu_max and on mu_min."""
    case = found.along.arrangement.case
    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    title = f"How far may friction be off for it to {purpose_met(case.purpose)}?"
    figure.suptitle(f"{title}\n{_under(found.along)}", fontsize="medium")
    panels = figure.subplots(1, 2, sharey=True)
    own = (case.mu_max, case.mu_min)
    names = ("along axes, mu_max", "across axes, mu_min")
    for axes, limits, mu, name in zip(panels, (found.along, found.across), own, names, strict=True):
        _draw_curves(axes, limits)
        axes.set_xscale("log", base=2)
        axes.xaxis.set_major_formatter(FuncFormatter(_factor))
        axes.axvline(1.0, color="black", linewidth=0.8, linestyle=":")
        axes.set_xlabel(f"friction {name}, over {mu:g}")
    panels[0].set_ylabel("success")
    panels[1].legend(**_shown(panels[1]))
    return figure


def draw_sensitivity(found: Sensitivity) -> Figure:
    """What comes out, from `WORST` to 1 - `WORST` of the draws, a bar for each thing unknown."""
    case = found.arrangement.case
    purpose: Purpose = case.purpose
    figure, axes = new_picture(
        f"What matters most for it to {purpose_met(purpose)}?",
        f"{_who(case)} {coming_told(case)}; {surface_told(found.arrangement)}",
    )
    bars = sorted(found.bars, key=lambda bar: -1.0 if math.isnan(bar.high) else bar.high - bar.low)
    for k, bar in enumerate(bars):
        if math.isnan(bar.low):
            continue
        ends = purpose.scale * bar.low, purpose.scale * bar.high
        axes.barh(
            k, ends[1] - ends[0], left=ends[0], color=BLUE, alpha=0.45 if bar.usual else 1.0,
            height=0.6,
        )  # fmt: skip
        axes.plot(ends, (k, k), "|", color=BLUE, markersize=11)
    if not math.isnan(found.measure):
        axes.axvline(purpose.scale * found.measure, color="black", linewidth=1.2)
    axes.set_yticks(range(len(bars)), [field_told(bar) for bar in bars])
    right = axes.secondary_yaxis("right")
    right.set_yticks(range(len(bars)), [f"{bar.success:.0%}" for bar in bars])
    right.set_ylabel("success")
    axes.set_ylim(-0.6, len(bars) - 0.4)
    axes.margins(x=0.05)
    axes.use_sticky_edges = False
    axes.set_xlabel(
        f"{purpose.measured} [{purpose.unit}]; line: nothing unknown\n"
        f"bars: {WORST:.0%} to {1.0 - WORST:.0%} of the draws, each alone; "
        "pale: a usual spread, the case has none",
        fontsize="small",
    )
    return figure


def new_picture(title: str, under: str) -> tuple[Figure, Axes]:
    """A picture of one panel, with its question and what stands under it."""
    figure = Figure(figsize=(7.2, 4.8), layout="constrained")
    axes = figure.subplots()
    figure.suptitle(title)
    axes.set_title(under, fontsize="small")
    axes.grid(alpha=0.25)
    return figure, axes


def _draw_curves(axes: Axes, limits: Limits) -> None:
    for span in limits.spans:
        colour, style = LINES[span.group]
        values = limits.scale * span.values
        if span.group == NOMINAL:
            axes.fill_between(
                values, span.share, step="mid", color=colour, alpha=0.25, linewidth=0.0,
                label="nothing unknown",
            )  # fmt: skip
            continue
        axes.plot(
            values, span.share, color=colour, linestyle=style, label=group_told(span.group),
            linewidth=2.2 if span.group == TOGETHER else 1.5,
        )  # fmt: skip
    axes.axhline(1.0 - WORST, color=ORANGE, linewidth=0.8)
    axes.grid(alpha=0.25)
    axes.set_ylim(0.0, 1.03)
    axes.margins(x=0.0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _factor(value: float, _: Any) -> str:
    return f"{value:g}" if value >= 1.0 else f"1/{1.0 / value:g}"


def _who(case: Case) -> str:
    return base_told(case.parcel.base)


def _under(limits: Limits) -> str:
    arrangement = limits.arrangement
    return f"{_who(arrangement.case)}; {surface_told(arrangement)}"


def _counts(columns: Sequence[int | None]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([math.nan if each is None else each for each in columns], dtype=np.float64)


def _together(found: Columns) -> int | None:
    return found.worst[-1].columns if found.worst else found.columns


def _shown(axes: Axes) -> dict[str, Any]:
    """A legend of those that are drawn."""
    drawn = [
        (line, label)
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
        if not hasattr(line, "get_xdata") or len(line.get_xdata())
    ]
    handles, labels = zip(*drawn, strict=True)
    return {"handles": handles, "labels": labels, "fontsize": "small", "framealpha": 0.9}
