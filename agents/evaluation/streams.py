"""The comparison on streams of parcels: a ladder of hardware, each rung with the scheduler that
serves it best, other controllers of its modules, their capacities and tables.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.parallel import Workers
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Exact

from .. import library
from ..base import Controller
from ..rules.streams import SortEach, StreamEventRule
from ..scheduling.bounds import clairvoyant_bound
from ..scheduling.maneuvers import ColumnGroups, make_library
from ..scheduling.scheduler import CLEARANCES, Scheduler, make_scheduler, predict_rate
from . import capacity as limits
from .benchmark import Advance, compute_kept, half_interval
from .capacity import Case, Measurement, StreamMethod
from .tables import NOTHING, Table, bold

FILE = "flow.jsonl"
FILMED = Case("S and B", 1.5)  # on film

# Rungs, by what turns together.
ARRANGED = "zone, arranged anew"
FOLLOWED = "zone, same exit follows"
SERIES = "zones in series"
TRIPLES = "columns in threes"
COLUMNS = "columns"
MODULES = "modules"
SIX_COLUMNS = "columns, six angles"
SIX_MODULES = "modules, six angles"
# Other controllers of modules.
EVENT = "event rule"
EACH = "sort-ppo for each"
LEARNED = "flow-schedule"
# What no controller exceeds, and what no schedule of a rung's maneuvers does.
ENTRANCE = "entrance"
BEST = "best known for {}"
CANNOT = "cannot"  # sort all kinds, even one at a time

# Pairs of rungs: what the first has over the second.
STEPS = (
    (FOLLOWED, ARRANGED), (SERIES, FOLLOWED), (TRIPLES, SERIES), (COLUMNS, TRIPLES),
    (MODULES, COLUMNS),
    (SIX_COLUMNS, COLUMNS), (SIX_MODULES, MODULES), (SIX_MODULES, SIX_COLUMNS), (LEARNED, MODULES),
)  # fmt: skip

SIX = tuple(np.radians([0.0, 45.0, -45.0, 90.0, 80.0, -80.0]).tolist())
SHORTEST = 4  # columns of a zone; fewer are nearly columns by themselves
SHORTEST_OF_MANY = 5  # of zones in series: shorter ones are no zones, since a parcel is over two
WIDEST = 20  # columns of a zone that is tried
LONGER = 2  # columns by which a zone is tried longer than the best so far
PREDICTED = 500  # parcels

StreamKey = tuple[str, str, str, str, float, str]


def cases(preset: str = "exact", exits: str = "sides") -> list[Case]:
    """List all mixes and speeds under a preset."""
    return [Case(mix, speed, preset, exits) for mix in limits.MIXES for speed in limits.SPEEDS]


def stream_methods() -> list[StreamMethod]:
    """List every method for streams: the ladder's rungs, then other controllers of modules."""
    columns = partial(_schedule, ColumnGroups())
    modules = partial(_schedule, None)
    found = [
        _rung(ARRANGED, "modules", partial(_schedule_zones, SHORTEST, 1, True)),
        _rung(FOLLOWED, "modules", partial(_schedule_zones, SHORTEST, 1, False)),
        _rung(SERIES, "modules", partial(_schedule_zones, SHORTEST_OF_MANY, None, False)),
        _rung(TRIPLES, "modules", partial(_schedule, ColumnGroups(3))),
        _rung(COLUMNS, "modules", columns),
        _rung(SIX_COLUMNS, "modules", columns, SIX),
        _rung(MODULES, "parcels", modules),
        _rung(SIX_MODULES, "parcels", modules, SIX),
        StreamMethod(EVENT, "parcels", False, StreamEventRule),
        StreamMethod(EACH, "parcels", False, SortEach, ("exact",)),
    ]
    if LEARNED in library.names():
        found.append(learned_method(LEARNED, library.load(LEARNED).card.control_period, _learned))
    return found


def learned_method(
    name: str, control_period: float, make: Callable[[EnvConfig], Controller]
) -> StreamMethod:
    """Make the method of a policy on a schedule, which decides each control period [s]."""
    return StreamMethod(
        name, "parcels", True, make, control_period=control_period, queue=library.QUEUE
    )


def _rung(
    name: str,
    actions: str,
    make: Callable[[EnvConfig], Controller | None],
    orientations: tuple[float, ...] | None = None,
) -> StreamMethod:
    return StreamMethod(name, actions, True, make, orientations=orientations, queue=library.QUEUE)


def _schedule(groups: ColumnGroups | None, config: EnvConfig) -> Scheduler | None:
    return make_scheduler(config, groups)


def _schedule_zones(
    shortest: int, count: int | None, exclusive: bool, config: EnvConfig
) -> Scheduler | None:
    """Make the scheduler of the zones that are predicted to let most parcels in, by their columns;
    None where none sort all.
    """
    rates: dict[ColumnGroups, float] = {}
    exact = replace(config, sensors=Exact(), randomisation=Randomisation())
    for columns in range(shortest, WIDEST + 1):
        if rates and columns > max(rates, key=rates.__getitem__).columns + LONGER:
            break
        groups = ColumnGroups(columns, count, exclusive)
        made = make_library(exact, groups, slack=CLEARANCES[0][0])
        if made.right.all() and np.isfinite(made.gaps).all():
            odds, queue = np.ones(len(made.signature)), config.stream_task.queue
            rates[groups] = predict_rate(made, odds, PREDICTED, queue)
    tried = (
        make_scheduler(config, groups)
        for groups in sorted(rates, key=rates.__getitem__, reverse=True)
    )
    return next((scheduler for scheduler in tried if scheduler is not None), None)


def _learned(config: EnvConfig) -> Controller:
    return library.load(LEARNED, config=config)


@dataclass(frozen=True)
class StreamResult:
    """A method on one stream under one preset."""

    method: str
    preset: str
    mix: str
    speed: float  # [m/s]
    exits: str
    actuators: int  # that turn axes; 0: it cannot sort such parcels at all, one at a time
    columns: int  # whose modules one of them turns; 0: it turns a single module
    modules: int  # that one of them turns
    capacity: Measurement | None  # at the highest rate that is sustained; None where none is
    best: float | None  # [parcels/h] that no schedule of its maneuvers exceeds

    @property
    def key(self) -> StreamKey:
        return ("flow", self.method, self.preset, self.mix, self.speed, self.exits)

    @property
    def turns(self) -> float:
        """[-] of actuators per parcel, at the capacity; nan where there is none."""
        return self.capacity.turns / self.modules if self.capacity is not None else math.nan


def stream_result(**plain: Any) -> StreamResult:
    """Make a result from its fields as JSON has them."""
    if plain["capacity"] is not None:
        plain["capacity"] = Measurement(**plain["capacity"])
    return StreamResult(**plain)


def compute_stream(method: StreamMethod, case: Case) -> StreamResult:
    """Measure a method on one stream."""
    config = method.config(case, case.ceiling)
    controller = method.make(config)
    capacity = best = None
    actuators, columns, modules = 0, 0, 1
    if controller is not None:
        actuators, columns, modules = _count_hardware(config, controller)
        capacity = limits.find_capacity(method, controller, case)
    if isinstance(controller, Scheduler):
        made = controller.library
        best = clairvoyant_bound(made, np.ones(len(made.signature)))
    return StreamResult(
        method.name, case.preset, case.mix, case.speed, case.exits, actuators, columns, modules,
        capacity, best,
    )  # fmt: skip


def _count_hardware(config: EnvConfig, controller: Controller) -> tuple[int, int, int]:
    """Count actuators, and the columns and modules that one of them turns."""
    first_row, rows, first, obeying = config.site.zone
    grid = config.site.rotor[first_row : first_row + rows, first : first + obeying]
    lead = controller.library.lead if isinstance(controller, Scheduler) else None
    if lead is None or lead.groups is None:
        return int(grid.sum()), 0, 1
    each = [int(grid[:, begin:end].sum()) for begin, end in lead.spans.tolist()]
    return sum(count > 0 for count in each), lead.groups.columns, max(each)


def stream_jobs(
    methods: Sequence[StreamMethod], exits: Sequence[str] = ("sides",)
) -> dict[StreamKey, Callable[[], StreamResult]]:
    """List every result to compute, by its key; the slowest first, to fill the cores."""
    some = [
        (method, case)
        for method in methods
        for preset in method.presets
        for each in exits
        for case in cases(preset, each)
    ]
    # A search goes on for long where there is no gate; where sensors err, more is tried.
    some.sort(key=lambda job: (job[0].gate, job[1].preset == "exact"))
    return {
        ("flow", method.name, case.preset, case.mix, case.speed, case.exits): partial(
            compute_stream, method, case
        )
        for method, case in some
    }


def compute_streams(
    methods: Sequence[StreamMethod],
    workers: Workers,
    folder: Path | None = None,
    advance: Advance = lambda *_: None,
    exits: Sequence[str] = ("sides",),
) -> list[StreamResult]:
    """Compute all results, in an order that does not depend on the processes."""
    file = None if folder is None else folder / FILE
    found = compute_kept(stream_jobs(methods, exits), stream_result, workers, file, advance)
    names, presets = [method.name for method in methods], list(limits.STREAM_PRESETS)
    return sorted(
        found.values(),
        key=lambda row: (
            exits.index(row.exits), names.index(row.method), presets.index(row.preset), row.mix,
            row.speed,
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class StreamResults:
    """All results."""

    rows: tuple[StreamResult, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(row.method for row in self.rows))

    @cached_property
    def exits(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(row.exits for row in self.rows))

    @cached_property
    def _found(self) -> dict[tuple[str, Case], StreamResult]:
        return {
            (row.method, Case(row.mix, row.speed, row.preset, row.exits)): row for row in self.rows
        }

    def find(self, name: str, case: Case) -> StreamResult | None:
        """Find the result of a method; None where it did not run."""
        return self._found.get((name, case))

    def capacity(self, name: str, case: Case) -> Measurement | None:
        """Find the measurement at a method's capacity, if it has any."""
        row = self.find(name, case)
        return None if row is None else row.capacity

    def rate(self, name: str, case: Case) -> float:
        """Find the capacity [parcels/h] of a method; 0 where there is none, nan where the method
        did not run.
        """
        row = self.find(name, case)
        if row is None:
            return math.nan
        return 0.0 if row.capacity is None else row.capacity.rate

    def difference(self, name: str, other: str, case: Case) -> tuple[float, float] | None:
        """Subtract the capacity of another, and find half of the 95 % interval [parcels/h]; None
        where one has none.

        Replications are paired where both were offered the same parcels at the same times.
        """
        one, two = self.capacity(name, case), self.capacity(other, case)
        if one is None or two is None:
            return None
        if (one.offered, len(one.right)) == (two.offered, len(two.right)):
            each = one.rates - two.rates
            return float(each.mean()), half_interval(each)
        return one.rate - two.rate, math.hypot(one.margin, two.margin)

    def leader(self, case: Case) -> str | None:
        """Find the method whose capacity is above that of every other, beyond the interval."""
        able = [name for name in self.names if self.capacity(name, case) is not None]
        if not able:
            return None
        first = max(able, key=lambda name: self.rate(name, case))
        apart = [self.difference(first, name, case) for name in able if name != first]
        ahead = [each is not None and each[0] > each[1] for each in apart]
        return first if ahead and all(ahead) else None


def stream_tables(results: StreamResults) -> list[Table]:
    """Make all tables, the one that says most first."""
    return [
        make(results, preset, exits)
        for exits in results.exits
        for make in (ladder_table, step_table)
        for preset in limits.STREAM_PRESETS
    ]


def ladder_table(results: StreamResults, preset: str, exits: str = "sides") -> Table:
    """Show the hardware of each method, its capacity on all streams, touches and turns."""
    streams = cases(preset, exits)
    leaders = [results.leader(case) for case in streams]
    rows = []
    for name in _tried(results, preset, exits):
        found = [row for case in streams if (row := results.find(name, case)) is not None]
        able = [row.capacity for row in found if row.capacity is not None]
        cells = [
            bold(cell) if name == leader else cell
            for cell, leader in zip(map(_capacity, found), leaders, strict=True)
        ]
        delivered = sum(sum(each.delivered) for each in able)
        touches = 1000.0 * sum(sum(each.touches) for each in able) / max(1, delivered)
        turns = float(np.mean([row.turns for row in found if row.capacity] or [math.nan]))
        rows.append(
            (
                name, _span([row.actuators for row in found if row.actuators]), *cells,
                f"{touches:.1f}" if able else NOTHING,
                f"{turns:.1f}" if able else NOTHING,
            )
        )  # fmt: skip
    for name in (MODULES, SIX_MODULES):
        best = [row.best if (row := results.find(name, case)) else None for case in streams]
        cells = [NOTHING if each is None else f"{each:.0f}" for each in best]
        if any(best):
            rows.append((BEST.format(name), NOTHING, *cells, NOTHING, NOTHING))
    bound = [f"{case.ceiling:.0f}" for case in streams]
    rows.append((ENTRANCE, NOTHING, *bound, NOTHING, NOTHING))
    return Table(
        _title("ladder of hardware", preset, exits),
        f"{_meaning(preset, exits)} In bold what is above every other method by more than that "
        "interval. Actuators turn axes, of a module, a column or a zone; all deliver through the "
        "same 6 m of line. A layout that is arranged once and for all sorts nothing: it leads all "
        "parcels one way. Touches per 1000 deliveries, and actuators' turns per parcel, are the "
        f"means of all streams. {_zones(results, preset, exits)}No controller can exceed the row "
        f"“{ENTRANCE}”; no schedule of a rung's maneuvers can exceed what is best known for it, "
        "on a long stream, but other maneuvers might.",
        (
            "controller", "actuators", *(case.label for case in streams), "touches/1000",
            "turns/parcel",
        ),
        tuple(rows),
    )  # fmt: skip


def _capacity(row: StreamResult) -> str:
    if row.capacity is not None:
        return f"{row.capacity.rate:.0f} ±{row.capacity.margin:.0f}"
    return "0" if row.actuators else CANNOT


def _span(values: Sequence[int]) -> str:
    """Write the least and the greatest of some numbers."""
    if not values:
        return NOTHING
    low, high = min(values), max(values)
    return str(low) if low == high else f"{low} to {high}"


def _zones(results: StreamResults, preset: str, exits: str) -> str:
    """Say how many columns were chosen for the zones of each stream."""
    said = []
    for name in (ARRANGED, FOLLOWED, SERIES):
        found = [results.find(name, case) for case in cases(preset, exits)]
        if any(found):
            each = ", ".join(str(row.columns) if row and row.columns else CANNOT for row in found)
            said.append(f"{name}: {each}")
    return f"Columns of a zone, stream by stream: {'; '.join(said)}. " if said else ""


def step_table(results: StreamResults, preset: str, exits: str = "sides") -> Table:
    """Show what each rung has over the one below it."""

    def text(name: str, other: str, case: Case) -> str:
        found = results.difference(name, other, case)
        if found is None:
            return NOTHING
        change = 100.0 * found[0] / results.rate(other, case)
        return f"{found[0]:+.0f} ±{found[1]:.0f} ({change:+.1f} %)"

    streams, names = cases(preset, exits), _tried(results, preset, exits)
    rows = [
        (f"{name} over {other}", *(text(name, other, case) for case in streams))
        for name, other in STEPS
        if name in names and other in names
    ]
    return Table(
        _title("what a rung has over another", preset, exits),
        "difference of capacities [parcels/h], with Student's 95 % interval of the replications "
        f"in pairs, since they met the same parcels; {_exits(exits)}",
        ("rungs", *(case.label for case in streams)),
        tuple(rows),
    )


def _title(title: str, preset: str, exits: str) -> str:
    return f"flow: {title}, {limits.STREAM_PRESETS[preset].label}, exits “{exits}”"


def _exits(exits: str) -> str:
    return f"exits “{exits}”: {limits.EXITS[exits]}"


def _meaning(preset: str, exits: str) -> str:
    return (
        f"Right deliveries an hour, at equal odds to the {_exits(exits)}. They are those of the "
        "highest steady rate at which "
        f"{100.0 * limits.LEAST_RIGHT[preset]:g} % of deliveries are right and nothing jams, "
        f"with Student's 95 % interval over {limits.REPLICATIONS} replications. "
        f"{limits.STREAM_PRESETS[preset].meaning}"
    )


def _tried(results: StreamResults, preset: str, exits: str) -> list[str]:
    case = cases(preset, exits)[0]
    return [name for name in results.names if results.find(name, case) is not None]


def stream_numbers(results: StreamResults) -> list[dict[str, Any]]:
    """List every number, a row for each."""
    rows = []
    for row in results.rows:
        case = Case(row.mix, row.speed, row.preset, row.exits)
        values: dict[str, float] = {
            "capacity": results.rate(row.method, case),
            "actuators": row.actuators,
            "columns of a zone": row.columns,
            "entrance": case.ceiling,
        }
        if row.best is not None:
            values["best known"] = row.best
        if row.capacity is not None:
            values |= {
                "margin": row.capacity.margin,
                "offered": row.capacity.offered,
                "share right": row.capacity.share_right,
                "touches per 1000": row.capacity.touches_per_1000,
                "waiting": row.capacity.waited,
                "turns per parcel": row.turns,
            }
        rows += [
            {
                "controller": row.method,
                "preset": row.preset,
                "exits": row.exits,
                "parcels": row.mix,
                "speed": row.speed,
                "metric": name,
                "value": value,
            }
            for name, value in values.items()
        ]
    return rows
