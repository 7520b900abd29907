"""Views of results on streams: tables, and all numbers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from surface_gym.tasks.benchmark import Offer, StreamBenchmark

from ..base import Numbers
from ..library import task_label
from .ladder import BOUNDED, SCHEDULER, STEPS, ZONES
from .method import PLANNED, PLANNER, stream_benchmark
from .results import Results, Sample, half_interval, is_ahead
from .stream_scenario import LEAST_RIGHT, QUIET, STREAM_PRESETS, UNSEEN
from .tables import NOTHING, Table, bold
from .views import format_value, numbers

# Upper bounds for all controllers, and for schedules of a rung's maneuvers.
ENTRANCE = "entrance"
BEST = "best known for {}"
CANNOT = "cannot"  # cannot sort all kinds, even one at a time
EXITS = {  # descriptions by name of a group
    "sides": "left, right (a chute as long as the line on either side) and straight on",
    "chutes": "two chutes on either side and straight on, the environment's default",
}


@dataclass(frozen=True)
class Capacities:
    """Capacities of methods on a group of offered streams under a preset."""

    results: Results
    task: str
    group: str
    preset: str

    @cached_property
    def offers(self) -> list[Offer]:
        return [each for each in stream_benchmark(self.task).offers if each.group == self.group]

    @cached_property
    def names(self) -> list[str]:
        """List the methods that ran."""
        found = [key[3] for offer in self.offers for key, _ in self._of(offer)]
        order = self.results.methods(self.task)
        return sorted(set(found), key=order.index)

    def _of(self, offer: Offer) -> list[tuple[Any, Sample]]:
        among = self.results.among(self.task, offer.scenario)
        return [(key, sample) for key, sample in among if key[2] == self.preset]

    def find(self, name: str, offer: Offer) -> Sample | None:
        """Return the sample of a method; None if it did not run."""
        return self.results.find(self.task, offer.scenario, self.preset, name)

    def able(self, name: str, offer: Offer) -> Sample | None:
        """Return the sample of a method if it sustains any rate."""
        sample = self.find(name, offer)
        return sample if sample is not None and sample.is_sustained else None

    def bound(self, offer: Offer) -> float | None:
        """Return the entry limit [parcels/h]; None if nothing ran."""
        found = self._of(offer)
        return found[0][1].constant("bound") if found else None

    def difference(self, name: str, other: str, offer: Offer) -> tuple[float, float] | None:
        """Return the difference of two capacities and half of its 95 % interval [parcels/h], or
        None.

        Replications are paired if both had the same offered parcels at the same times.
        """
        one, two = self.able(name, offer), self.able(other, offer)
        if one is None or two is None:
            return None
        if (one.constant("offered"), len(one.rates)) == (two.constant("offered"), len(two.rates)):
            apart = one.rates - two.rates
            return float(apart.mean()), half_interval(apart)
        return one.throughput - two.throughput, math.hypot(one.margin, two.margin)

    def leader(self, offer: Offer) -> str | None:
        """Find the method whose capacity is above every other capacity, beyond the interval."""
        rates = {
            n: each.throughput for n in self.names if (each := self.able(n, offer)) is not None
        }
        if not rates:
            return None
        first = max(rates, key=rates.__getitem__)
        apart = [self.difference(first, name, offer) for name in rates if name != first]
        ahead = [each is not None and each[0] > each[1] for each in apart]
        return first if ahead and all(ahead) else None


def list_capacities(task: str, results: Results) -> list[Capacities]:
    """List the capacities by group and preset."""
    searched = [each for each in stream_benchmark(task).offers if not each.rates]
    ran = {(key[1], key[2]) for key, _ in results.among(task)}
    return [
        Capacities(results, task, group, preset)
        for group in dict.fromkeys(each.group for each in searched)
        for preset in stream_benchmark(task).presets
        if any((each.scenario, preset) in ran for each in searched if each.group == group)
    ]


def stream_tables(task: str, results: Results) -> list[Table]:
    """Make all tables of a task, the most important one first."""
    found = list_capacities(task, results)
    groups = dict.fromkeys(each.group for each in found)
    return [
        *(
            make(each)
            for group in groups
            for make in (ladder_table, step_table)
            for each in found
            if each.group == group
        ),
        *offer_tables(task, results),
    ]


def ladder_table(found: Capacities) -> Table:
    """Make the table of hardware, capacity on all streams, touches and turns by method."""
    leaders = [found.leader(offer) for offer in found.offers]
    rows = []
    for name in found.names:
        samples = [found.find(name, offer) for offer in found.offers]
        able = [each for each in samples if each is not None and each.is_sustained]
        cells = [
            bold(cell) if name == leader else cell
            for cell, leader in zip(map(_capacity, samples), leaders, strict=True)
        ]
        delivered = sum(each.values("delivered").sum() for each in able)
        touches = 1000.0 * sum(each.touches for each in able) / max(1, delivered)
        turns = float(np.mean([turns_per_actuator(each) for each in able] or [math.nan]))
        actuators = [int(each.constant("actuators")) for each in samples if each is not None]
        rows.append(
            (
                name, _span([each for each in actuators if each]), *cells,
                f"{touches:.1f}" if able else NOTHING,
                f"{turns:.1f}" if able else NOTHING,
            )
        )  # fmt: skip
    for name in BOUNDED:
        samples = [found.find(name, offer) for offer in found.offers]
        best = [math.nan if each is None else each.constant("best") for each in samples]
        if not np.isnan(best).all():
            rows.append((BEST.format(name), NOTHING, *map(_whole, best), NOTHING, NOTHING))
    bounds = [found.bound(offer) for offer in found.offers]
    rows.append((ENTRANCE, NOTHING, *map(_whole, bounds), NOTHING, NOTHING))
    return Table(
        _title("ladder of hardware", found),
        f"{_meaning(found)} In bold what is above every other method by more than that "
        "interval. Actuators turn axes, of a module, a column or a zone; all deliver through the "
        "same 6 m of line. A layout that is arranged once and for all sorts nothing: it leads all "
        "parcels one way. Touches per 1000 deliveries, and actuators' turns per parcel, are the "
        f"means of all streams. {_zones(found)}No controller can exceed the row "
        f"“{ENTRANCE}”; no schedule of a rung's maneuvers can exceed what is best known for it, "
        "on a long stream, but other maneuvers might.",
        (
            "controller", "actuators", *(each.name for each in found.offers), "touches/1000",
            "turns/parcel",
        ),
        tuple(rows),
    )  # fmt: skip


def turns_per_actuator(sample: Sample) -> float:
    """Compute the turns of actuators per parcel, or of axes with single actuators."""
    modules = sample.constant("modules")
    return sample.turns if math.isnan(modules) else sample.turns / modules


def _whole(value: float | None) -> str:
    return NOTHING if value is None or math.isnan(value) else f"{value:.0f}"


def _capacity(sample: Sample | None) -> str:
    if sample is None:
        return NOTHING
    if sample.is_sustained:
        return _rate(sample.throughput, sample.margin)
    return "0" if sample.constant("actuators") else CANNOT


def _rate(rate: float, margin: float) -> str:
    return f"{rate:.0f} ±{margin:.0f}"


def _span(values: Sequence[int]) -> str:
    """Return the smallest and the largest of numbers as text."""
    if not values:
        return NOTHING
    low, high = min(values), max(values)
    return str(low) if low == high else f"{low} to {high}"


def _zones(found: Capacities) -> str:
    """Describe the numbers of columns in the zones of each stream."""
    said = []
    for name in ZONES:
        samples = [found.find(name, offer) for offer in found.offers]
        columns = [0 if each is None else int(each.constant("columns")) for each in samples]
        if any(each is not None for each in samples):
            said.append(f"{name}: {', '.join(str(each or CANNOT) for each in columns)}")
    return f"Columns of a zone, stream by stream: {'; '.join(said)}. " if said else ""


def step_table(found: Capacities) -> Table:
    """Make the table of differences between rungs."""

    def text(name: str, other: str, offer: Offer) -> str:
        apart, below = found.difference(name, other, offer), found.able(other, offer)
        if apart is None or below is None:
            return NOTHING
        change = 100.0 * apart[0] / below.throughput
        return f"{apart[0]:+.0f} ±{apart[1]:.0f} ({change:+.1f} %)"

    rows = [
        (f"{name} over {other}", *(text(name, other, offer) for offer in found.offers))
        for name, other in STEPS
        if name in found.names and other in found.names
    ]
    return Table(
        _title("what a rung has over another", found),
        "difference of capacities [parcels/h], with Student's 95 % interval of the replications "
        f"in pairs, since they met the same parcels; {_exits(found)}",
        ("rungs", *(each.name for each in found.offers)),
        tuple(rows),
    )


def _title(title: str, found: Capacities) -> str:
    label = STREAM_PRESETS[found.preset].label
    return f"{task_label(found.task)}: {title}, {label}, exits “{found.group}”"


def _exits(found: Capacities) -> str:
    return f"exits “{found.group}”: {EXITS.get(found.group, found.group)}"


def _meaning(found: Capacities) -> str:
    replications = max(len(sample.rates) for _, sample in found.results.among(found.task))
    return (
        f"Right deliveries an hour, at equal odds to the {_exits(found)}. They are those of the "
        "highest steady rate at which "
        f"{100.0 * LEAST_RIGHT[found.preset]:g} % of deliveries are right and nothing jams, "
        f"with Student's 95 % interval over {replications} replications. "
        f"{STREAM_PRESETS[found.preset].meaning}"
    )


def offer_tables(task: str, results: Results) -> list[Table]:
    """Make the tables of deliveries by method, offered stream and preset."""
    benchmark, rows = stream_benchmark(task), []
    for offer in benchmark.offers:
        if not offer.rates:
            continue
        for preset in benchmark.presets:
            samples = {
                key[3]: sample
                for key, sample in results.among(task, offer.scenario)
                if key[2] == preset
            }
            fair = {name: each for name, each in samples.items() if each.kind != PLANNER}
            best = max(fair, key=lambda name: fair[name].throughput, default=None)
            for name, sample in samples.items():
                others = [sample.rates - each.rates for n, each in fair.items() if n != name]
                ahead = name == best and bool(others) and all(map(is_ahead, others))
                rows.append(_offer_row(benchmark, (offer.name, preset, name), sample, ahead))
    if not rows:
        return []
    table = Table(
        f"{task_label(task)} on streams",
        f"{_offered(benchmark, task, results)} Parcels that leave rightly per hour, with Student's "
        "95 % interval; bold marks results that are significantly best (95 % confidence, paired). "
        f"{'; '.join(f'{each.label}: {each.meaning}' for each in benchmark.columns)}; streams that "
        f"jammed, so that nothing moved or nothing left in the last {QUIET:g} s; and the rate that "
        f"nobody exceeds. The planner knows the true state and all that will come, plays the first "
        f"{PLANNED} streams alone, and is not compared for the bold. Agents are the mean of their "
        "seeds.",
        (
            "scenario", "preset", "method", "right an hour", "right",
            *(each.label for each in benchmark.columns), "jams", "bound",
        ),
        tuple(rows),
        keys=3,
    )  # fmt: skip
    return [table]


def _offered(benchmark: StreamBenchmark, task: str, results: Results) -> str:
    samples = [sample for key, sample in results.among(task) if key[2] != UNSEEN]
    count = max(len(each.rates) for each in samples)
    seconds = max(each.constant("counted") for each in samples)
    return (
        f"{count} streams of {seconds:g} s that are the same for all methods; "
        f"{benchmark.description}."
    )


def _offer_row(
    benchmark: StreamBenchmark, key: tuple[str, str, str], sample: Sample, ahead: bool
) -> tuple[str, ...]:
    rate = _rate(sample.throughput, sample.margin)
    return (
        *key, bold(rate) if ahead else rate, f"{100.0 * sample.share_correct:.2f} %",
        *(format_value(each, each.value(sample, sample)) for each in benchmark.columns),
        f"{sample.jams:.1f}", _whole(sample.constant("bound")),
    )  # fmt: skip


def unseen_tables(task: str, results: Results) -> list[Table]:
    """Make the tables of scheduler and agents on streams without trained agents."""
    rows, agent = [], ""
    for offer in stream_benchmark(task).held_out:
        rule = results.find(task, offer.scenario, UNSEEN, SCHEDULER)
        if rule is None:
            continue
        bound = f"{rule.constant('bound'):.0f}"
        first = (offer.name, _rate(rule.throughput, rule.margin), _touches([rule]))
        for key, sample in results.among(task, offer.scenario):
            if key[3] != SCHEDULER:
                agent = key[3]
                seeds = [Sample(each) for _, each in sample.rows.groupby("seed", sort=False)]
                rate = _rate(sample.throughput, sample.margin)
                compared = _compare(rule.rates, list(sample.of_seeds))
                rows.append((*first, rate, _touches(seeds), *compared, bound))
    if not rows:
        return []
    table = Table(
        f"{task_label(task)}: {agent} beside the scheduler where it never trained",
        "Right deliveries an hour, offered as much as the entrance takes, with Student's 95 % "
        "interval, the mean of the agent's seeds; touches per 1000 deliveries; the agent's rate "
        "over the scheduler's, in pairs of the same parcels, in bold where the interval does not "
        "hold 1; and of how many seeds the interval alone is above 1. Both choose in a trial how "
        "close parcels follow each other: without a touch, or with at most 50 per 1000 deliveries "
        "where modules are stuck and where speeds differ, and 100 in the lab.",
        (
            "scenario", "scheduler", "touches", agent, "touches", "agent / scheduler",
            "seeds ahead", "entrance",
        ),
        tuple(rows),
    )  # fmt: skip
    return [table]


def _touches(seeds: Sequence[Sample]) -> str:
    each = [1000.0 * one.touches / max(1.0, one.values("delivered").sum()) for one in seeds]
    return f"{np.mean(each):.1f}"


def _compare(rule: Numbers, agents: Sequence[Numbers]) -> tuple[str, str]:
    """Return the ratio of the agents' mean, and the number of agents significantly ahead."""
    apart = np.mean(agents, axis=0) - rule
    ratio, margin = 1.0 + apart.mean() / rule.mean(), half_interval(apart) / rule.mean()
    text = f"{ratio:.3f} ±{margin:.3f}"
    ahead = sum(is_ahead(each - rule) for each in agents)
    return bold(text) if abs(ratio - 1.0) > margin else text, f"{ahead} of {len(agents)}"


def stream_numbers(task: str, results: Results) -> list[dict[str, Any]]:
    """List every number of a task, one row each."""
    benchmark, rows = stream_benchmark(task), []
    for key, sample in results.among(task):
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
                "waiting": sample.waiting, "turns per parcel": turns_per_actuator(sample),
                **{each.name: each.value(sample, sample) for each in benchmark.columns},
            }  # fmt: skip
        rows += numbers(key, sample, values)
    return rows
