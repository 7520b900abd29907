"""Tables and the picture of the sweep of robustness.

The picture has a column for each task and a line for each method. Factors are rows, so that it is
as wide as a page and can be read there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.console import Console

from ..library import task_label
from . import methods, plots
from .robustness import FACTORS, LAB, SHAPES, TRAINED, Factor, Level, Rate, Sweep, SweepResult
from .tables import NOTHING, Table, write_markdown, write_numbers

PICTURE = "robustness.png"
TITLE = "# Robustness\n\nSuccess where one thing at a time differs from training.\n\n"
WIDTH, HEIGHT = 2.0, 1.35  # [inch] of a panel
NARROWEST = 9.0  # [inch] of the picture, which the legend needs
IN_LAB = ("all", "square", "rect.", "disc", "poly.")
ALGORITHMS = {"PPO": plots.BLUE, "DQN": plots.ORANGE, "PPO per module": plots.GREEN}
OWN_RULES = ("event rule", "braking rule", "sliding mode", "turning rule")  # one for each task


@dataclass(frozen=True)
class Style:
    """The line of a method."""

    label: str  # in the legend; several may share one
    colour: str
    dashes: Literal["-", "--", "-.", ":", "None"] = "-"
    width: float = 1.6  # [pt]
    marker: str = "o"  # where levels are names
    above: int = 2  # what lies below it


STYLES = {
    methods.FIXED: Style(methods.FIXED, "#8c8c8c", ":", 1.3, "x"),
    "threshold logic": Style("threshold logic", plots.PINK, ":", 1.3, "v"),
    "PID per module": Style("PID per module", plots.SKY, ":", 1.3, "^"),
    **{name: Style(f"rule of the task ({', '.join(OWN_RULES)})", plots.RED, "-.", 1.6, "s", 3)
       for name in OWN_RULES},
    **{name: Style(name, colour, "--", 1.2, "o", 4) for name, colour in ALGORITHMS.items()},
    methods.PLANNER: Style(methods.PLANNER, plots.INK, "None", 1.0, "_", 6),
}  # fmt: skip


def write_sweep(rows: Sequence[SweepResult], folder: Path, console: Console) -> None:
    """Write robustness.md, .csv, .json and .png into a folder, and show the tables."""
    sweep = Sweep(tuple(rows))
    made = (factor_table, square_table, shape_table)
    tables = [make(sweep, task) for task in sweep.tasks for make in made]
    write_markdown(tables, folder / "robustness.md", TITLE)
    write_numbers(sweep_numbers(sweep), folder / "robustness.csv", folder / "robustness.json")
    draw_sweep(sweep, folder / PICTURE)
    for table in tables:
        table.show(console)


def factor_table(sweep: Sweep, task: str) -> Table:
    """Make a row for each method, a column for each factor with some of its levels."""
    names = sweep.methods(task)
    factors = [
        factor
        for factor in FACTORS.values()
        if any(sweep.rate(task, name, factor.name, factor.shown[0]) for name in names)
    ]

    def text(name: str, factor: Factor) -> str:
        rates = [sweep.rate(task, name, factor.name, level) for level in factor.shown]
        return " / ".join(map(_text, rates))

    return Table(
        task_label(task),
        f"success of {_starts(sweep, task)}, one factor changed at a time",
        ("controller", *map(_heading, factors)),
        tuple((name, *(text(name, factor) for factor in factors)) for name in names),
    )


def _heading(factor: Factor) -> str:
    if len(factor.shown) == 1:
        return factor.label
    levels = " / ".join(map(_level, factor.shown))
    return f"{factor.label}: {levels} {factor.unit}".rstrip()


def _level(level: Level) -> str:
    return level if isinstance(level, str) else f"{level:g}"


def _text(rate: Rate | None) -> str:
    return NOTHING if rate is None else f"{rate.value:.2f}"


def _starts(sweep: Sweep, task: str) -> str:
    """Say in words how many starts each method ran on."""
    counts: dict[int, list[str]] = {}
    for row in sweep.rows:
        if row.task == task and row.method not in counts.setdefault(row.starts, []):
            counts[row.starts].append(row.method)
    most = max(counts)
    fewer = [f"{', '.join(names)}: {count}" for count, names in counts.items() if count != most]
    return f"{most} starts" + (f" ({'; '.join(fewer)})" if fewer else "")


def square_table(sweep: Sweep, task: str) -> Table:
    """Make a row for each method: the worst square, and success beside the planner's."""
    squares = FACTORS["square"]
    rows = []
    for name in sweep.methods(task):
        rates = {
            level: rate
            for level in squares.levels
            if (rate := sweep.rate(task, name, "square", level)) is not None
        }
        if not rates:
            continue
        worst = min(rates, key=lambda level: rates[level].value)
        found = [_share_of_planner(sweep, task, name, level) for level in rates]
        shares = [share for share in found if share is not None]
        rows.append(
            (
                name,
                f"{rates[worst].value:.2f} at {_level(worst)}",
                f"{sum(rate.value for rate in rates.values()) / len(rates):.2f}",
                f"{min(shares):.2f}" if shares else NOTHING,
            )
        )
    return Table(
        f"{task_label(task)}: squares",
        f"success on squares of {squares.levels[0]:g} to {squares.levels[-1]:g} m; beside the "
        "planner's on the starts and sizes that it ran on",
        ("controller", "worst, at [m]", "mean over sizes", "least share of the planner's"),
        tuple(rows),
    )


def _share_of_planner(sweep: Sweep, task: str, name: str, level: Level) -> float | None:
    """Compare with the planner on its starts; None where it did not run or never succeeded."""
    planned = sweep.success(task, methods.PLANNER, "square", level)
    success = sweep.success(task, name, "square", level)
    if planned is None or success is None or not planned.any():
        return None
    return float(success[:, : planned.shape[1]].mean() / planned.mean())


def shape_table(sweep: Sweep, task: str) -> Table:
    """Make a row for each method, a column for each shape of the lab's parcels."""
    rows = []
    for name in sweep.methods(task):
        shapes = sweep.by_shape(task, name)
        if not shapes:
            continue
        whole = sweep.rate(task, name, LAB, LAB)
        assert whole is not None
        interval = f"{whole.value:.3f} ({whole.low:.3f}-{whole.high:.3f})"
        rows.append((name, interval, *(_text(shapes.get(shape)) for shape in SHAPES)))
    header = ("controller", "success (95 % interval)", *SHAPES)
    return Table(f"{task_label(task)}: lab", "success in the lab, by shape", header, tuple(rows))


def sweep_numbers(sweep: Sweep) -> list[dict[str, Any]]:
    """List every rate, a row for each."""
    rows = []
    for task in sweep.tasks:
        for name in sweep.methods(task):
            for factor in FACTORS.values():
                for level in factor.levels:
                    rate = sweep.rate(task, name, factor.name, level)
                    error = sweep.error(task, name, factor.name, level)
                    if rate is not None:
                        rows.append(_row(task, name, factor, level, rate, error))
            for shape, rate in sweep.by_shape(task, name).items():
                rows.append(_row(task, name, FACTORS[LAB], shape, rate, None))
    return rows


def _row(
    task: str, name: str, factor: Factor, level: Level, rate: Rate, error: float | None
) -> dict[str, Any]:
    return {
        "task": task,
        "controller": name,
        "factor": factor.name,
        "level": level,
        "unit": factor.unit,
        "seeds": rate.seeds,
        "starts": rate.starts,
        "success": rate.value,
        "success_low": rate.low,
        "success_high": rate.high,
        "median_error": error,
    }


def find_style(name: str) -> Style:
    """Find the line of a method; an agent for a preset stands out in its algorithm's colour."""
    algorithm, comma, preset = name.partition(", ")
    if comma and algorithm in ALGORITHMS:
        label = f"{algorithm}, trained for the {preset}"
        return Style(label, ALGORITHMS[algorithm], "-", 2.0, "D", 5)
    return STYLES.get(name, Style(name, plots.INK, "--"))


def draw_sweep(sweep: Sweep, file: Path) -> None:
    """Draw success against each factor."""
    factors = [factor for factor in FACTORS.values() if factor.name != TRAINED]
    tasks = sweep.tasks
    figure = Figure(
        figsize=(max(NARROWEST, WIDTH * len(tasks) + 0.5), HEIGHT * len(factors) + 1.2),
        layout="constrained",
    )
    panels = figure.subplots(len(factors), len(tasks), squeeze=False, sharey=True)
    for row, factor in zip(panels, factors, strict=True):
        unit = f" [{factor.unit}]" if factor.unit else ""
        row[0].set_ylabel(f"{factor.label}{unit}", fontsize=9, color=plots.INK)
        for panel, task in zip(row, tasks, strict=True):
            _draw_panel(panel, sweep, task, factor)
    for panel, task in zip(panels[0], tasks, strict=True):
        panel.set_title(
            task_label(task).capitalize(), fontsize=12, fontweight="bold", color=plots.INK
        )
    styles = {style.label: style for style in map(find_style, sweep.methods())}
    handles = [
        Line2D([], [], color=style.colour, linestyle=style.dashes, linewidth=style.width,
               marker=style.marker, markersize=5, label=style.label)
        for style in styles.values()
    ]  # fmt: skip
    figure.legend(
        handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9,
    )  # fmt: skip
    figure.savefig(file, dpi=plots.DOTS)


def _draw_panel(panel: Axes, sweep: Sweep, task: str, factor: Factor) -> None:
    """Draw success at each level; where levels are names, points beside each other."""
    names = sweep.methods(task)
    drawn = False
    for place, name in enumerate(names):
        style = find_style(name)
        points = _points(sweep, task, name, factor)
        if not points:
            continue
        drawn = True
        x, rates = np.array(points).T
        aside = 0.7 * ((place + 0.5) / len(names) - 0.5) if factor.is_named else 0.0
        panel.plot(
            x + aside, rates, color=style.colour, linewidth=style.width, zorder=style.above,
            linestyle="None" if factor.is_named else style.dashes,
            marker=style.marker if factor.is_named or style.dashes == "None" else "",
            markersize=4.5, clip_on=False,
        )  # fmt: skip
    panel.set(ylim=(0.0, 1.0), yticks=(0.0, 0.5, 1.0))
    panel.tick_params(labelsize=8, colors=plots.INK, length=2)
    panel.grid(color="#e9e9e9", linewidth=0.7)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color("#b0b0b0")
    if factor.trained is not None and not factor.is_named:
        panel.axvline(float(factor.trained), color="#c9c9c9", linewidth=2.5, zorder=1)
    if factor.is_named:
        ticks = IN_LAB if factor.name == LAB else tuple(map(_level, factor.levels))
        panel.set_xlim(-0.5, len(ticks) - 0.5)
        panel.set_xticks(range(len(ticks)), ticks, fontsize=8)
    if not drawn:
        panel.axis("off")


def _points(sweep: Sweep, task: str, name: str, factor: Factor) -> list[tuple[float, float]]:
    """Find where on the panel each level lies, and its rate; none if only the trained one ran."""
    if not any(sweep.rate(task, name, factor.name, level) for level in factor.swept):
        return []
    rates = [sweep.rate(task, name, factor.name, level) for level in factor.levels]
    if factor.name == LAB:
        shapes = sweep.by_shape(task, name)
        rates += [shapes.get(shape) for shape in SHAPES]
    places = range(len(rates)) if factor.is_named else map(float, factor.levels)
    return [
        (float(place), rate.value)
        for place, rate in zip(places, rates, strict=True)
        if rate is not None
    ]
