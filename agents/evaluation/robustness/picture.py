"""The picture of the sweep: success against each factor, a column a task, a line a contender.

Factors are rows, so that the picture is as wide as a page and can be read there.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...tasks import label_of
from ..contenders import FIXED, PLANNER
from ..plots import DOTS
from .factors import FACTORS, LAB, TRAINED, Factor
from .results import SHAPES, Sweep
from .tables import level_text

WIDTH, HEIGHT = 2.0, 1.35  # [inch] of a panel
NARROWEST = 9.0  # [inch] of the picture, which the legend needs
IN_LAB = ("all", "square", "rect.", "disc", "poly.")
INK, PALE = "#333333", "#8c8c8c"
# Colours that the colour-blind tell apart, of Okabe and Ito.
BLUE, ORANGE, GREEN, RED, PINK, SKY = (
    "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9",
)  # fmt: skip
ALGORITHMS = {"PPO": BLUE, "DQN": ORANGE, "PPO per module": GREEN}
OWN_RULES = ("event rule", "braking rule", "sliding mode", "turning rule")  # one a task
Dashes = Literal["-", "--", "-.", ":", "None"]


@dataclass(frozen=True)
class Look:
    """How a contender is drawn."""

    label: str  # in the legend; several may share one
    colour: str
    dashes: Dashes = "-"
    width: float = 1.6  # [pt]
    marker: str = "o"  # where levels are names
    above: int = 2  # what lies below it


LOOKS = {
    FIXED: Look(FIXED, PALE, ":", 1.3, "x"),
    "threshold logic": Look("threshold logic", PINK, ":", 1.3, "v"),
    "PID per module": Look("PID per module", SKY, ":", 1.3, "^"),
    **{name: Look(f"rule of the task ({', '.join(OWN_RULES)})", RED, "-.", 1.6, "s", 3)
       for name in OWN_RULES},
    **{name: Look(name, colour, "--", 1.2, "o", 4) for name, colour in ALGORITHMS.items()},
    PLANNER: Look(PLANNER, INK, "None", 1.0, "_", 6),
}  # fmt: skip


def look_of(who: str) -> Look:
    """How a contender is drawn; an agent for a condition has its algorithm's colour, and stands
    out.
    """
    algorithm, told, condition = who.partition(", ")
    if told and algorithm in ALGORITHMS:
        return Look(f"{algorithm}, trained for the {condition}", ALGORITHMS[algorithm], "-", 2.0,
                    "D", 5)  # fmt: skip
    return LOOKS.get(who, Look(who, INK, "--"))


def draw_sweep(sweep: Sweep, file: Path) -> None:
    """Draw all of it."""
    factors = [factor for factor in FACTORS.values() if factor.name != TRAINED]
    tasks = sweep.tasks
    figure = Figure(
        figsize=(max(NARROWEST, WIDTH * len(tasks) + 0.5), HEIGHT * len(factors) + 1.2),
        layout="constrained",
    )
    panels = figure.subplots(len(factors), len(tasks), squeeze=False, sharey=True)
    for row, factor in zip(panels, factors, strict=True):
        unit = f" [{factor.unit}]" if factor.unit else ""
        row[0].set_ylabel(f"{factor.label}{unit}", fontsize=9, color=INK)
        for panel, task in zip(row, tasks, strict=True):
            _draw_panel(panel, sweep, task, factor)
    for panel, task in zip(panels[0], tasks, strict=True):
        panel.set_title(label_of(task).capitalize(), fontsize=12, fontweight="bold", color=INK)
    looks = {look.label: look for look in map(look_of, sweep.contenders())}
    handles = [
        Line2D([], [], color=look.colour, linestyle=look.dashes, linewidth=look.width,
               marker=look.marker, markersize=5, label=look.label)
        for look in looks.values()
    ]  # fmt: skip
    figure.legend(
        handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9,
    )  # fmt: skip
    figure.savefig(file, dpi=DOTS)


def _draw_panel(panel: Axes, sweep: Sweep, task: str, factor: Factor) -> None:
    """Success at each level; where they have names, points beside each other."""
    names = sweep.contenders(task)
    drawn = False
    for place, who in enumerate(names):
        look = look_of(who)
        points = _points(sweep, task, who, factor)
        if not points:
            continue
        drawn = True
        x, rates = np.array(points).T
        aside = 0.7 * ((place + 0.5) / len(names) - 0.5) if factor.is_named else 0.0
        panel.plot(
            x + aside, rates, color=look.colour, linewidth=look.width, zorder=look.above,
            linestyle="None" if factor.is_named else look.dashes,
            marker=look.marker if factor.is_named or look.dashes == "None" else "",
            markersize=4.5, clip_on=False,
        )  # fmt: skip
    panel.set(ylim=(0.0, 1.0), yticks=(0.0, 0.5, 1.0))
    panel.tick_params(labelsize=8, colors=INK, length=2)
    panel.grid(color="#e9e9e9", linewidth=0.7)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color("#b0b0b0")
    if factor.trained is not None and not factor.is_named:
        panel.axvline(float(factor.trained), color="#c9c9c9", linewidth=2.5, zorder=1)
    if factor.is_named:
        ticks = _ticks(factor)
        panel.set_xlim(-0.5, len(ticks) - 0.5)
        panel.set_xticks(range(len(ticks)), ticks, fontsize=8)
    if not drawn:
        panel.axis("off")


def _ticks(factor: Factor) -> tuple[str, ...]:
    return IN_LAB if factor.name == LAB else tuple(map(level_text, factor.levels))


def _points(sweep: Sweep, task: str, who: str, factor: Factor) -> list[tuple[float, float]]:
    """Where on the panel each level lies, and the rate there; none for who was tried at no other
    than as trained.
    """
    if not any(sweep.rate(task, who, factor.name, level) for level in factor.swept):
        return []
    rates = [sweep.rate(task, who, factor.name, level) for level in factor.levels]
    if factor.name == LAB:
        shapes = sweep.by_shape(task, who)
        rates += [shapes.get(shape) for shape in SHAPES]
    places = range(len(rates)) if factor.is_named else map(float, factor.levels)
    return [
        (float(place), rate.value)
        for place, rate in zip(places, rates, strict=True)
        if rate is not None
    ]
