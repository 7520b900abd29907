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

from surface_gym.config import PRESETS, EnvConfig
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.inlets import side_by_side
from surface_gym.flow.merge import lines
from surface_gym.flow.sequence import shuffled
from surface_gym.flow.state import CORRECT, JAM
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import Stops, TakeAwayTask, bulk
from surface_gym.parallel import Workers
from surface_gym.parcel import Parcel, assortment
from surface_gym.registration import ON_SLOPES
from surface_gym.sensors import Exact
from surface_gym.state import RUNNING

from .. import library
from ..base import BatchController, Booleans, Controller, find_axes
from ..learning.algorithms import MOST_PARCELS
from ..library import PolicyFiles
from ..planning.receding_horizon import RecedingHorizon
from ..rules.sequencing import PassAndPark
from ..rules.singulation import HoldAndRelease, TimeSlots
from ..scheduling.scheduler import begin_streams
from ..yaml_file import parse_yaml
from .benchmark import SEED, Advance, compute_kept
from .capacity import STREAM_PRESETS

FILE = "material-flow.jsonl"
REPLICATIONS = 10
PLANNED = 3  # of these, which a planner plays
SECONDS = 200.0  # [s] of each
ALIGNMENT = math.radians(10.0)
OFFERED = {"singulate": 14_000.0, "merge": 10_000.0}  # [parcels/h] more than anybody takes
QUIET = 30.0  # [s] at a stream's end in which none of the parcels there left: a jam
IN_ORDER = 0.999  # [-] share of parcels that must leave in their order
RATES = tuple(np.arange(600.0, 3400.0, 200.0).tolist())  # [parcels/h] at which orders are tried
ORDERED = {4: 3000.0, 8: 2000.0}  # [parcels/h] at which all are compared, by window
NEVER_SEEN, SHAPES_SEED = 64, 20_280  # shapes of the lab: those of no tuning
COMPARED = {**STREAM_PRESETS, "lab": PRESETS["lab"]}


class RollOn(BatchController):
    """Let every parcel roll."""

    _shape = (None, None)

    def __init__(self, config: EnvConfig) -> None:
        self._size = config.action_kind.size
        self._choice = find_axes(config).roll

    def _predict(self, batch: Any, *_: Any, **__: bool) -> tuple[Any, None]:
        return np.full((len(batch), self._size), self._choice), None


@dataclass(frozen=True)
class FlowMethod:
    """A controller, in as many seeds as it was trained in."""

    name: str
    make: Callable[[EnvConfig, int], Controller]  # for an environment and a seed
    seeds: tuple[int, ...] = (0,)
    most: int | None = None  # parcels on the surface at once; None: as many as the environment has
    actions: str = "parcels"  # kind of action


PLANNER = "planner"
# Names of methods and kinds of action of the algorithms that learn on slopes.
LEARNED = {"parcels": ("PPO per parcel", "parcels"), "local": ("PPO per module", "modules")}


def _of_rule(rule: Callable[[EnvConfig], Controller], config: EnvConfig, _seed: int) -> Controller:
    return rule(config)


ROLL_ON = FlowMethod("roll on", partial(_of_rule, RollOn))
SINGLE = (
    ROLL_ON,
    FlowMethod("hold and release", partial(_of_rule, HoldAndRelease)),
    FlowMethod("time slots", partial(_of_rule, TimeSlots)),
    FlowMethod("time slots, 8 at once", partial(_of_rule, TimeSlots), most=8),
)
ORDER = (FlowMethod("pass and park", partial(_of_rule, PassAndPark)),)


def _plan(config: EnvConfig, _seed: int) -> Controller:
    """Make the planner that varies time slots."""
    return RecedingHorizon(TimeSlots(config), config)


PLAN = FlowMethod(PLANNER, _plan)


def find_learned(task: str) -> tuple[FlowMethod, ...]:
    """Find the shipped agents of a task."""
    found = []
    for algo in LEARNED:
        name = f"{task}-{algo}"
        if name in library.names():
            folders = {seed: library.SHELF / name / f"seed-{seed}" for seed in library.seeds(name)}
            found.append(learned_method({k: library.read_files(at) for k, at in folders.items()}))
    return tuple(found)


def learned_method(files: dict[int, PolicyFiles]) -> FlowMethod:
    """Make the method of policies by their seeds, all of one algorithm."""
    name, actions = LEARNED[parse_yaml(next(iter(files.values())).card.decode())["algo"]]
    return FlowMethod(name, partial(_read, files), tuple(files), MOST_PARCELS, actions)


def _read(files: dict[int, PolicyFiles], config: EnvConfig, seed: int) -> Controller:
    return library.from_files(files[seed], config=config)


@dataclass(frozen=True)
class Scenario:
    """A task, what it asks, and who does it."""

    task: str
    name: str
    arguments: tuple[tuple[str, Any], ...]  # of the environment
    methods: tuple[FlowMethod, ...]
    rates: tuple[float, ...]  # [parcels/h] offered; the highest of several at which it holds
    window: int = 0  # of the order; 0: none is asked

    def config(self, preset: str, rate: float, method: FlowMethod = ROLL_ON) -> EnvConfig:
        """Configure the environment of a method at a rate [parcels/h]."""
        given = dict(self.arguments)
        stream = self.stream(rate)
        if preset == "lab":
            shapes = assortment(NEVER_SEEN, SHAPES_SEED)
            stream = replace(stream, parcels=tuple((each, 1.0) for each in shapes))
        if method.most is not None:
            given["max_parcels"] = method.most
        return EnvConfig(
            self.task, actions=method.actions, duration=SECONDS, stream=stream,
            preset=COMPARED[preset], **given,
        )  # fmt: skip

    def stream(self, rate: float) -> Stream:
        """Make the stream of parcels at a rate [parcels/h]."""
        if self.window:
            return shuffled(rate, self.window)
        return bulk(rate) if self.task == "singulate" else lines(rate)


def scenarios(tasks: Sequence[str] = ON_SLOPES, learned: bool = True) -> list[Scenario]:
    """List the scenarios of some tasks, with the shipped agents or without."""
    aligned = ("alignment", ALIGNMENT)
    mouth, stops = ("exits", "mouth"), ("demand", Stops())
    agents = {task: find_learned(task) if learned else () for task in ON_SLOPES}
    single, merged = SINGLE + agents["singulate"], SINGLE + agents["merge"]
    ordered = (ROLL_ON, *ORDER, *agents["sequence"])
    bulks, rows = (OFFERED["singulate"],), (OFFERED["merge"],)
    singulate, merge, sequence = (partial(Scenario, task) for task in ON_SLOPES)
    found = [
        singulate("anywhere across", (), single, bulks),
        singulate("mouth of 0.6 m, 10 deg", (mouth, aligned), (*single, PLAN), bulks),
        singulate("two mouths, 10 deg", (("exits", "mouths"), aligned), single, bulks),
        singulate("mouth, take-away stops", (mouth, aligned, stops), single[1:], bulks),
        merge("three lines", (), (*merged, PLAN), rows),
        merge("two lines", (("inlets", side_by_side(2)),), merged, rows),
        *(sequence(f"window of {k}", (), ORDER, RATES[::-1], k) for k in (2, 4, 8)),
        *(
            sequence(f"window of {k}, {rate:g} an hour", (), ordered, (rate,), k)
            for k, rate in ORDERED.items()
        ),
    ]
    return [each for each in found if each.task in tasks]


@dataclass(frozen=True)
class MaterialFlowResult:
    """A controller under one scenario and preset, over all replications."""

    scenario: str
    method: str
    preset: str
    rates: list[float]  # [parcels/h] of right parcels, of each replication, mean over seeds
    of_seeds: list[float]  # [parcels/h] of right parcels, of each seed, mean over replications
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
    jams: float  # replications in which nothing left any more, mean over seeds
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
    """Play all replications of a stream to their end; a planner plays the first of them."""
    count = PLANNED if isinstance(controller, RecedingHorizon) else REPLICATIONS
    batch = begin_streams(config, count, SEED)
    if isinstance(controller, RecedingHorizon):
        controller.watch(batch)
    fresh = np.ones(count, dtype=np.bool_)
    state = None
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state, fresh)
        batch.step(config.action_kind.commands(action, count))
        fresh[:] = False
    return batch


def find_jams(batch: StreamBatch) -> Booleans:
    """Return whether each stream has jammed: it ended so, or nothing leaves any more.

    A controller that lets parcels tremble behind each other hides a jam from the environment, which
    asks that nothing moves.
    """
    streams = batch.streams
    last = np.fmax.reduce(streams.departed, axis=1, initial=0.0)
    quiet = (streams.clock - last > QUIET) & streams.present.any(axis=1)
    return (batch.outcome == JAM) | quiet


def _measure(
    scenario: Scenario, method: FlowMethod, preset: str, config: EnvConfig
) -> MaterialFlowResult:
    batches = [play(config, method.make(config, seed)) for seed in method.seeds]
    jammed = np.array([find_jams(batch) for batch in batches])
    found = [
        config.stream_task.compute_statistics(batch.streams, k, bool(jams[k]), 1)
        for batch, jams in zip(batches, jammed, strict=True)
        for k in range(batch.num_envs)
    ]
    delivered = np.array([each.delivered for each in found])
    # A replication that jams counts to its end: nothing comes after it.
    right = np.array([batch.streams.tally[:, CORRECT] for batch in batches])
    rates = HOUR * right / SECONDS

    def mean(name: str) -> float:
        values = np.array([getattr(each, name) for each in found], dtype=np.float64)
        some = np.isfinite(values)
        if not some.any():
            return math.nan
        return float(np.average(values[some], weights=np.maximum(1, delivered)[some]))

    return MaterialFlowResult(
        scenario.name, method.name, preset,
        rates=rates.mean(axis=0).tolist(), of_seeds=rates.mean(axis=1).tolist(),
        right=float(right.sum() / max(1, delivered.sum())),
        right_gaps=mean("right_gaps"), aligned=mean("aligned"), beside=mean("beside"),
        order_errors=mean("order_errors"), touches_per_1000=mean("touches_per_1000"),
        impulse=max(each.impulse_most for each in found),
        squeeze=max(each.squeeze_most for each in found),
        time=mean("time_mean"), unfairness=mean("unfairness"),
        jams=float(jammed.sum() / len(method.seeds)),
        bound=take_away_bound(config),
    )  # fmt: skip


def compute(scenario: Scenario, method: FlowMethod, preset: str) -> MaterialFlowResult:
    """Measure a method, at the highest of the scenario's rates at which it holds, or the least."""
    for rate in scenario.rates:
        config = scenario.config(preset, rate, method)
        if method.name == PLANNER:  # it knows the truth
            config = config.replace(sensors=Exact())
        found = _measure(scenario, method, preset, config)
        if found.right >= IN_ORDER and found.jams == 0:
            break
    return found


def compute_material_flow(
    tasks: Sequence[str],
    workers: Workers,
    folder: Path | None = None,
    advance: Advance = lambda *_: None,
) -> list[MaterialFlowResult]:
    """Compute all results of some tasks."""
    file = None if folder is None else folder / FILE
    return compute_scenarios(scenarios(tasks), workers, file, advance)


def compute_scenarios(
    compared: Sequence[Scenario],
    workers: Workers,
    file: Path | None = None,
    advance: Advance = lambda *_: None,
) -> list[MaterialFlowResult]:
    """Compute all results of some scenarios."""
    jobs = {
        ("material", each.name, method.name, preset): partial(compute, each, method, preset)
        for each in compared
        for method in each.methods
        for preset in COMPARED
        if method.name != PLANNER or preset != "camera"  # it needs no camera
    }
    return list(compute_kept(jobs, MaterialFlowResult, workers, file, advance).values())
