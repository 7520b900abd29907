"""Streams: their scenarios, the search for a method's capacity, and Flow's ladder of hardware.

The capacity is the highest rate of arrivals that a method sustains. The ladder compares hardware:
its rungs differ in the number of modules per actuator, and every rung runs its best scheduler. A
replication is one episode of a stream.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.benchmarks import SIX
from surface_gym.flow.state import BETWEEN, CORRECT, JAM, TURNS, compute_statistics
from surface_gym.flow.task import Flow
from surface_gym.parcel import assortment
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Exact
from surface_gym.state import ENERGIES, RUNNING
from surface_gym.tasks.benchmark import ENTRANCE, Offer, StreamBenchmark

from .. import library
from ..base import Booleans, Controller
from ..planning.planner import RecedingHorizon
from ..rules.sorting import SortEach, StreamEventRule
from ..scheduling.decisions import make_model_library
from ..scheduling.maneuvers import ColumnGroups, make_library
from ..scheduling.scheduler import (
    CLEARANCES,
    Scheduler,
    begin_streams,
    clairvoyant_bound,
    entrance_bound,
    find_plain,
    make_scheduler,
    predict_rate,
)
from .method import METHODS, PLANNER, Method, seedless, shipped, stream_benchmark
from .scenario import SEED, WHOLE, Extent, Row, Scenario, ScenarioJob, make_jobs

NEVER_SEEN, SHAPES_SEED = 64, 20_280  # shapes of the lab on streams, never tuned on
# [-] required share of correct deliveries for a sustained rate
LEAST_CORRECT = {"exact": 0.999, "camera": 0.995}
IN_ORDER = 0.999  # [-] required share of correct departures at one of several rates
PRECISION = 1.02  # [-] ratio between a failing and a sustained rate
LEAST = 1.0 / 16.0  # [-] smallest tried rate relative to the entry limit
CARRIED = 0.98  # [-] required share of the offered rate, so that the queue does not grow
CHECK_EVERY = 10  # control periods between checks of whether a rate can still be sustained
QUIET = 30.0  # [s] time at a stream's end without departures that counts as a jam
STREAM_PRESETS = {
    "exact": Preset("exact", "exact", "Sensors show pose and velocity as they are."),
    "camera": Preset(
        "camera",
        "camera",
        "A camera's frames, 1 mm and 0.5 deg off and 20 ms late, and a filter; mu_max differs from "
        "parcel to parcel by up to 20 %.",
        sensors=sg.sensors.Camera(),
        randomisation=sg.Randomisation(friction=0.2),
    ),
    "lab": PRESETS["lab"],
}
UNSEEN = "unseen"  # preset of offers with their own sensors


@dataclass(frozen=True)
class StreamScenario(Scenario):
    """A stream at one offered rate, or at the highest rate that the method sustains."""

    offered: str  # name of the offered stream

    @property
    def name(self) -> str:
        return self.offered

    @property
    def benchmark(self) -> StreamBenchmark:
        return stream_benchmark(self.task)

    @property
    def offer(self) -> Offer:
        made = self.benchmark
        return next(each for each in (*made.offers, *made.held_out) if each.scenario == self.name)

    @property
    def least_correct(self) -> float:
        """[-] share of deliveries that must be correct so that a rate counts as sustained."""
        return LEAST_CORRECT[self.preset]

    def accepts(self, method: Method) -> bool:
        return super().accepts(method) and method.kind in self.offer.kinds

    def episodes(self, method: Method) -> int:
        count = self.benchmark.replications
        asked = (count, self.extent.replications, method.most)
        return min(each for each in asked if each is not None)

    def config(self, method: Method, rate: float | None = None) -> EnvConfig:
        """Return the configuration of a method's environment at an offered rate [parcels/h].

        Args:
            rate: if `rate` is None, use the first of the offer's rates. If the offer has no rates,
                use the entry limit. If the first rate is None, keep the stream's own rate.
        """
        offer = self.offer
        task = replace(offer.task, duration=min(offer.task.duration, self.extent.duration))
        given: dict[str, Any] = {**method.arguments, **offer.arguments}
        if self.preset in STREAM_PRESETS:
            given["preset"] = STREAM_PRESETS[self.preset]
        stream = task.stream
        if self.preset == "lab":
            shapes = assortment(NEVER_SEEN, SHAPES_SEED)
            stream = replace(stream, parcels=tuple((each, 1.0) for each in shapes))
        config = EnvConfig(task=task, **given, stream=stream)
        if method.kind == PLANNER:  # planners know the true state
            config = config.replace(sensors=Exact())
        asked = (*offer.rates, ENTRANCE)[0] if rate is None else rate
        if asked is None:
            return config
        asked = entrance_bound(config) if asked == ENTRANCE else asked
        return config.replace(stream=stream.with_rate(asked))

    def play(self, method: Method, seed: int) -> list[Row]:
        offer, config = self.offer, self.config(method)
        controller = method.controller(config, seed, offer.most_touches)
        if not offer.rates:
            return self._search(method, config, controller)
        rows: list[Row] = []
        for rate in offer.rates:
            config = self.config(method, rate)
            rows = self._measure(method, config, controller or method.controller(config, seed))
            if len(offer.rates) == 1 or is_sustained(rows, IN_ORDER):
                break
            controller = None
        is_full = offer.rates == (ENTRANCE,)
        bound = entrance_bound(config) if is_full else config.stream_task.rate_bound(config)
        return [{**row, "bound": bound} for row in rows]

    def _search(
        self, method: Method, config: EnvConfig, controller: Controller | None
    ) -> list[Row]:
        """Return rows at a method's highest sustained rate, or rows of NaN if no rate is sustained.

        `controller` is the method's controller, or None if the method cannot sort the stream.
        """
        ceiling, least = entrance_bound(config), self.least_correct
        fixed = {"actuators": 0, "columns": 0, "modules": 1, "bound": ceiling, "best": math.nan}
        rows: list[Row] | None = None
        if controller is not None:

            def sustained(rate: float) -> list[Row] | None:
                found = self._measure(method, self.config(method, rate), controller, least)
                return found if found and is_sustained(found, least) else None

            hardware = count_hardware(config, controller)
            fixed |= dict(zip(("actuators", "columns", "modules"), hardware, strict=True))
            rows = find_capacity(sustained, ceiling, config.stream_task.gate)
        if isinstance(controller, Scheduler):
            made = controller.library
            fixed["best"] = clairvoyant_bound(made, np.ones(len(made.signature)))
        nothing: Row = {"offered": math.nan, "counted": math.nan, "correct": math.nan}
        return [{**row, **fixed} for row in rows or [nothing] * self.episodes(method)]

    def _measure(
        self, method: Method, config: EnvConfig, controller: Controller, least_correct: float = 0.0
    ) -> list[Row]:
        warm_up = self.benchmark.warm_up
        batch = play_stream(config, controller, self.episodes(method), warm_up, least_correct)
        return [] if batch is None else measure_stream(batch, warm_up)


def stream_scenarios(
    task: str, extent: Extent = WHOLE, groups: Sequence[str] = ()
) -> list[StreamScenario]:
    """List the streams of a task's benchmark under each preset, within the limits of `extent`.

    Args:
        groups: names of groups of streams. Unknown names are ignored. Without a known name, the
            benchmark's first group is listed.
    """
    benchmark = stream_benchmark(task)
    known = list(dict.fromkeys(each.group for each in benchmark.offers))
    offers = list(benchmark.offers)
    if extent.offers is not None:  # the example first
        offers.sort(key=lambda each: each.name != benchmark.filmed)
    return [
        StreamScenario(task, preset, extent, offer.scenario)
        for group in [each for each in groups if each in known] or known[:1]
        for preset in benchmark.presets
        if extent.presets is None or preset in extent.presets
        for offer in [each for each in offers if each.group == group][: extent.offers]
    ]


def unseen_jobs(task: str, extent: Extent = WHOLE) -> list[ScenarioJob]:
    """List jobs that run scheduler and agents on unseen streams; `extent` limits the jobs."""
    offers = stream_benchmark(task).held_out[: extent.offers]
    scenarios = [StreamScenario(task, UNSEEN, extent, offer.scenario) for offer in offers]
    scheduler = _rung(SCHEDULER, "parcels", make_best_scheduler)
    return make_jobs(scenarios, [scheduler, *_learned()]) if scenarios else []


def counted_time(duration: float, rate: float, warm_up: float) -> float:
    """Return the time [s] in which deliveries count: the duration without the warm-up [s].

    The time is rounded down to a whole number of gaps between arrivals, at least one gap. The
    `rate` [parcels/h] determines the gaps. So the number of counted deliveries does not depend on
    the time of the first arrival.
    """
    gap = HOUR / rate
    return min(duration, gap * max(1, math.floor((duration - warm_up) / gap + 1e-9)))


def play_stream(
    config: EnvConfig, controller: Controller, count: int, warm_up: float = 0.0,
    least_correct: float = 0.0, seed: int = SEED,
) -> StreamBatch | None:  # fmt: skip
    """Run `count` replications of a stream to the end.

    Args:
        warm_up: [s] time at the start in which wrong deliveries do not count.
        least_correct: [-] required share of correct deliveries. If the share is 0, never return
            None. Otherwise return None after a jam, or once the share has become impossible.
    """
    batch = begin_streams(config, count, seed)
    if isinstance(controller, RecedingHorizon):
        controller.watch(batch)
    begin = config.stream_task.duration - _counted(config, warm_up)
    most_wrong = (1.0 - least_correct) * int(batch.streams.arrivals.sum())
    fresh = np.ones(count, dtype=np.bool_)
    state, period = None, 0
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state, fresh)
        batch.step(config.action_kind.commands(action, count))
        fresh[:] = False
        period += 1
        if least_correct and period % CHECK_EVERY == 0 and _is_lost(batch, begin, most_wrong):
            return None
    return batch


def _counted(config: EnvConfig, warm_up: float) -> float:
    """Return the time [s] of an episode in which deliveries count; see `counted_time`."""
    task = config.stream_task
    if not warm_up:
        return task.duration
    rate = getattr(task.stream.arrivals, "rate", None)
    if rate is None:  # a recorded stream
        return max(0.0, task.duration - warm_up)
    return counted_time(task.duration, rate, warm_up)


def _is_lost(batch: StreamBatch, begin: float, most_wrong: float) -> bool:
    streams = batch.streams
    wrong = (
        (streams.departed >= begin) & (streams.taken >= BETWEEN) & (streams.taken != streams.exit)
    )
    return bool((streams.outcome == JAM).any() or wrong.sum() > most_wrong)


def find_jams(batch: StreamBatch) -> Booleans:
    """Return a mask (surfaces,) of the surfaces whose stream has jammed.

    Either the stream ended in a jam, or parcels are present and no parcel departed for `QUIET` s.
    The environment detects a jam only if nothing moves. Parcels that tremble behind each other have
    jammed, too.
    """
    streams = batch.streams
    last = np.fmax.reduce(streams.departed, axis=1, initial=0.0)
    quiet = (streams.clock - last > QUIET) & streams.present.any(axis=1)
    return (batch.outcome == JAM) | quiet


def measure_stream(batch: StreamBatch, warm_up: float = 0.0) -> list[Row]:
    """Return a row of numbers for each replication, measured after the time `warm_up` [s].

    A jam does not shorten the measured time. If `EnvConfig.info` requests energies, a row also has
    the energies. The energies include the warm-up.
    """
    streams, config = batch.streams, batch.config
    task, counted = config.stream_task, _counted(config, warm_up)
    begin = task.duration - counted
    offered = getattr(task.stream.arrivals, "rate", math.nan)
    jams, rows = find_jams(batch), []
    infos = batch.infos() if config.meters else {}
    if "axis_turns" in infos:
        infos["axis_turns"] = infos["axis_turns"].sum(axis=(1, 2))
    for k in range(batch.num_envs):
        jam = bool(jams[k])
        found = asdict(
            compute_statistics(streams, k, jam, 1, begin)
            if warm_up
            else task.compute_statistics(streams, k, jam, 1)
        )
        delivered, correct = found["delivered"], int(streams.tally[k, CORRECT])
        if warm_up:
            correct = round(delivered * (1.0 - found["missort_rate"])) if delivered else 0
        rows.append(
            {
                "offered": offered, "counted": counted, "correct": correct, "jam": jam,
                "sorted": int(streams.tally[k, CORRECT]), "turns": int(streams.tally[k, TURNS]),
                **found,
                **{name: infos[name][k] for name in (*ENERGIES, "axis_turns") if name in infos},
            }
        )  # fmt: skip
    return rows


def is_sustained(rows: Sequence[Row], least_correct: float) -> bool:
    """Return whether no row has a jam, and total correct / delivered is >= `least_correct` [-]."""
    correct, delivered = (sum(row[name] for row in rows) for name in ("correct", "delivered"))
    return not any(row["jam"] for row in rows) and correct / max(1, delivered) >= least_correct


def find_capacity(
    sustained: Callable[[float], list[Row] | None], ceiling: float, gate: bool
) -> list[Row] | None:
    """Return the results at the highest sustained rate, or None if no rate is sustained.

    The rate is accurate to 2 %. The search tries the entry limit first. If the entry limit
    is not sustained, the rate is halved until a rate is sustained, and then increased by bisection.
    If the entry limit is sustained on a line with a gate, the search ends, because parcels wait for
    room. Without a gate, parcels push each other, so a lower rate may deliver more. Therefore the
    search also tries lower rates.

    Args:
        sustained: returns the rows at a rate [parcels/h], or None if the rate is not sustained.
        ceiling: [parcels/h] entry limit.
    """
    high = low = ceiling
    best = sustained(low)
    if best is not None and not gate:
        return _most_carried(sustained, best)
    while best is None:
        if low <= LEAST * ceiling:
            return None
        high, low = low, 0.5 * low
        best = sustained(low)
    while high > PRECISION * low:
        middle = math.sqrt(low * high)
        found = sustained(middle)
        if found is None:
            high = middle
        else:
            low, best = middle, found
    return best


def _rate(rows: Sequence[Row]) -> float:
    return float((HOUR * np.array([row["correct"] for row in rows]) / rows[0]["counted"]).mean())


def _most_carried(sustained: Callable[[float], list[Row] | None], most: list[Row]) -> list[Row]:
    """Search for a rate below full load at which more parcels are delivered than at full load.

    Return the rows at this rate. If no rate delivers more, return `most`, the rows at full load.
    `sustained` is the function that `find_capacity` takes.
    """
    low, high = _rate(most), most[0]["offered"]
    while high > PRECISION * low:
        middle = math.sqrt(low * high)
        found = sustained(middle)
        if found is not None and _rate(found) > _rate(most):
            most = found
        if found is not None and _rate(found) >= CARRIED * middle:
            low = middle
        else:
            high = middle
    return most


TASK = Flow().name
# Rungs, named by the modules that turn together.
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
SCHEDULER = "scheduler"  # for streams on which no agent was trained

# Pairs of rungs whose difference is shown.
STEPS = (
    (FOLLOWED, ARRANGED), (SERIES, FOLLOWED), (TRIPLES, SERIES), (COLUMNS, TRIPLES),
    (MODULES, COLUMNS),
    (SIX_COLUMNS, COLUMNS), (SIX_MODULES, MODULES), (SIX_MODULES, SIX_COLUMNS),
    (LEARNED, MODULES),
)  # fmt: skip
ZONES = (ARRANGED, FOLLOWED, SERIES)  # rungs whose columns are chosen for each stream
BOUNDED = (MODULES, SIX_MODULES)  # rungs with a shown best known rate
ON_FILM = (ARRANGED, SERIES, COLUMNS, MODULES)

SHORTEST = 4  # minimum columns of a zone; fewer are almost single columns
# minimum columns of zones in series; in shorter zones, a parcel is over two of them
SHORTEST_OF_MANY = 5
WIDEST = 20  # maximum columns of a zone
LONGER = 2  # additional columns to try beyond the best zone
PREDICTED = 500  # parcels of a prediction


@METHODS.registered(TASK)
def ladder() -> list[Method]:
    """List the methods of Flow: rungs (schedulers on different hardware), then other methods."""
    columns, modules = partial(_schedule, ColumnGroups()), partial(_schedule, None)
    return [
        _rung(ARRANGED, "modules", partial(_schedule_zones, SHORTEST, 1, True)),
        _rung(FOLLOWED, "modules", partial(_schedule_zones, SHORTEST, 1, False)),
        _rung(SERIES, "modules", partial(_schedule_zones, SHORTEST_OF_MANY, None, False)),
        _rung(TRIPLES, "modules", partial(_schedule, ColumnGroups(3))),
        _rung(COLUMNS, "modules", columns),
        _rung(SIX_COLUMNS, "modules", columns, SIX),
        _rung(MODULES, "parcels", modules),
        _rung(SIX_MODULES, "parcels", modules, SIX),
        Method(EVENT, TASK, partial(seedless, StreamEventRule), {"actions": "parcels"}),
        Method(EACH, TASK, partial(seedless, SortEach), {"actions": "parcels"}, presets=("exact",)),
        *(replace(each, seeds=each.seeds[:1]) for each in _learned()),
    ]


def _learned() -> list[Method]:
    """Return the shipped agent of Flow, renamed to "flow-schedule"."""
    return [replace(each, name=LEARNED) for each in shipped(TASK)]


def _rung(
    name: str, actions: str, make: Callable[..., Controller | None],
    orientations: tuple[float, ...] | None = None,
) -> Method:  # fmt: skip
    given: dict[str, Any] = {"actions": actions, "gate": True, "queue": library.QUEUE}
    if orientations is not None:
        given["orientations"] = orientations
    return Method(name, TASK, make, given)


def _schedule(groups: ColumnGroups | None, config: EnvConfig, _seed: int) -> Scheduler | None:
    return make_scheduler(config, groups)


def _schedule_zones(
    shortest: int, count: int | None, exclusive: bool, config: EnvConfig, _seed: int
) -> Scheduler | None:
    """Make a scheduler with zones of equal width. The width gives the highest predicted rate.

    The search for the width begins with `shortest` columns. `count` and `exclusive` are fields of
    `ColumnGroups`. Returns None if no width sorts all parcels.
    """
    rates: dict[ColumnGroups, float] = {}
    exact = replace(config, sensors=Exact(), randomisation=Randomisation())
    for columns in range(shortest, WIDEST + 1):
        if rates and columns > max(rates, key=rates.__getitem__).columns + LONGER:
            break
        groups = ColumnGroups(columns, count, exclusive)
        made = make_library(exact, groups, slack=CLEARANCES[0][0])
        if made.correct.all() and np.isfinite(made.gaps).all():
            odds, queue = np.ones(len(made.signature)), config.stream_task.queue
            rates[groups] = predict_rate(made, odds, PREDICTED, queue)
    tried = (
        make_scheduler(config, groups)
        for groups in sorted(rates, key=rates.__getitem__, reverse=True)
    )
    return next((scheduler for scheduler in tried if scheduler is not None), None)


def make_best_scheduler(config: EnvConfig, _seed: int, most_touches: float = 0.0) -> Scheduler:
    """Make a scheduler. If modules are stuck and axes are slow, use the better of two schedulers.

    One scheduler assumes the configured actuators. The other scheduler assumes perfect actuators.
    The better scheduler has more correct deliveries in a trial, which is a simulated stream.
    `most_touches` is the maximum number of touches per delivery in a trial.
    """
    whole = [make_model_library(config)]
    if config.actuators.stuck_share and math.isfinite(config.actuators.axis_speed):
        whole.append(make_model_library(config.replace(actuators=sg.Actuators())))
    found = [find_plain(config, made, most_touches) for made in whole]
    return max(found, key=itemgetter(1))[0]


def count_hardware(config: EnvConfig, controller: Controller) -> tuple[int, int, int]:
    """Return how many actuators there are, and how many columns and modules an actuator turns.

    If every actuator turns a single module, the second number is 0.
    """
    first_row, rows, first, obeying = config.site.zone
    grid = config.site.rotor[first_row : first_row + rows, first : first + obeying]
    lead = controller.library.lead if isinstance(controller, Scheduler) else None
    if lead is None or lead.groups is None:
        return int(grid.sum()), 0, 1
    each = [int(grid[:, begin:end].sum()) for begin, end in lead.spans.tolist()]
    return sum(count > 0 for count in each), lead.groups.columns, max(each)
