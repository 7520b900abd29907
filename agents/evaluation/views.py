"""Views: functions that make tables of a task from the results of a comparison.

A view returns an empty list if the results are missing.
"""

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from surface_gym.config import PRESETS
from surface_gym.tasks.benchmark import PARCELS, ResultColumn, StreamBenchmark

from ..base import Booleans, Numbers
from ..library import task_label
from .method import FIXED, PLANNED, PLANNER, is_on_streams, start_benchmark, stream_benchmark
from .results import Results, Sample, half_interval, is_ahead
from .scenario import FACTORS, LAB, SHAPES, STARTS, Factor, Level, scenario_name
from .streams import BOUNDED, LEAST_CORRECT, QUIET, SCHEDULER, STEPS, STREAM_PRESETS, UNSEEN, ZONES
from .tables import NOTHING, Table, bold, number, tabulate

SHOWN_SPEEDS = np.arange(3, 28, 2) / 10.0  # [m/s] entry speeds in the table
NAME, SUCCESS = "controller", "success (95 % interval)"


def make_tables(task: str, results: Results) -> list[Table]:
    """Make the tables of a task, the most important one first."""
    if is_on_streams(task):
        return stream_tables(task, results)
    return [*task_tables(task, results), *speed_tables(task, results)]


def task_tables(task: str, results: Results) -> list[Table]:
    """Make a task's main table: each method's success rates, and the task's own columns."""
    benchmark, exact = start_benchmark(task), results.at(task, STARTS, "exact")
    if FIXED not in exact:
        return []
    labels = {each.name: each.label for each in PRESETS.values() if each.name != "exact"}
    others = {name: results.at(task, STARTS, name) for name in labels}
    fixed, rows = exact[FIXED], []
    for name in results.methods(task, STARTS):
        ran = {preset: samples.get(name) for preset, samples in others.items()}
        sample = exact.get(name) or next(each for each in ran.values() if each)
        starts = sample.success.shape[1]
        fewer = starts != fixed.success.shape[1]
        row = {
            NAME: f"{name} ({starts} starts)" if fewer else name,
            "seeds": f"{len(sample.seeds)}",
        }
        row[SUCCESS] = _with_interval(sample) if name in exact else "-"
        row |= {labels[k]: number(_rate(ran[k]), ".3f") for k, any_ran in others.items() if any_ran}
        for column in benchmark.columns:
            value = column_value(column, sample, fixed) if name in exact else math.nan
            row[column.label] = format_value(column, value)
        rows.append(row)
    count = fixed.success.shape[1]
    return tabulate(task_label(task), f"{count} starts: {benchmark.description}", rows)


def column_value(column: ResultColumn, sample: Sample, fixed: Sample) -> float:
    """Compute a column's unscaled number for a sample; `fixed` is the fixed layout's sample.

    If `column.every_start` is true, the number needs all starts of the task's benchmark. If the
    sample lacks starts, or the preset changes the parcels, the number is NaN.
    """
    task, preset = sample.rows[["task", "preset"]].iloc[0]
    fewer = sample.success.shape[1] != len(start_benchmark(task).starts)
    if column.every_start and (fewer or PRESETS[preset].parcels):
        return math.nan
    return column.value(sample, fixed)


def format_value(column: ResultColumn, value: float) -> str:
    """Return `value` as text in the column's unit, or "fails" if `value` is infinite."""
    if math.isinf(value):
        return "fails"
    return number(column.scale * value, column.form, column.unit)


def _rate(sample: Sample | None) -> float | None:
    return None if sample is None else sample.rate


def _with_interval(sample: Sample) -> str:
    low, high = sample.interval
    return f"{sample.rate:.3f} ({low:.3f}-{high:.3f})"


def speed_tables(task: str, results: Results) -> list[Table]:
    """Make the table of sorting times at each entry speed, if the task has a grid of speeds."""
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


class Sweep:
    """Results of one task in the robustness study."""

    def __init__(self, task: str, results: Results) -> None:
        ran = [each for each in results.among(task) if each[0][1] != STARTS]
        self.samples = {(scenario, name): each for (_, scenario, _, name), each in ran}
        self.methods = list(dict.fromkeys(name for _, name in self.samples))

    def find(self, method: str, factor: str, level: Level) -> Sample | None:
        """Return a method's sample at a level of a factor; None if the method did not run."""
        return self.samples.get((scenario_name(factor, level), method))

    def rate(self, method: str, factor: str, level: Level) -> float | None:
        """Return a method's success rate at a factor's level, or None if the method did not run."""
        return _rate(self.find(method, factor, level))

    def by_shape(self, method: str) -> dict[str, Booleans]:
        """Return, for each shape of parcels, a method's successes (seeds, starts) in the lab."""
        sample = self.find(method, LAB, LAB)
        if sample is None:
            return {}
        success = sample.success
        shape = sample.rows["shape"].to_numpy()[: success.shape[1]]
        return {each: success[:, shape == each] for each in SHAPES if each in shape}


def sweep_tables(task: str, results: Results) -> list[Table]:
    """Make the tables of a task's robustness study."""
    makers = (factor_tables, square_tables, shape_tables)
    return [table for make in makers for table in make(task, results)]


def factor_tables(task: str, results: Results) -> list[Table]:
    """Make the table of success rates: a row for each method, a column for each factor."""
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
    """Return a level (a value of a varied factor) as text."""
    return level if isinstance(level, str) else f"{level:g}"


def square_tables(task: str, results: Results) -> list[Table]:
    """Tabulate success rates with square parcels, and the ratios to the planner's success rates."""
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
    """Divide a method's success rate by the planner's success rate.

    The parcels are squares of the size `level` [m]. The two rates use only the planner's starts.
    Return NaN if a rate is missing, or if the planner's rate is 0.
    """
    planned, sample = (sweep.find(each, "square", level) for each in (PLANNER, name))
    if planned is None or sample is None or not planned.rate:
        return math.nan
    return float(sample.success[:, : planned.success.shape[1]].mean() / planned.rate)


def shape_tables(task: str, results: Results) -> list[Table]:
    """Make the table of success rates in the lab for each method and each shape of parcels."""
    sweep, rows = Sweep(task, results), []
    for name in sweep.methods:
        if (whole := sweep.find(name, LAB, LAB)) is not None:
            rates = {shape: float(each.mean()) for shape, each in sweep.by_shape(name).items()}
            row = {NAME: name, SUCCESS: _with_interval(whole)}
            rows.append(row | {shape: number(rates.get(shape), ".2f") for shape in SHAPES})
    return tabulate(f"{task_label(task)}: lab", "success in the lab, by shape", rows)


# Upper bounds for all controllers, and for schedules of a rung's maneuvers.
ENTRANCE = "entry limit"
BEST = "best known for {}"
CANNOT = "cannot"  # cannot sort all kinds, even one at a time
TOUCHES, TURNS = "touches per 1000", "turns per parcel"
EXITS = {  # descriptions by name of a group
    "sides": "left, right (a chute as long as the line on either side) and straight on",
    "chutes": "two chutes on either side and straight on, the environment's default",
}


class Capacities:
    """Capacities of methods under a preset, on the benchmark's streams of a group, e.g. "sides"."""

    def __init__(self, results: Results, task: str, group: str, preset: str) -> None:
        self.task, self.group, self.preset = task, group, preset
        offers = [each for each in stream_benchmark(task).offers if each.group == group]
        self._samples = {each.name: results.at(task, each.scenario, preset) for each in offers}
        self.offers = list(self._samples)
        found = {name for samples in self._samples.values() for name in samples}
        self.names = [name for name in results.methods(task) if name in found]

    def find(self, name: str, offer: str) -> Sample | None:
        """Return a method's sample on the stream `offer`, or None if the method did not run."""
        return self._samples[offer].get(name)

    def throughput(self, name: str, offer: str) -> float:
        """Return a method's capacity [parcels/h] on a stream; 0 if the method sustains no rate."""
        sample = self.find(name, offer)
        return 0.0 if sample is None else sample.throughput

    def able(self, name: str, offer: str) -> Sample | None:
        """Return a method's sample on a stream. If the method sustains no rate, return None."""
        sample = self.find(name, offer)
        return sample if sample is not None and sample.is_sustained else None

    def constants(self, name: str, column: str) -> list[float]:
        """Return the method's value of `column` per stream, or NaN if the method did not run."""
        samples = [self.find(name, offer) for offer in self.offers]
        return [math.nan if each is None else each.constant(column) for each in samples]

    def bound(self, offer: str) -> float:
        """Return the entry limit [parcels/h] of a stream, or NaN if no method ran."""
        return next((each.constant("bound") for each in self._samples[offer].values()), math.nan)

    def difference(self, name: str, other: str, offer: str) -> tuple[float, float] | None:
        """Return the capacity of `name` minus the capacity of `other`, and half a 95 % interval.

        The two numbers are in [parcels/h]. The second number is half the width of the difference's
        confidence interval. Replications are paired if the methods got the same parcels at the same
        times. Return None if a method sustains no rate.
        """
        one, two = self.able(name, offer), self.able(other, offer)
        if one is None or two is None:
            return None
        if (one.constant("offered"), len(one.rates)) == (two.constant("offered"), len(two.rates)):
            apart = one.rates - two.rates
            return float(apart.mean()), half_interval(apart)
        return one.throughput - two.throughput, math.hypot(one.margin, two.margin)

    def leader(self, offer: str) -> str | None:
        """Return the method whose capacity is significantly above all other capacities, or None."""
        able = {n: each for n in self.names if (each := self.able(n, offer)) is not None}
        first = max(able, key=lambda name: able[name].throughput, default="")
        apart = [self.difference(first, name, offer) for name in able if name != first]
        ahead = [each is not None and each[0] > each[1] for each in apart]
        return first if ahead and all(ahead) else None


def list_capacities(task: str, results: Results) -> list[Capacities]:
    """List a task's `Capacities` for each group of streams and each preset that has results."""
    benchmark = stream_benchmark(task)
    searched = [each for each in benchmark.offers if not each.rates]
    ran = {(key[1], key[2]) for key, _ in results.among(task)}
    return [
        Capacities(results, task, group, preset)
        for group in dict.fromkeys(each.group for each in searched)
        for preset in benchmark.presets
        if any((each.scenario, preset) in ran for each in searched if each.group == group)
    ]


def stream_tables(task: str, results: Results) -> list[Table]:
    """Make all tables of a task on streams, the most important one first."""
    found = list_capacities(task, results)
    groups = dict.fromkeys(each.group for each in found)
    return [
        *(
            table
            for group in groups
            for make in (ladder_tables, step_tables)
            for each in found
            if each.group == group
            for table in make(each)
        ),
        *offer_tables(task, results),
    ]


def ladder_tables(found: Capacities) -> list[Table]:
    """Tabulate each method's actuators, capacity on each stream, parcel contacts and axis turns."""
    leaders = {offer: found.leader(offer) for offer in found.offers}
    rows: list[dict[str, str]] = []

    def row(name: str, hardware: str, cells: Sequence[str], *more: str) -> None:
        values = (hardware, *cells, *(more or (NOTHING, NOTHING)))
        heads = ("actuators", *found.offers, TOUCHES, TURNS)
        rows.append({NAME: name, **dict(zip(heads, values, strict=True))})

    for name in found.names:
        samples = {offer: found.find(name, offer) for offer in found.offers}
        able = [each for each in samples.values() if each is not None and each.is_sustained]
        cells = [
            bold(_capacity(sample)) if name == leaders[offer] else _capacity(sample)
            for offer, sample in samples.items()
        ]
        delivered = sum(each.values("delivered").sum() for each in able)
        touches = 1000.0 * sum(each.touches for each in able) / max(1, delivered)
        turns = [each.turns for each in able]
        row(
            name, _span([int(each) for each in found.constants(name, "actuators") if each > 0.0]),
            cells, number(touches if able else None, ".1f"),
            number(float(np.mean(turns)) if able else None, ".1f"),
        )  # fmt: skip
    for name in BOUNDED:
        best = found.constants(name, "best")
        if not np.isnan(best).all():
            row(BEST.format(name), NOTHING, [number(each, ".0f") for each in best])
    row(ENTRANCE, NOTHING, [number(found.bound(offer), ".0f") for offer in found.offers])
    measured = [found.find(name, offer) for name in found.names for offer in found.offers]
    replications = max(len(each.rates) for each in measured if each is not None)
    bounds = f"No controller exceeds the row “{ENTRANCE}”."
    if any(each[NAME].startswith(BEST.format("")) for each in rows):
        bounds += f" A row “{BEST.format('...')}” is the best rate of a search, and no bound."
    return tabulate(
        _title("ladder of hardware", found),
        "Correct deliveries per hour at the highest steady rate with at least "
        f"{100.0 * LEAST_CORRECT[found.preset]:g} % correct deliveries and no jam, with Student's "
        f"95 % interval over {replications} replications. Parcels go at equal odds to the "
        f"{_exits(found)}. {STREAM_PRESETS[found.preset].meaning} Bold marks a rate above every "
        "other by more than the interval. An actuator turns the axes of a module, a column or a "
        "zone, on 6 m of line. A fixed layout would lead all parcels one way. Touches per 1000 "
        "deliveries and turns of an actuator per parcel are means over all streams. "
        f"{_zones(found)}{bounds}",
        rows,
    )


def _capacity(sample: Sample | None) -> str:
    if sample is None:
        return NOTHING
    if sample.is_sustained:
        return _throughput(sample)
    return "0" if sample.constant("actuators") else CANNOT


def _throughput(sample: Sample) -> str:
    return f"{sample.throughput:.0f} ±{sample.margin:.0f}"


def _span(values: Sequence[int]) -> str:
    """Return the smallest and the largest of numbers as text."""
    return " to ".join(map(str, sorted({min(values), max(values)}))) if values else NOTHING


def _zones(found: Capacities) -> str:
    """Describe the number of columns per zone on each stream."""
    columns = {name: found.constants(name, "columns") for name in ZONES}
    said = [
        f"{name}: {', '.join(f'{each:.0f}' if each > 0.0 else CANNOT for each in of_streams)}"
        for name, of_streams in columns.items()
        if not np.isnan(of_streams).all()
    ]
    return f"Columns of a zone, stream by stream: {'; '.join(said)}. " if said else ""


def step_tables(found: Capacities) -> list[Table]:
    """Make the table of differences in capacity between the pairs of methods in `STEPS`."""

    def text(name: str, other: str, offer: str) -> str:
        apart, below = found.difference(name, other, offer), found.able(other, offer)
        if apart is None or below is None:
            return NOTHING
        change = 100.0 * apart[0] / below.throughput
        return f"{apart[0]:+.0f} ±{apart[1]:.0f} ({change:+.1f} %)"

    return tabulate(
        _title("what a rung has over another", found),
        "difference of capacities [parcels/h], with Student's 95 % interval over pairs of "
        f"replications with the same parcels; {_exits(found)}",
        [
            {"rungs": f"{name} over {other}"}
            | {offer: text(name, other, offer) for offer in found.offers}
            for name, other in STEPS
            if name in found.names and other in found.names
        ],
    )


def _title(title: str, found: Capacities) -> str:
    label = STREAM_PRESETS[found.preset].label
    return f"{task_label(found.task)}: {title}, {label}, exits “{found.group}”"


def _exits(found: Capacities) -> str:
    return f"exits “{found.group}”: {EXITS.get(found.group, found.group)}"


def offer_tables(task: str, results: Results) -> list[Table]:
    """Make the table of deliveries, with a row for each stream, preset and method."""
    benchmark = stream_benchmark(task)
    columns = benchmark.columns
    rows: list[dict[str, str]] = []
    shown: list[Sample] = []
    for offer in (each for each in benchmark.offers if each.rates):
        for preset in benchmark.presets:
            samples = results.at(task, offer.scenario, preset)
            shown += samples.values()
            ahead = _find_ahead({k: v.rates for k, v in samples.items() if v.kind != PLANNER})
            for name, sample in samples.items():
                rate, bound = _throughput(sample), number(sample.constant("bound"), ".0f")
                row = {"scenario": offer.name, "preset": preset, "method": name}
                row["correct per hour"] = bold(rate) if name == ahead else rate
                row["correct"] = f"{100.0 * sample.share_correct:.2f} %"
                row |= {c.label: format_value(c, c.value(sample, sample)) for c in columns}
                rows.append(row | {"jams": f"{sample.jams:.1f}", "full belt": bound})
    return tabulate(f"{task_label(task)} on streams", _describe(benchmark, shown), rows, keys=3)


def _find_ahead(rates: dict[str, Numbers]) -> str | None:
    """Return the method whose rate is significantly above all other rates, or None.

    `rates` has the rates (replications,) of each method; replications are paired.
    """
    if len(rates) < 2:
        return None
    best = max(rates, key=lambda name: float(rates[name].mean()))
    others = [rates[best] - each for name, each in rates.items() if name != best]
    return best if all(map(is_ahead, others)) else None


def _describe(benchmark: StreamBenchmark, samples: Sequence[Sample]) -> str:
    count = max((len(each.rates) for each in samples), default=0)
    seconds = max((each.constant("counted") for each in samples), default=0.0)
    planner = ""
    if any(each.kind == PLANNER for each in samples):
        planner = (
            f" The planner knows the true state and all arrivals. It runs on {PLANNED} streams "
            "only, and is not compared for the bold."
        )
    return (
        f"{count} streams of {seconds:g} s, the same for all methods; {benchmark.description}. "
        "Correct deliveries per hour have Student's 95 % interval; agents have the mean over their "
        "seeds. Bold marks results that are significantly best (95 % confidence, paired). "
        f"{'; '.join(f'{each.label}: {each.meaning}' for each in benchmark.columns)}; jams: "
        f"streams in which nothing moved, or nothing left in the last {QUIET:g} s; full belt: "
        "the rate at which the take-away is full, if all departures are correct and each kind of "
        f"parcel departs in its share.{planner}"
    )


def unseen_tables(task: str, results: Results) -> list[Table]:
    """Make the table of agents and the scheduler on streams that agents never trained on."""
    rows, agents = [], set[str]()
    for offer in stream_benchmark(task).held_out:
        samples = results.at(task, offer.scenario, UNSEEN)
        if (rule := samples.pop(SCHEDULER, None)) is None:
            continue
        agents |= samples.keys()
        for sample in samples.values():
            seeds = [Sample(each) for _, each in sample.rows.groupby("seed", sort=False)]
            ratio, ahead = _compare(rule.rates, list(sample.of_seeds))
            rows.append(
                (
                    offer.name, _throughput(rule), _touches([rule]), _throughput(sample),
                    _touches(seeds), ratio, ahead, f"{rule.constant('bound'):.0f}",
                )
            )  # fmt: skip
    if not rows:
        return []
    agent = ", ".join(sorted(agents))
    table = Table(
        f"{task_label(task)}: {agent} beside the scheduler where it never trained",
        "Correct deliveries per hour at the entry limit, with Student's 95 % interval, mean over "
        "the agent's seeds; touches per 1000 deliveries. The ratio is of the same parcels; bold "
        "marks an interval without 1. Both choose in a trial how close parcels follow each other: "
        "without a touch, or with at most 50 per 1000 deliveries where modules are stuck and where "
        "speeds differ, and 100 in the lab.",
        (
            "scenario", "scheduler", "scheduler's touches", agent, f"{agent}'s touches",
            "agent / scheduler",
            "seeds significantly above 1", "entry limit",
        ),
        tuple(rows),
    )  # fmt: skip
    return [table]


def _touches(seeds: Sequence[Sample]) -> str:
    each = [1000.0 * one.touches / max(1.0, one.values("delivered").sum()) for one in seeds]
    return f"{np.mean(each):.1f}"


def _compare(rule: Numbers, agents: Sequence[Numbers]) -> tuple[str, str]:
    """Compare the rates (replications,) of agents with the rates (replications,) of a rule.

    Returns:
        Two texts: the ratio of the agents' mean to the rule's mean, and the number of agents
        significantly ahead of the rule.
    """
    apart = np.mean(agents, axis=0) - rule
    ratio, margin = 1.0 + apart.mean() / rule.mean(), half_interval(apart) / rule.mean()
    text = f"{ratio:.3f} ±{margin:.3f}"
    ahead = sum(is_ahead(each - rule) for each in agents)
    return bold(text) if abs(ratio - 1.0) > margin else text, f"{ahead} of {len(agents)}"
