"""The comparison on streams of parcels: methods, capacities, rates by load, and their tables."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.parallel import Workers

from .. import library
from ..base import Controller
from ..rules import reservation
from ..rules.streams import SortEach, StreamEventRule, StreamFixedLayout
from ..rules.zones import ArrangedZone, WholeZone, find_best_zone
from . import capacity as limits
from .benchmark import Advance, compute_kept
from .capacity import Case, Measurement, StreamMethod
from .methods import FIXED
from .tables import NOTHING, Table

FILE = "flow.jsonl"
EASED = 0.8  # [-] of the capacity, offered to see how well it goes with room to spare
LOADS = tuple(np.linspace(0.1, 1.0, 8).round(3).tolist())  # [-] offered, of the ceiling
SEARCHED = 0.0  # instead of a load: the capacity is searched for
CURVE = Case("S and B", 1.5)  # whose rate is shown by load

ARRANGED = "zone arranged when free"
TURNED = "zone turned as a whole"
EVENT = "event rule"
EACH = "sort-ppo for each"
RESERVATION = "reservation"
LEARNED = "flow-ppo"
BOUND = "single ways packed"
CEILING = "ceiling"
# Capacities that others are divided by, with short names for headings.
REFERENCES = {
    ARRANGED: "arranged", TURNED: "turned", EVENT: "event", BOUND: "packed", CEILING: "ceiling",
}  # fmt: skip
CANNOT = "cannot"  # sort all kinds, even one at a time

StreamKey = tuple[str, str, str, str, float, float]


def cases(preset: str = "exact") -> list[Case]:
    """List all mixes and speeds under a preset."""
    return [Case(mix, speed, preset) for mix in limits.MIXES for speed in limits.SPEEDS]


def stream_methods() -> list[StreamMethod]:
    """List every method for streams; those that a study's arrangement allows come first."""
    found = [
        StreamMethod(FIXED, "modules", False, StreamFixedLayout, ("exact",)),
        StreamMethod(ARRANGED, "modules", True, partial(_zone, ArrangedZone)),
        StreamMethod(TURNED, "modules", True, partial(_zone, WholeZone)),
        StreamMethod(EVENT, "parcels", False, StreamEventRule),
        StreamMethod(EACH, "parcels", False, SortEach, ("exact",)),
        StreamMethod(RESERVATION, "parcels", True, reservation.Reservation),
    ]
    if LEARNED in library.names():
        period = library.load(LEARNED).card.control_period
        found.append(StreamMethod(LEARNED, "parcels", True, _learned, control_period=period))
    return found


def _zone(kind: type[WholeZone], config: EnvConfig) -> WholeZone | None:
    columns = find_best_zone(kind, config)
    return None if columns is None else kind(config, columns)


def _learned(_config: EnvConfig) -> Controller:
    return library.load(LEARNED)


@dataclass(frozen=True)
class StreamResult:
    """A method on one stream under one preset."""

    method: str
    preset: str
    mix: str
    speed: float  # [m/s]
    load: float  # [-] offered, of the ceiling; or SEARCHED
    can: bool  # whether it can sort such parcels at all, one at a time
    capacity: Measurement | None  # at the highest rate that is sustained; None where none is
    # at 80 % of the capacity; with no capacity at the least rate tried; with a load at that
    eased: Measurement | None

    @property
    def key(self) -> StreamKey:
        return ("flow", self.method, self.preset, self.mix, self.speed, self.load)


def stream_result(**plain: Any) -> StreamResult:
    """Make a result from its fields as JSON has them."""
    for name in ("capacity", "eased"):
        if plain[name] is not None:
            plain[name] = Measurement(**plain[name])
    return StreamResult(**plain)


def compute_stream(method: StreamMethod, case: Case, load: float) -> StreamResult:
    """Measure a method on one stream."""
    controller = method.make(method.config(case, case.ceiling))
    capacity = eased = None
    if controller is not None and load == SEARCHED:
        capacity = limits.find_capacity(method, controller, case)
        rate = EASED * capacity.rate if capacity is not None else limits.LEAST * case.ceiling
        eased = limits.measure(method, controller, case, rate)
    elif controller is not None:
        eased = limits.measure(method, controller, case, load * case.ceiling)
    return StreamResult(
        method.name, case.preset, case.mix, case.speed, load, controller is not None, capacity,
        eased,
    )  # fmt: skip


def stream_jobs(
    methods: Sequence[StreamMethod], loads: Sequence[float] | None = None
) -> dict[StreamKey, Callable[[], StreamResult]]:
    """List every result to compute, by its key; the slowest first, to fill the cores."""
    searched = [
        (method, case, SEARCHED)
        for method in methods
        for preset in method.presets
        for case in cases(preset)
    ]
    # A search goes on for long where there is no gate.
    searched.sort(key=lambda job: (job[0].gate, -job[1].speed))
    some = LOADS if loads is None else loads
    by_load = [(method, CURVE, load) for method in methods for load in some]
    return {
        ("flow", method.name, case.preset, case.mix, case.speed, load): partial(
            compute_stream, method, case, load
        )
        for method, case, load in searched + by_load
    }


def compute_streams(
    methods: Sequence[StreamMethod],
    workers: Workers,
    folder: Path | None = None,
    advance: Advance = lambda *_: None,
    loads: Sequence[float] | None = None,
) -> list[StreamResult]:
    """Compute all results, in an order that does not depend on the processes."""
    file = None if folder is None else folder / FILE
    found = compute_kept(stream_jobs(methods, loads), stream_result, workers, file, advance)
    names, presets = [method.name for method in methods], list(limits.STREAM_PRESETS)
    return sorted(
        found.values(),
        key=lambda row: (names.index(row.method), presets.index(row.preset), *row.key[3:]),
    )


@dataclass(frozen=True)
class StreamResults:
    """All results, and the bound of every stream."""

    rows: tuple[StreamResult, ...]
    bounds: dict[tuple[str, float], float]  # [parcels/h] by mix and speed

    @classmethod
    def of(cls, methods: Sequence[StreamMethod], rows: Sequence[StreamResult]) -> "StreamResults":
        """Put results together, and compute the bounds by a method with actions for parcels."""
        method = next(each for each in methods if each.actions == "parcels")
        return cls(
            tuple(rows), {(case.mix, case.speed): packing_bound(method, case) for case in cases()}
        )

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(row.method for row in self.rows))

    @cached_property
    def _found(self) -> dict[tuple[str, Case, float], StreamResult]:
        return {
            (row.method, Case(row.mix, row.speed, row.preset), row.load): row for row in self.rows
        }

    def find(self, name: str, case: Case, load: float = SEARCHED) -> StreamResult | None:
        """Find the result of a method; None where it did not run."""
        return self._found.get((name, case, load))

    def capacity(self, name: str, case: Case) -> Measurement | None:
        """Find the measurement at a method's capacity, if it has any."""
        row = self.find(name, case)
        return None if row is None else row.capacity

    def rate(self, name: str, case: Case) -> float:
        """Find the capacity [parcels/h] of a method, or of the bound or the ceiling.

        0 where there is none, nan where the method did not run.
        """
        if name == BOUND:
            return self.bounds[case.mix, case.speed]
        if name == CEILING:
            return case.ceiling
        row = self.find(name, case)
        if row is None:
            return float("nan")
        return 0.0 if row.capacity is None else row.capacity.rate

    def ratio(self, name: str, over: str, case: Case) -> float:
        """Divide the rates of two; infinite over one that has none, nan where neither has any."""
        rate, reference = self.rate(name, case), self.rate(over, case)
        if reference > 0.0:
            return rate / reference
        return float("inf") if rate > 0.0 else float("nan")

    def curve(self, name: str) -> list[Measurement | None]:
        """List the measurement at each of LOADS."""
        rows = [self.find(name, CURVE, load) for load in LOADS]
        return [None if row is None else row.eased for row in rows]


def packing_bound(method: StreamMethod, case: Case) -> float:
    """Compute the rate [parcels/h] of single parcels' paths, packed as close as they go.

    The event rule leads each parcel alone; 2 cm stay between them.
    """
    config = method.config(case, case.ceiling)
    asked = reservation.list_asked(config)
    gaps = reservation.least_gaps(
        reservation.find_trajectories(StreamEventRule, config, asked).each, reservation.MARGIN
    )
    return reservation.packed_rate(gaps, np.ones(len(asked)))


def stream_tables(results: StreamResults) -> list[Table]:
    """Make all tables, the one that says most first."""
    return [
        headline(results),
        *(capacity_table(results, preset) for preset in limits.STREAM_PRESETS),
        *(eased_table(results, preset) for preset in limits.STREAM_PRESETS),
        *(touch_table(results, preset) for preset in limits.STREAM_PRESETS),
        *(ratio_table(results, over) for over in REFERENCES),
    ]


def headline(results: StreamResults) -> Table:
    """Show everything of one stream, exact."""
    case = CURVE
    rows = []
    for name in (*results.names, BOUND, CEILING):
        capacity = results.capacity(name, case)
        rows.append(
            (
                name,
                _rate(results, name, case),
                NOTHING if capacity is None else f"±{capacity.margin:.0f}",
                NOTHING if capacity is None else f"{capacity.touches_per_1000:.0f}",
                *(_ratio(results, name, over, case) for over in REFERENCES),
            )
        )
    return Table(
        "flow",
        f"{case.label}, 6 m of line, to leave left, right or straight on at equal odds. "
        f"{_meaning(limits.EXACT.name)} "
        "Behind the strokes: over the capacities of the two zones and the event rule, over single "
        "parcels' ways packed as close as they go, and over parcels end to end, 5 cm apart.",
        (
            "controller", "parcels/h", "95 %", "touches/1000",
            *(f"/{short}" for short in REFERENCES.values()),
        ),
        tuple(rows),
    )  # fmt: skip


def capacity_table(results: StreamResults, preset: str) -> Table:
    """Show right deliveries an hour at the capacity, all streams."""
    names = [*_tried(results, preset), BOUND, CEILING]
    caption = f"{_meaning(preset)} {limits.STREAM_PRESETS[preset].meaning}"
    text = _at_capacity(results, lambda found: f"{found.rate:.0f} ±{found.margin:.0f}")
    title = f"flow: capacity, {limits.STREAM_PRESETS[preset].label}"
    return _grid(title, caption, names, preset, text)


def touch_table(results: StreamResults, preset: str) -> Table:
    """Show touches at the capacity, all streams."""
    title = f"flow: touches at the capacity, {limits.STREAM_PRESETS[preset].label}"
    caption = "times that two begin to touch, per 1000 deliveries, at the capacity"
    text = _at_capacity(results, lambda found: f"{found.touches_per_1000:.0f}")
    return _grid(title, caption, _tried(results, preset), preset, text)


def _at_capacity(
    results: StreamResults, show: Callable[[Measurement], str]
) -> Callable[[str, Case], str]:
    """Make texts of what was measured at the capacity, if there is any."""

    def text(name: str, case: Case) -> str:
        found = results.capacity(name, case)
        return _rate(results, name, case) if found is None else show(found)

    return text


def ratio_table(results: StreamResults, over: str) -> Table:
    """Divide capacities by another's, exact."""
    names = [name for name in results.names if name not in (over, FIXED)]
    caption = f"capacity over that of: {over}; exact sensors"
    return _grid(
        f"flow: over {over}", caption, names, limits.EXACT.name,
        lambda name, case: _ratio(results, name, over, case),
    )  # fmt: skip


def eased_table(results: StreamResults, preset: str) -> Table:
    """Show deliveries, touches and waiting at 80 % of the capacity."""

    def text(name: str, case: Case) -> str:
        row = results.find(name, case)
        if row is None or row.eased is None:
            return CANNOT
        eased = row.eased
        return f"{eased.share_right:.4f}, {eased.touches_per_1000:.1f}, {eased.waited:.2f}"

    caption = (
        "share of deliveries that are right, touches per 1000, and seconds waited at the entry, "
        "offered 80 % of the capacity; a method that has none is offered a sixteenth of the ceiling"
    )
    title = f"flow: at 80 % of the capacity, {limits.STREAM_PRESETS[preset].label}"
    return _grid(title, caption, _tried(results, preset), preset, text)


def _grid(
    title: str, caption: str, names: Sequence[str], preset: str, text: Callable[[str, Case], str]
) -> Table:
    """Make a row for each method, a column for each stream."""
    streams = cases(preset)
    header = ("controller", *(case.label for case in streams))
    rows = ((name, *(text(name, case) for case in streams)) for name in names)
    return Table(title, caption, header, tuple(rows))


def _meaning(preset: str) -> str:
    return (
        "Right deliveries an hour at the highest steady rate at which "
        f"{100.0 * limits.LEAST_RIGHT[preset]:g} % of deliveries are right and nothing jams, "
        f"with Student's 95 % interval over {limits.REPLICATIONS} replications."
    )


def _tried(results: StreamResults, preset: str) -> list[str]:
    case = Case(CURVE.mix, CURVE.speed, preset)
    return [name for name in results.names if results.find(name, case) is not None]


def _rate(results: StreamResults, name: str, case: Case) -> str:
    rate = results.rate(name, case)
    if math.isnan(rate):
        return NOTHING
    if rate > 0.0:
        return f"{rate:.0f}"
    row = results.find(name, case)
    return "0" if row is not None and row.can else CANNOT


def _ratio(results: StreamResults, name: str, over: str, case: Case) -> str:
    ratio = results.ratio(name, over, case)
    return f"{ratio:.2f}" if math.isfinite(ratio) else NOTHING


def stream_numbers(results: StreamResults) -> list[dict[str, Any]]:
    """List every number, a row for each."""
    rows = []
    for row in results.rows:
        case = Case(row.mix, row.speed, row.preset)
        values: dict[str, float] = {}
        if row.load == SEARCHED:
            values["capacity"] = results.rate(row.method, case)
            if row.capacity is not None:
                values["capacity_margin"] = row.capacity.margin
                values["capacity_offered"] = row.capacity.offered
            for over in REFERENCES:
                values[f"capacity over {over}"] = results.ratio(row.method, over, case)
            values["bound"] = results.rate(BOUND, case)
            values["ceiling"] = results.rate(CEILING, case)
        if row.eased is not None:
            values |= {
                "offered": row.eased.offered,
                "rate": row.eased.rate,
                "rate_margin": row.eased.margin,
                "share_right": row.eased.share_right,
                "touches_per_1000": row.eased.touches_per_1000,
                "waiting": row.eased.waited,
                "jams": float(row.eased.jams),
            }
        rows += [
            {
                "controller": row.method,
                "preset": row.preset,
                "parcels": row.mix,
                "speed": row.speed,
                "load": "80 % of the capacity" if row.load == SEARCHED else row.load,
                "metric": name,
                "value": value,
            }
            for name, value in values.items()
        ]
    return rows
