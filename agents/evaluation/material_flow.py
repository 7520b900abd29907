"""Controllers of material flow on a slope, compared: singulation, merging, sequencing.

Every controller meets the same parcels, offered as fast as the surface takes them; an order is
asked at the highest rate at which it holds.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import surface_gym as sg
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.inlets import side_by_side
from surface_gym.flow.merge import lines
from surface_gym.flow.sequence import shuffled
from surface_gym.flow.state import JAM, RIGHT
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import Stops, TakeAwayTask, bulk
from surface_gym.parallel import Workers
from surface_gym.parcel import Parcel, assortment
from surface_gym.state import RUNNING

from ..base import BatchController, Controller, Numbers, find_axes
from ..rules.sequencing import PassAndPark
from ..rules.singulation import HoldAndRelease, TimeSlots
from ..scheduling.scheduler import begin_streams
from .benchmark import SEED, Advance, compute_kept, half_interval
from .tables import NOTHING, Table, bold, write_markdown, write_numbers

NAME = "material-flow"
FILE = f"{NAME}.jsonl"
TASKS = ("singulate", "merge", "sequence")
REPLICATIONS = 10
SECONDS = 200.0  # [s] of each
ALIGNMENT = math.radians(10.0)
TEXTS = ("scenario", "method", "preset", "rates")  # fields of a result that are no numbers
OFFERED = {"singulate": 14_000.0, "merge": 10_000.0}  # [parcels/h] more than anybody takes
IN_ORDER = 0.999  # [-] share of parcels that must leave in their order
RATES = tuple(np.arange(600.0, 3400.0, 200.0).tolist())  # [parcels/h] at which orders are tried
NEVER_SEEN, SHAPES_SEED = 64, 20_280  # shapes of the lab: those of no tuning
LAB = PRESETS["lab"]
COMPARED: dict[str, dict[str, Any]] = {
    "exact": {},
    "camera": {
        "sensors": sg.sensors.Camera(), "randomisation": sg.Randomisation(friction=0.2),
    },
    "lab": {
        "sensors": LAB.sensors, "randomisation": LAB.randomisation, "actuators": LAB.actuators,
    },
}  # fmt: skip


class RollOn(BatchController):
    """Let every parcel roll."""

    _dims = 2

    def __init__(self, config: EnvConfig) -> None:
        self._size = config.action_kind.size
        self._choice = find_axes(config).roll

    def _predict(self, batch: Any, *_: Any, **__: bool) -> tuple[Any, None]:
        return np.full((len(batch), self._size), self._choice), None


Make = Callable[[EnvConfig], Controller]
SINGLE: dict[str, Make] = {
    "roll on": RollOn, "hold and release": HoldAndRelease, "time slots": TimeSlots,
}  # fmt: skip


@dataclass(frozen=True)
class Scenario:
    """A task, what it asks, and who does it."""

    task: str
    name: str
    arguments: tuple[tuple[str, Any], ...]  # of the environment
    methods: tuple[tuple[str, Make], ...]
    window: int = 0  # of the order; 0: none is asked

    def config(self, preset: str, rate: float) -> EnvConfig:
        """Configure the environment at a rate [parcels/h]."""
        given = COMPARED[preset]
        stream = self.stream(rate)
        if preset == "lab":
            shapes = assortment(NEVER_SEEN, SHAPES_SEED)
            stream = replace(stream, parcels=tuple((each, 1.0) for each in shapes))
        return EnvConfig(
            self.task, actions="parcels", duration=SECONDS, stream=stream,
            **dict(self.arguments), **given,
        )  # fmt: skip

    def stream(self, rate: float) -> Stream:
        """Make the stream of parcels at a rate [parcels/h]."""
        if self.window:
            return shuffled(rate, self.window)
        return bulk(rate) if self.task == "singulate" else lines(rate)


def scenarios(tasks: Sequence[str] = TASKS) -> list[Scenario]:
    """List the scenarios of some tasks."""
    aligned = ("alignment", ALIGNMENT)
    singles, order = tuple(SINGLE.items()), (("pass and park", PassAndPark),)
    found = [
        Scenario("singulate", "anywhere across", (), singles),
        Scenario("singulate", "mouth of 0.6 m, 10 deg", (("exits", "mouth"), aligned), singles),
        Scenario("singulate", "two mouths, 10 deg", (("exits", "mouths"), aligned), singles),
        Scenario(
            "singulate", "mouth, take-away stops",
            (("exits", "mouth"), aligned, ("demand", Stops())), singles[1:],
        ),
        Scenario("merge", "three lines", (), singles),
        Scenario("merge", "two lines", (("inlets", side_by_side(2)),), singles),
        *(Scenario("sequence", f"window of {k}", (), order, k) for k in (2, 4, 8)),
    ]  # fmt: skip
    return [each for each in found if each.task in tasks]


@dataclass(frozen=True)
class MaterialFlowResult:
    """A controller under one scenario and preset, over all replications."""

    scenario: str
    method: str
    preset: str
    rates: list[float]  # [parcels/h] of right parcels, of each replication
    right: float  # [-] share of the parcels that left
    right_gaps: float  # [-] share
    aligned: float  # [-] share
    beside: float  # [-] share that left beside the mouths or over the sides
    order_errors: float  # [-] share that left too early
    touches_per_1000: float
    impulse: float  # [N s] largest
    squeeze: float  # [N] largest
    time: float  # [s] on the surface, mean
    unfairness: float  # [s] difference of the inlets' mean waits
    jams: int  # replications that ended so
    bound: float  # [parcels/h] that nobody exceeds

    @property
    def key(self) -> tuple[str, str, str, str]:
        return ("material", self.scenario, self.method, self.preset)

    @property
    def rate(self) -> float:
        return float(np.mean(self.rates))


def narrowest(parcel: Parcel) -> float:
    """Compute the least extent [m] of a base, however it is turned: across one of its edges."""
    if not len(parcel.body.edges):
        return 2.0 * parcel.base.reach
    outline = parcel.base.outline
    normals = np.asarray(parcel.base.edges)[:, :2]
    return float(np.ptp(outline @ normals.T, axis=0).min())


def take_away_bound(config: EnvConfig) -> float:
    """Compute the rate [parcels/h] at which parcels lie on the take-away as close as is allowed,
    each with its least extent along it; nobody delivers more rightly, by one mouth or by each.
    """
    task = config.stream_task
    assert isinstance(task, TakeAwayTask)
    odds = np.array([each for _, each in task.stream.parcels])
    extent = np.array([narrowest(parcel) for parcel, _ in task.stream.parcels])
    mean = float((odds * extent).sum() / odds.sum())
    return HOUR * len(config.exits) * task.take_away / (mean + task.gap)


def play(config: EnvConfig, controller: Controller) -> StreamBatch:
    """Play all replications of a stream to their end."""
    batch = begin_streams(config, REPLICATIONS, SEED)
    fresh = np.ones(REPLICATIONS, dtype=np.bool_)
    state = None
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state, fresh)
        batch.step(config.action_kind.commands(action, REPLICATIONS))
        fresh[:] = False
    return batch


def _measure(
    scenario: Scenario, method: str, preset: str, config: EnvConfig, controller: Controller
) -> MaterialFlowResult:
    batch = play(config, controller)
    task, streams = config.stream_task, batch.streams
    jammed = batch.outcome == JAM
    found = [task.compute_statistics(streams, k, bool(jammed[k]), 1) for k in range(REPLICATIONS)]
    delivered = np.array([each.delivered for each in found])

    def mean(name: str) -> float:
        values = np.array([getattr(each, name) for each in found], dtype=np.float64)
        some = np.isfinite(values)
        if not some.any():
            return math.nan
        return float(np.average(values[some], weights=np.maximum(1, delivered)[some]))

    return MaterialFlowResult(
        scenario.name, method, preset,
        # A replication that jams counts to its end: nothing comes after it.
        rates=(HOUR * streams.tally[:, RIGHT] / SECONDS).tolist(),
        right=float(streams.tally[:, RIGHT].sum() / max(1, delivered.sum())),
        right_gaps=mean("right_gaps"), aligned=mean("aligned"), beside=mean("beside"),
        order_errors=mean("order_errors"), touches_per_1000=mean("touches_per_1000"),
        impulse=float(streams.impulse.max()), squeeze=float(streams.squeeze.max()),
        time=mean("time_mean"), unfairness=mean("unfairness"), jams=int(jammed.sum()),
        bound=take_away_bound(config),
    )  # fmt: skip


def compute(scenario: Scenario, method: str, preset: str) -> MaterialFlowResult:
    """Measure a method; an order at the highest rate of `RATES` at which it holds, or the least."""
    make = dict(scenario.methods)[method]
    rates = RATES[::-1] if scenario.window else (OFFERED[scenario.task],)
    for rate in rates:
        config = scenario.config(preset, rate)
        found = _measure(scenario, method, preset, config, make(config))
        if not scenario.window or (found.right >= IN_ORDER and found.jams == 0):
            break
    return found


def compute_material_flow(
    tasks: Sequence[str],
    workers: Workers,
    folder: Path | None = None,
    advance: Advance = lambda *_: None,
) -> list[MaterialFlowResult]:
    """Compute all results of some tasks."""
    jobs = {
        ("material", each.name, method, preset): partial(compute, each, method, preset)
        for each in scenarios(tasks)
        for method, _ in each.methods
        for preset in COMPARED
    }
    file = None if folder is None else folder / FILE
    return list(compute_kept(jobs, MaterialFlowResult, workers, file, advance).values())


def material_flow_tables(results: Sequence[MaterialFlowResult]) -> list[Table]:
    """Show what each method delivers under each preset, a table a task."""
    tables = []
    for task in TASKS:
        names = [each.name for each in scenarios((task,))]
        rows = [each for each in results if each.scenario in names]
        if rows:
            tables.append(_table(task, rows))
    return tables


def _table(task: str, results: Sequence[MaterialFlowResult]) -> Table:
    rows = []
    for name in dict.fromkeys(each.scenario for each in results):
        here = [each for each in results if each.scenario == name]
        for preset in COMPARED:
            group = [each for each in here if each.preset == preset]
            best = max(group, key=lambda each: each.rate, default=None)
            rows += [_row(each, each is best and _is_ahead(each, group)) for each in group]
    asked = (
        f"at the highest rate, in steps of {RATES[1] - RATES[0]:g} an hour, at which "
        f"{100.0 * IN_ORDER:g} % of all parcels leave rightly and none of the streams jams"
        if task == "sequence"
        else "offered more than the surface takes"
    )
    return Table(
        f"{task} on a slope",
        f"Right parcels an hour with Student's 95 % interval, over {REPLICATIONS} streams of "
        f"{SECONDS:g} s that are the same for all, {asked}: the best in bold where the paired "
        "intervals of all others lie below. Shares of right parcels, of gaps of at least 0.3 m on "
        "the take-away at 2 m/s, of aligned parcels, and of those that left beside the mouths or "
        "over the sides; touches per 1000; the largest force between two; streams that jammed. "
        "Nobody exceeds the bound: there all lie with their narrowest side along the take-away.",
        (
            "scenario", "preset", "method", "right an hour", "right", "gaps", "aligned",
            "beside", "touches", "squeeze [N]", "time [s]", "jams", "bound",
        ),
        tuple(rows),
    )  # fmt: skip


def _is_ahead(best: MaterialFlowResult, group: Sequence[MaterialFlowResult]) -> bool:
    """Whether a method is ahead of every other beyond the interval of their differences."""
    others = [np.array(best.rates) - each.rates for each in group if each is not best]
    return bool(others) and all(apart.mean() > half_interval(apart) for apart in others)


def _row(row: MaterialFlowResult, ahead: bool) -> tuple[str, ...]:
    rates: Numbers = np.array(row.rates)
    rate = f"{row.rate:.0f} ±{half_interval(rates):.0f}"

    def share(value: float) -> str:
        return f"{100.0 * value:.2f} %" if math.isfinite(value) else NOTHING

    return (
        row.scenario, row.preset, row.method, bold(rate) if ahead else rate, share(row.right),
        share(row.right_gaps), share(row.aligned), share(row.beside),
        f"{row.touches_per_1000:.0f}", f"{row.squeeze:.0f}", f"{row.time:.1f}", f"{row.jams}",
        f"{row.bound:.0f}",
    )  # fmt: skip


def material_flow_numbers(results: Sequence[MaterialFlowResult]) -> list[dict[str, Any]]:
    """List every number, a row for each."""
    rows = []
    for row in results:
        values = {name: value for name, value in vars(row).items() if name not in TEXTS}
        values = {"rate": row.rate, "margin": half_interval(np.array(row.rates)), **values}
        rows += [
            {
                "scenario": row.scenario, "method": row.method, "preset": row.preset,
                "metric": name, "value": value,
            }
            for name, value in values.items()
        ]  # fmt: skip
    return rows


def write_material_flow(
    results: Sequence[MaterialFlowResult], folder: Path, console: Console
) -> list[Table]:
    """Write material-flow.md, .csv and .json into a folder, and show and return the tables."""
    tables = material_flow_tables(results)
    for table in tables:
        table.show(console)
    write_markdown(tables, folder / f"{NAME}.md")
    numbers = material_flow_numbers(results)
    write_numbers(numbers, folder / f"{NAME}.csv", folder / f"{NAME}.json")
    return tables
