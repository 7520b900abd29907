"""Views of results with one parcel: tables, and all numbers."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from surface_gym.config import PRESETS
from surface_gym.tasks.benchmark import PARCELS, ResultColumn

from ..base import Booleans
from ..library import task_label
from .method import FIXED, PLANNER, start_benchmark
from .results import Results, Sample, interval
from .robustness import FACTORS, LAB, SHAPES, Factor, Level, scenario_name
from .scenario import STARTS
from .tables import NOTHING, Table

SHOWN_SPEEDS = np.arange(3, 28, 2) / 10.0  # [m/s] entry speeds in the table


def task_table(task: str, results: Results) -> Table:
    """Make the table of a task: success by method and preset, and the task's columns."""
    benchmark = start_benchmark(task)
    ran = {key[2] for key, _ in results.among(task, STARTS)}
    shown = [preset for preset in PRESETS.values() if preset.name in ran and preset.name != "exact"]
    header = (
        "controller", "seeds", "success (95 % interval)", *(preset.label for preset in shown),
        *(column.label for column in benchmark.columns),
    )  # fmt: skip
    rows = []
    for method in results.methods(task, STARTS):
        exact, fixed = (results.find(task, STARTS, "exact", name) for name in (method, FIXED))
        if exact is None or fixed is None:
            continue
        starts = exact.success.shape[1]
        fewer = starts != fixed.success.shape[1]
        others = (results.find(task, STARTS, preset.name, method) for preset in shown)
        rows.append(
            (
                f"{method} ({starts} starts)" if fewer else method, str(len(exact.seeds)),
                _with_interval(exact),
                *(NOTHING if each is None else f"{each.rate:.3f}" for each in others),
                *(_text(column, exact, fixed) for column in benchmark.columns),
            )
        )  # fmt: skip
    return Table(task_label(task), benchmark.description, header, tuple(rows))


def column_value(column: ResultColumn, sample: Sample, fixed: Sample) -> float:
    """Compute a column's unscaled number, relative to the fixed layout's results.

    NaN if it is undefined: some columns need every start of both boxes.
    """
    fewer = sample.success.shape[1] != fixed.success.shape[1]
    others = bool(PRESETS[str(sample.rows["preset"].iloc[0])].parcels)
    if column.every_start and (fewer or others):
        return math.nan
    return column.value(sample, fixed)


def _with_interval(sample: Sample) -> str:
    low, high = sample.interval
    return f"{sample.rate:.3f} ({low:.3f}-{high:.3f})"


def _text(column: ResultColumn, sample: Sample, fixed: Sample) -> str:
    return format_value(column, column_value(column, sample, fixed))


def format_value(column: ResultColumn, value: float) -> str:
    """Return a column's number as text in its unit."""
    if math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "fails"
    return format(column.scale * value, column.form) + column.unit


def task_numbers(task: str, results: Results) -> list[dict[str, Any]]:
    """List every number of a task, a row for each."""
    columns = start_benchmark(task).columns
    rows = []
    for (_, scenario, preset, method), sample in results.among(task, STARTS):
        fixed = results.find(task, STARTS, preset, FIXED)
        low, high = sample.interval
        values = {"success": sample.rate, "success_low": low, "success_high": high}
        if fixed is not None:
            values |= {column.name: column_value(column, sample, fixed) for column in columns}
        rows += numbers((task, scenario, preset, method), sample, values)
    return rows


def numbers(
    key: tuple[str, str, str, str], sample: Sample, values: dict[str, float]
) -> list[dict[str, Any]]:
    """Return one row per number of a sample."""
    names = dict(zip(("task", "scenario", "preset", "method"), key, strict=True))
    count = {"seeds": len(sample.seeds), "episodes": len(sample.rows) // len(sample.seeds)}
    return [{**names, **count, "metric": name, "value": each} for name, each in values.items()]


def speed_tables(task: str, results: Results) -> list[Table]:
    """Make tables of the time of success by entry speed, for tasks with a grid of speeds."""
    grid, fixed = start_benchmark(task).grid, results.find(task, STARTS, "exact", FIXED)
    if grid is None or fixed is None or fixed.success.shape[1] != math.prod(grid.shape):
        return []
    samples = {
        key[3]: sample
        for key, sample in results.among(task, STARTS)
        if key[2] == "exact" and sample.kind != PLANNER
    }
    pairs = [(parcel, name) for parcel in PARCELS for name in samples]

    def time(name: str, parcel: str, speed: float) -> str:
        place = int(np.argmin(np.abs(grid.speeds - speed)))
        slowest = float(grid.slower_time(samples[name], parcel)[:, place].max())
        if np.isfinite(slowest):
            return f"{slowest:.3f}"
        some = grid.success(samples[name], parcel)[:, place].any()
        return "some seeds" if some else "fails"

    rows = [
        (f"{speed:.1f}", *(time(name, parcel, speed) for parcel, name in pairs))
        for speed in SHOWN_SPEEDS
    ]
    least = [grid.minimum_speed(samples[name], parcel) for parcel, name in pairs]
    rates = [grid.success_rate(samples[name], parcel) for parcel, name in pairs]
    rows.append(("minimum [m/s]", *(NOTHING if np.isnan(v) else f"{v:.2f}" for v in least)))
    rows.append(("success", *(f"{rate:.3f}" for rate in rates)))
    speeds = grid.speeds
    table = Table(
        "sorting by entry speed",
        "time to sort [s], the slower of both sides and the slowest seed; minimum and success over "
        f"{len(speeds)} speeds from {speeds[0]:g} to {speeds[-1]:g} m/s",
        ("entry speed [m/s]", *(f"{parcel}-box, {name}" for parcel, name in pairs)),
        tuple(rows),
    )
    return [table]


def decision_table(tasks: Sequence[str], results: Results) -> Table:
    """Make the table of decision times by method and task, with exact sensors.

    Times differ from run to run. This table has its own file, so that the other tables can be
    compared byte by byte.
    """

    def time(task: str, method: str) -> str:
        sample = results.find(task, STARTS, "exact", method)
        return NOTHING if sample is None else f"{1e6 * sample.decision_time:.1f}"

    methods = dict.fromkeys(name for task in tasks for name in results.methods(task, STARTS))
    return Table(
        "decisions",
        "time of one decision in one environment [us], decided many at a time, median; it differs "
        "from run to run, as nothing else here does",
        ("controller", *map(task_label, tasks)),
        tuple((method, *(time(task, method) for task in tasks)) for method in methods),
    )


class Sweep:
    """Results of the robustness study of one task."""

    def __init__(self, task: str, results: Results) -> None:
        self.task = task
        found: dict[tuple[str, str], Sample] = {}
        for (_, scenario, _, method), sample in results.among(task):
            if scenario != STARTS:
                found[scenario, method] = sample
        self._found = found
        self.methods = list(dict.fromkeys(method for _, method in found))

    def find(self, method: str, factor: str, level: Level) -> Sample | None:
        """Return the sample of a method at a level; None if it did not run."""
        return self._found.get((scenario_name(factor, level), method))

    def success(self, method: str, factor: str, level: Level) -> Booleans | None:
        """Return successes (seeds, starts); None if the method did not run."""
        sample = self.find(method, factor, level)
        return None if sample is None else sample.success

    def rate(self, method: str, factor: str, level: Level) -> float | None:
        """Return the success rate; None if the method did not run."""
        sample = self.find(method, factor, level)
        return None if sample is None else sample.rate

    def by_shape(self, method: str) -> dict[str, Booleans]:
        """Return successes in the lab by shape of the parcel, for drawn shapes."""
        sample = self.find(method, LAB, LAB)
        if sample is None:
            return {}
        success = sample.success
        shape = sample.rows["shape"].to_numpy()[: success.shape[1]]
        return {each: success[:, shape == each] for each in SHAPES if each in shape}


def sweep_tables(task: str, results: Results) -> list[Table]:
    """Make the tables of a task's robustness study."""
    sweep = Sweep(task, results)
    made: tuple[Callable[[Sweep], Table], ...] = (factor_table, square_table, shape_table)
    return [make(sweep) for make in made] if sweep.methods else []


def factor_table(sweep: Sweep) -> Table:
    """Make the table of success by method and factor."""
    names = sweep.methods
    factors = [
        factor
        for factor in FACTORS.values()
        if any(sweep.find(name, factor.name, factor.shown[0]) is not None for name in names)
    ]

    def text(name: str, factor: Factor) -> str:
        rates = [sweep.rate(name, factor.name, level) for level in factor.shown]
        return " / ".join(map(_share, rates))

    return Table(
        task_label(sweep.task),
        f"success of {_starts(sweep)}, one factor changed at a time",
        ("controller", *map(_heading, factors)),
        tuple((name, *(text(name, factor) for factor in factors)) for name in names),
    )


def _heading(factor: Factor) -> str:
    if len(factor.shown) == 1:
        return factor.label
    levels = " / ".join(map(level_text, factor.shown))
    return f"{factor.label}: {levels} {factor.unit}".rstrip()


def level_text(level: Level) -> str:
    """Return a level as text."""
    return level if isinstance(level, str) else f"{level:g}"


def _share(rate: float | None) -> str:
    return NOTHING if rate is None else f"{rate:.2f}"


def _starts(sweep: Sweep) -> str:
    """Return the numbers of starts by method as text."""
    counts: dict[int, list[str]] = {}
    for name in sweep.methods:
        sample = next(each for (_, method), each in sweep._found.items() if method == name)
        counts.setdefault(sample.success.shape[1], []).append(name)
    most = max(counts)
    fewer = [f"{', '.join(names)}: {count}" for count, names in counts.items() if count != most]
    return f"{most} starts" + (f" ({'; '.join(fewer)})" if fewer else "")


def square_table(sweep: Sweep) -> Table:
    """Make the table of squares: worst size, and success relative to the planner, by method."""
    squares = FACTORS["square"]
    rows = []
    for name in sweep.methods:
        rates = {
            level: rate
            for level in squares.levels
            if (rate := sweep.rate(name, "square", level)) is not None
        }
        if not rates:
            continue
        worst = min(rates, key=lambda level: rates[level])
        found = [_share_of_planner(sweep, name, level) for level in rates]
        shares = [share for share in found if share is not None]
        rows.append(
            (
                name,
                f"{rates[worst]:.2f} at {level_text(worst)}",
                f"{sum(rates.values()) / len(rates):.2f}",
                f"{min(shares):.2f}" if shares else NOTHING,
            )
        )
    return Table(
        f"{task_label(sweep.task)}: squares",
        f"success on squares of {squares.levels[0]:g} to {squares.levels[-1]:g} m; beside the "
        "planner's on the starts and sizes that it ran on",
        ("controller", "worst, at [m]", "mean over sizes", "least share of the planner's"),
        tuple(rows),
    )


def _share_of_planner(sweep: Sweep, name: str, level: Level) -> float | None:
    """Return success relative to the planner on its starts; None if the planner did not succeed."""
    planned = sweep.success(PLANNER, "square", level)
    success = sweep.success(name, "square", level)
    if planned is None or success is None or not planned.any():
        return None
    return float(success[:, : planned.shape[1]].mean() / planned.mean())


def shape_table(sweep: Sweep) -> Table:
    """Make the table of success in the lab by method and shape."""
    rows = []
    for name in sweep.methods:
        shapes, whole = sweep.by_shape(name), sweep.find(name, LAB, LAB)
        if whole is None:
            continue
        rates = [shapes[each].mean() if each in shapes else None for each in SHAPES]
        rows.append((name, _with_interval(whole), *map(_share, rates)))
    header = ("controller", "success (95 % interval)", *SHAPES)
    title = f"{task_label(sweep.task)}: lab"
    return Table(title, "success in the lab, by shape", header, tuple(rows))


def sweep_numbers(task: str, results: Results) -> list[dict[str, Any]]:
    """List every rate of the robustness study, one row each."""
    metrics, rows = start_benchmark(task).task.metrics, []
    for (_, scenario, preset, method), sample in results.among(task):
        if scenario == STARTS:
            continue
        parts = {"": sample.success}
        if scenario == scenario_name(LAB, LAB):
            parts |= {f" {k}": v for k, v in Sweep(task, results).by_shape(method).items()}
        for part, success in parts.items():
            low, high = interval(success)
            values = {"success": float(success.mean()), "success_low": low, "success_high": high}
            if metrics and not part:
                sizes = np.median(sample.metric(metrics[0]), axis=1)
                values["median_error"] = float(np.mean(sizes))
            rows += numbers((task, scenario + part, preset, method), sample, values)
    return rows
