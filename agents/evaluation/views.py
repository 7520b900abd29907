"""Views of results with one parcel: tables, and all numbers.

A view is a function of a task and of results. It returns no table if the results are missing.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from surface_gym.config import PRESETS
from surface_gym.tasks.benchmark import PARCELS, ResultColumn, StreamBenchmark

from ..base import Booleans
from ..library import task_label
from .method import FIXED, PLANNER, find_benchmark, start_benchmark
from .results import Key, Results, Sample, interval
from .robustness import FACTORS, LAB, SHAPES, Factor, Level, scenario_name
from .scenario import STARTS
from .tables import Table, number, tabulate

SHOWN_SPEEDS = np.arange(3, 28, 2) / 10.0  # [m/s] entry speeds in the table
NAME, SUCCESS = "controller", "success (95 % interval)"


def task_tables(task: str, results: Results) -> list[Table]:
    """Make the table of a task: success by method and preset, and the task's columns."""
    benchmark, exact = start_benchmark(task), results.at(task, STARTS, "exact")
    if FIXED not in exact:
        return []
    labels = {each.name: each.label for each in PRESETS.values() if each.name != "exact"}
    others = {name: results.at(task, STARTS, name) for name in labels}
    fixed, rows = exact[FIXED], []
    for name, sample in exact.items():
        starts = sample.success.shape[1]
        fewer = starts != fixed.success.shape[1]
        values = {each: column_value(each, sample, fixed) for each in benchmark.columns}
        row = {
            NAME: f"{name} ({starts} starts)" if fewer else name,
            "seeds": f"{len(sample.seeds)}",
        }
        row[SUCCESS] = _with_interval(sample)
        row |= {labels[k]: number(_rate(ran.get(name)), ".3f") for k, ran in others.items() if ran}
        row |= {each.label: format_value(each, value) for each, value in values.items()}
        rows.append(row)
    return tabulate(task_label(task), benchmark.description, rows)


def column_value(column: ResultColumn, sample: Sample, fixed: Sample) -> float:
    """Compute a column's unscaled number, relative to the fixed layout's results.

    NaN if it is undefined: some columns need every start of both boxes.
    """
    task, preset = sample.rows[["task", "preset"]].iloc[0]
    fewer = sample.success.shape[1] != len(start_benchmark(task).starts)
    if column.every_start and (fewer or PRESETS[preset].parcels):
        return math.nan
    return column.value(sample, fixed)


def format_value(column: ResultColumn, value: float) -> str:
    """Return a column's number as text in its unit."""
    if math.isinf(value):
        return "fails"
    return number(column.scale * value, column.form, column.unit)


def _rate(sample: Sample | None) -> float | None:
    return None if sample is None else sample.rate


def _with_interval(sample: Sample) -> str:
    low, high = sample.interval
    return f"{sample.rate:.3f} ({low:.3f}-{high:.3f})"


def speed_tables(task: str, results: Results) -> list[Table]:
    """Make the table of the time of success by entry speed, for tasks with a grid of speeds."""
    grid, exact = start_benchmark(task).grid, results.at(task, STARTS, "exact")
    if grid is None or FIXED not in exact or exact[FIXED].success[0].size != math.prod(grid.shape):
        return []
    shown = [(name, sample) for name, sample in exact.items() if sample.kind != PLANNER]
    pairs = {
        f"{parcel}-box, {name}": (sample, parcel)
        for parcel, (name, sample) in product(PARCELS, shown)
    }

    def time(sample: Sample, parcel: str, speed: float) -> str:
        place = int(np.argmin(np.abs(grid.speeds - speed)))
        slowest = float(grid.slower_time(sample, parcel)[:, place].max())
        if np.isfinite(slowest):
            return f"{slowest:.3f}"
        return "some seeds" if grid.success(sample, parcel)[:, place].any() else "fails"

    speeds, first = grid.speeds, "entry speed [m/s]"
    cells = {
        f"{speed:.1f}": [time(*pair, speed) for pair in pairs.values()] for speed in SHOWN_SPEEDS
    }
    cells["minimum [m/s]"] = [number(grid.minimum_speed(*each), ".2f") for each in pairs.values()]
    cells["success"] = [f"{grid.success_rate(*each):.3f}" for each in pairs.values()]
    return tabulate(
        "sorting by entry speed",
        "time to sort [s], the slower of both sides and the slowest seed; minimum and success over "
        f"{len(speeds)} speeds from {speeds[0]:g} to {speeds[-1]:g} m/s",
        [{first: name, **dict(zip(pairs, row, strict=True))} for name, row in cells.items()],
    )


def decision_tables(tasks: Sequence[str], results: Results) -> list[Table]:
    """Make the table of decision times by method and task, with exact sensors.

    Times differ from run to run. This table has its own file, so that the other tables can be
    compared byte by byte.
    """
    ran = {task_label(task): results.at(task, STARTS, "exact") for task in tasks}
    times = {
        label: {name: 1e6 * sample.decision_time for name, sample in samples.items()}
        for label, samples in ran.items()
    }
    names = dict.fromkeys(name for task in tasks for name in results.methods(task, STARTS))
    return tabulate(
        "decisions",
        "time of one decision in one environment [us], decided many at a time, median; only these "
        "numbers differ from run to run",
        [{NAME: k} | {task: number(us.get(k), ".1f") for task, us in times.items()} for k in names],
    )


class Sweep:
    """Results of the robustness study of one task."""

    def __init__(self, task: str, results: Results) -> None:
        self.task = task
        self.samples = {
            (scenario, method): sample
            for (_, scenario, _, method), sample in results.among(task)
            if scenario != STARTS
        }
        self.methods = list(dict.fromkeys(method for _, method in self.samples))

    def find(self, method: str, factor: str, level: Level) -> Sample | None:
        """Return the sample of a method at a level; None if it did not run."""
        return self.samples.get((scenario_name(factor, level), method))

    def rate(self, method: str, factor: str, level: Level) -> float | None:
        """Return the success rate; None if the method did not run."""
        return _rate(self.find(method, factor, level))

    def by_shape(self, method: str) -> dict[str, Booleans]:
        """Return successes in the lab by shape of the parcel, for drawn shapes."""
        sample = self.find(method, LAB, LAB)
        if sample is None:
            return {}
        success = sample.success
        shape = sample.rows["shape"].to_numpy()[: success.shape[1]]
        return {each: success[:, shape == each] for each in SHAPES if each in shape}


def factor_tables(task: str, results: Results) -> list[Table]:
    """Make the table of success by method and factor."""
    sweep = Sweep(task, results)
    counts: dict[int, list[str]] = {}
    for name in sweep.methods:
        first = next(each for (_, method), each in sweep.samples.items() if method == name)
        counts.setdefault(first.success.shape[1], []).append(name)
    few = [f"{', '.join(n)}: {count}" for count, n in counts.items() if count != max(counts)]
    starts = f"{max(counts, default=0)} starts" + (f" ({'; '.join(few)})" if few else "")
    ran = {scenario for scenario, _ in sweep.samples}
    factors = {
        _heading(each): each
        for each in FACTORS.values()
        if scenario_name(each.name, each.shown[0]) in ran
    }

    def text(name: str, factor: Factor) -> str:
        rates = [sweep.rate(name, factor.name, level) for level in factor.shown]
        return " / ".join(number(rate, ".2f") for rate in rates)

    return tabulate(
        task_label(task),
        f"success of {starts}, one factor changed at a time",
        [
            {NAME: name, **{head: text(name, factor) for head, factor in factors.items()}}
            for name in sweep.methods
        ],
    )


def _heading(factor: Factor) -> str:
    if len(factor.shown) == 1:
        return factor.label
    levels = " / ".join(map(level_text, factor.shown))
    return f"{factor.label}: {levels} {factor.unit}".rstrip()


def level_text(level: Level) -> str:
    """Return a level as text."""
    return level if isinstance(level, str) else f"{level:g}"


def square_tables(task: str, results: Results) -> list[Table]:
    """Make the table of squares: worst size, and success relative to the planner, by method."""
    sweep, squares, rows = Sweep(task, results), FACTORS["square"], []
    for name in sweep.methods:
        ran = {each: sweep.find(name, "square", each) for each in squares.levels}
        rates = {level: sample.rate for level, sample in ran.items() if sample is not None}
        if not rates:
            continue
        worst = min(rates, key=lambda level: rates[level])
        found = [_share_of_planner(sweep, name, level) for level in rates]
        rows.append(
            {
                NAME: name,
                "worst, at [m]": f"{rates[worst]:.2f} at {level_text(worst)}",
                "mean over sizes": f"{sum(rates.values()) / len(rates):.2f}",
                "least share of the planner's": number(np.fmin.reduce(found), ".2f"),
            }
        )
    return tabulate(
        f"{task_label(task)}: squares",
        f"success on squares of {squares.levels[0]:g} to {squares.levels[-1]:g} m; beside the "
        "planner's on the starts and sizes that it ran on",
        rows,
    )


def _share_of_planner(sweep: Sweep, name: str, level: Level) -> float:
    """Return success relative to the planner on its starts; NaN if the planner did not succeed."""
    planned, sample = (sweep.find(each, "square", level) for each in (PLANNER, name))
    if planned is None or sample is None or not planned.rate:
        return math.nan
    return float(sample.success[:, : planned.success.shape[1]].mean() / planned.rate)


def shape_tables(task: str, results: Results) -> list[Table]:
    """Make the table of success in the lab by method and shape."""
    sweep, rows = Sweep(task, results), []
    for name in sweep.methods:
        if (whole := sweep.find(name, LAB, LAB)) is not None:
            rates = {shape: float(each.mean()) for shape, each in sweep.by_shape(name).items()}
            row = {NAME: name, SUCCESS: _with_interval(whole)}
            rows.append(row | {shape: number(rates.get(shape), ".2f") for shape in SHAPES})
    return tabulate(f"{task_label(task)}: lab", "success in the lab, by shape", rows)


def sweep_tables(task: str, results: Results) -> list[Table]:
    """Make the tables of a task's robustness study."""
    makers = (factor_tables, square_tables, shape_tables)
    return [table for make in makers for table in make(task, results)]


def list_numbers(task: str, results: Results) -> list[dict[str, Any]]:
    """List every number of a task, one row each."""
    rows = []
    for key, sample in results.among(task):
        names = dict(zip(("task", "scenario", "preset", "method"), key, strict=True))
        count = {"seeds": len(sample.seeds), "episodes": len(sample.rows) // len(sample.seeds)}
        for part, values in _values(key, sample, results).items():
            names["scenario"] = key[1] + part
            rows += [{**names, **count, "metric": k, "value": each} for k, each in values.items()]
    return rows


def _values(key: Key, sample: Sample, results: Results) -> dict[str, dict[str, float]]:
    """Return the numbers of a sample, in the lab also of each shape."""
    task, scenario, preset, method = key
    benchmark = find_benchmark(task)
    if isinstance(benchmark, StreamBenchmark):
        return {"": _stream_values(sample, benchmark)}
    values = _success(sample.success)
    if scenario == STARTS:
        fixed = results.find(task, STARTS, preset, FIXED)
        if fixed is not None:
            values |= {c.name: column_value(c, sample, fixed) for c in benchmark.columns}
        return {"": values}
    if metrics := benchmark.task.metrics:
        sizes = np.median(sample.metric(metrics[0]), axis=1)
        values["median_error"] = float(np.mean(sizes))
    shapes = Sweep(task, results).by_shape(method) if preset == LAB else {}
    return {"": values, **{f" {shape}": _success(each) for shape, each in shapes.items()}}


def _success(success: Booleans) -> dict[str, float]:
    low, high = interval(success)
    return {"success": float(success.mean()), "success_low": low, "success_high": high}


def _stream_values(sample: Sample, benchmark: StreamBenchmark) -> dict[str, float]:
    values = {"rate": sample.throughput, "bound": sample.constant("bound")}
    if len(sample.seeds) > 1:
        means = sample.of_seeds.mean(axis=1)
        values |= {f"rate of seed {k}": r for k, r in zip(sample.seeds, means, strict=True)}
    for name in ("actuators", "columns", "best"):
        if math.isfinite(sample.constant(name)):
            values[name] = sample.constant(name)
    if sample.is_sustained:
        values |= {
            "margin": sample.margin, "offered": sample.constant("offered"),
            "share correct": sample.share_correct, "jams": sample.jams,
            "waiting": sample.waiting, "turns per parcel": sample.turns_per_actuator,
            **{each.name: each.value(sample, sample) for each in benchmark.columns},
        }  # fmt: skip
    return values
