"""Scenarios of streams: offered rates, and the capacity of a method by a search."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import BETWEEN, CORRECT, JAM, TURNS, compute_statistics
from surface_gym.parcel import assortment
from surface_gym.sensors import Exact
from surface_gym.state import RUNNING
from surface_gym.tasks.benchmark import ENTRANCE, Offer, StreamBenchmark

from ..base import Booleans, Controller
from ..planning.receding_horizon import RecedingHorizon
from ..scheduling.bounds import clairvoyant_bound, entrance_bound
from ..scheduling.scheduler import Scheduler, begin_streams
from .ladder import count_hardware, methods_of_unseen
from .method import PLANNER, Method, stream_benchmark
from .scenario import SEED, WHOLE, Extent, Row, Scenario, ScenarioJob, make_jobs

NEVER_SEEN, SHAPES_SEED = 64, 20_280  # shapes of the lab on streams, never tuned on
LEAST_RIGHT = {"exact": 0.999, "camera": 0.995}  # [-] of deliveries, for a rate to be sustained
IN_ORDER = 0.999  # [-] share of parcels that must leave rightly at one of several rates
PRECISION = 1.02  # [-] between a rate that is sustained and one that is not
LEAST = 1.0 / 16.0  # [-] of what the entrance takes, below which there is no capacity
CARRIED = 0.98  # [-] of what is offered, so that the queue does not grow
CHECK_EVERY = 10  # control periods between checks whether a rate can still be sustained
QUIET = 30.0  # [s] at a stream's end in which none of the parcels there left: a jam
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
UNSEEN = "unseen"  # preset of offers with sensors of their own


@dataclass(frozen=True)
class StreamScenario(Scenario):
    """A stream that is offered at a rate, or at the highest of several or of all."""

    offered: str  # name of the offer

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

    def accepts(self, method: Method) -> bool:
        return super().accepts(method) and method.kind in self.offer.kinds

    def episodes(self, method: Method) -> int:
        count = self.benchmark.replications
        asked = (count, self.extent.replications, method.most)
        return min(each for each in asked if each is not None)

    def config(self, method: Method, rate: float | None = None) -> EnvConfig:
        """Configure the environment of a method, offered parcels at a rate [parcels/h].

        Args:
            rate: None: the offer's; of several the first; the entrance's where one is searched.
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
        if method.kind == PLANNER:  # it knows the truth
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
            correct, delivered = (
                sum(row[name] for row in rows) for name in ("correct", "delivered")
            )
            held = correct / max(1, delivered) >= IN_ORDER and not any(row["jam"] for row in rows)
            if len(offer.rates) == 1 or held:
                break
            controller = None
        bound = self._bound(config)
        return [{**row, "bound": bound} for row in rows]

    def _bound(self, config: EnvConfig) -> float:
        if self.offer.rates in ((), (ENTRANCE,)):
            return entrance_bound(config)
        return config.stream_task.rate_bound(config)

    def _search(
        self, method: Method, config: EnvConfig, controller: Controller | None
    ) -> list[Row]:
        """Search the greatest rate that is sustained; the numbers are nan where none is."""
        count, ceiling = self.episodes(method), entrance_bound(config)
        fixed = {"actuators": 0, "columns": 0, "modules": 1, "bound": ceiling, "best": math.nan}
        rows: list[Row] | None = None
        if controller is not None:
            hardware = count_hardware(config, controller)
            fixed |= dict(zip(("actuators", "columns", "modules"), hardware, strict=True))
            rows = find_capacity(
                lambda rate: self._sustained(method, controller, rate), ceiling,
                config.stream_task.gate,
            )  # fmt: skip
        if isinstance(controller, Scheduler):
            made = controller.library
            fixed["best"] = clairvoyant_bound(made, np.ones(len(made.signature)))
        nothing: Row = {"offered": math.nan, "counted": math.nan, "correct": math.nan}
        return [{**row, **fixed} for row in rows or [nothing] * count]

    def _sustained(self, method: Method, controller: Controller, rate: float) -> list[Row] | None:
        config, least = self.config(method, rate), LEAST_RIGHT[self.preset]
        rows = self._measure(method, config, controller, least)
        return rows if rows and is_sustained(rows, least) else None

    def _measure(
        self, method: Method, config: EnvConfig, controller: Controller, least_right: float = 0.0
    ) -> list[Row]:
        warm_up = self.benchmark.warm_up
        batch = play_stream(config, controller, self.episodes(method), warm_up, least_right)
        return [] if batch is None else measure_stream(batch, warm_up)


def stream_scenarios(
    task: str, extent: Extent = WHOLE, groups: Sequence[str] = ()
) -> list[Scenario]:
    """List the offers of a task under each of its presets.

    Args:
        groups: of offers; none: the first.
    """
    benchmark = stream_benchmark(task)
    known = list(dict.fromkeys(each.group for each in benchmark.offers))
    chosen = [each for each in groups if each in known] or known[:1]
    return [
        StreamScenario(task, preset, extent, offer.scenario)
        for group in chosen
        for preset in benchmark.presets
        if extent.presets is None or preset in extent.presets
        for offer in _some(benchmark, group, extent.offers)
    ]


def _some(benchmark: StreamBenchmark, group: str, count: int | None) -> list[Offer]:
    """Pick so many offers of a group, the one on film first; None: all."""
    offers = [each for each in benchmark.offers if each.group == group]
    return (
        sorted(offers, key=lambda each: each.name != benchmark.filmed)[:count] if count else offers
    )


def unseen_jobs(task: str, extent: Extent = WHOLE) -> list[ScenarioJob]:
    """List the jobs of the scheduler and the agents on streams that no agent trained on."""
    offers = stream_benchmark(task).held_out[: extent.offers]
    scenarios = [StreamScenario(task, UNSEEN, extent, offer.scenario) for offer in offers]
    return make_jobs(scenarios, methods_of_unseen()) if scenarios else []


def counted_time(duration: float, rate: float, warm_up: float) -> float:
    """Compute how much [s] of an episode's end counts after a warm-up [s].

    It is whole gaps between parcels, at least one, so that it makes no difference when the first
    parcel came.
    """
    gap = HOUR / rate
    return min(duration, gap * max(1, math.floor((duration - warm_up) / gap + 1e-9)))


def play_stream(
    config: EnvConfig, controller: Controller, count: int, warm_up: float = 0.0,
    least_right: float = 0.0,
) -> StreamBatch | None:  # fmt: skip
    """Play so many replications of a stream to their end.

    Args:
        least_right: [-] of deliveries; once fewer are sure, or anything jams, it ends with None.
    """
    batch = begin_streams(config, count, SEED)
    if isinstance(controller, RecedingHorizon):
        controller.watch(batch)
    begin = config.stream_task.duration - _counted(config, warm_up)
    most_wrong = (1.0 - least_right) * int(batch.streams.arrivals.sum())
    fresh = np.ones(count, dtype=np.bool_)
    state, period = None, 0
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state, fresh)
        batch.step(config.action_kind.commands(action, count))
        fresh[:] = False
        period += 1
        if least_right and period % CHECK_EVERY == 0 and _is_lost(batch, begin, most_wrong):
            return None
    return batch


def _counted(config: EnvConfig, warm_up: float) -> float:
    """Compute how much [s] of an episode's end counts."""
    task = config.stream_task
    if not warm_up:
        return task.duration
    rate = getattr(task.stream.arrivals, "rate", None)
    if rate is None:  # as recorded
        return max(0.0, task.duration - warm_up)
    return counted_time(task.duration, rate, warm_up)


def _is_lost(batch: StreamBatch, begin: float, most_wrong: float) -> bool:
    streams = batch.streams
    wrong = (
        (streams.departed >= begin) & (streams.taken >= BETWEEN) & (streams.taken != streams.exit)
    )
    return bool((streams.outcome == JAM).any() or wrong.sum() > most_wrong)


def find_jams(batch: StreamBatch) -> Booleans:
    """Return whether each stream has jammed: it ended so, or nothing leaves any more.

    A controller that lets parcels tremble behind each other hides a jam from the environment, which
    asks that nothing moves.
    """
    streams = batch.streams
    last = np.fmax.reduce(streams.departed, axis=1, initial=0.0)
    quiet = (streams.clock - last > QUIET) & streams.present.any(axis=1)
    return (batch.outcome == JAM) | quiet


def measure_stream(batch: StreamBatch, warm_up: float = 0.0) -> list[Row]:
    """Return the numbers of each replication, without its warm-up [s] at least.

    A replication that jams counts to its end: nothing comes after it.
    """
    streams, config = batch.streams, batch.config
    task, counted = config.stream_task, _counted(config, warm_up)
    begin = task.duration - counted
    offered = getattr(task.stream.arrivals, "rate", math.nan)
    jams, rows = find_jams(batch), []
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
            }
        )  # fmt: skip
    return rows


def is_sustained(rows: Sequence[Row], least_right: float) -> bool:
    """Return whether nothing jams and enough deliveries are right."""
    correct, delivered = (sum(row[name] for row in rows) for name in ("correct", "delivered"))
    return not any(row["jam"] for row in rows) and correct / max(1, delivered) >= least_right


def find_capacity(
    sustained: Callable[[float], list[Row] | None], ceiling: float, gate: bool
) -> list[Row] | None:
    """Search the greatest rate that is sustained, to 2 %; None where none is.

    What the entrance takes at most comes first: a method that keeps parcels waiting at a gate may
    sustain whatever is offered. One that sustains it without a gate, by parcels that push each
    other on, may deliver more where fewer come. Else the rate is halved until it is sustained, and
    then searched for between that and the last that was not.
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
    """Find the most delivered: offered most, or at the greatest rate that is carried."""
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
