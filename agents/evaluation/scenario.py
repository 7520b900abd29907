"""Scenarios: the episodes on which methods are compared. Here, they have one parcel.

The robustness study changes one factor at a time, to a level that differs from the training.
"""

import math
import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

import surface_gym as sg
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.parcel import Base
from surface_gym.tasks.benchmark import Benchmark

from ..base import time_for, with_zone
from ..planning.planner import run_oracle
from ..rollout import Episodes, run_episodes, run_sequentially
from .method import ANY_ANGLE, BELIEF, BEST_FIXED, PLANNER, Method, find_benchmark, start_benchmark

KEY = ("task", "scenario", "preset", "method", "seed")  # key of a job
SEED = 20_261_121  # seed of every episode
STARTS = "starts"  # scenario name of tasks of one parcel

# Methods with a long look-ahead use a quarter of the starts of a changed scenario, the planner a
# sixth.
FEWER = {"turning rule": 4, "sliding mode": 4, PLANNER: 6}

Key = tuple[Any, ...]
Row = dict[str, Any]


@dataclass(frozen=True)
class Extent:
    """Limits on the size of a comparison."""

    starts: int | None = None  # starts of a task of one parcel; None: all of its benchmark
    level_starts: int = 240  # starts per level of robustness
    seeds: int | None = None  # maximum seeds of a method; None: all
    replications: int | None = None  # of a stream; None: the benchmark's number
    duration: float = math.inf  # [s] maximum duration of a stream
    offers: int | None = None  # number of streams of a task; None: all
    levels: int | None = None  # levels of a factor; None: all
    searched: int | None = None  # maximum starts of methods that search; None: their own
    presets: tuple[str, ...] | None = None  # presets of streams; None: all
    film: float = 20.0  # [s] maximum duration of a stream's film
    rungs: int | None = None  # maximum rungs in a film; None: all


WHOLE = Extent()
# `--quick`: the same tables with fewer episodes.
QUICK = Extent(
    starts=12, level_starts=12, seeds=1, replications=2, duration=20.0, offers=1, levels=1,
    searched=1, presets=("exact",), film=2.0, rungs=2,
)  # fmt: skip


@dataclass(frozen=True)
class Scenario(ABC):
    """Episodes on which a task's methods are compared.

    A scenario contains only names, and other processes look them up. So custom tasks need not be
    pickled.
    """

    task: str
    preset: str
    extent: Extent

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the scenario, unique for its task and preset."""

    def accepts(self, method: Method) -> bool:
        """Return whether `method` takes part in this scenario."""
        return method.presets is None or self.preset in method.presets

    @abstractmethod
    def episodes(self, method: Method) -> int:
        """Return the number of episodes per seed of a method."""

    @abstractmethod
    def play(self, method: Method, seed: int) -> list[Row]:
        """Run a method with a seed; return a row of numbers for each episode."""


@dataclass(frozen=True)
class ScenarioJob:
    """A job that runs one seed of a method under a scenario."""

    scenario: Scenario
    method: Method
    seed: int

    def __reduce__(self) -> Any:
        packed = pickle.dumps((self.scenario, self.method, self.seed))
        return _unpack, (self.scenario.task, packed)

    @property
    def key(self) -> Key:
        at = self.scenario
        return (at.task, at.name, at.preset, self.method.name, self.seed)

    @property
    def episodes(self) -> int:
        return self.scenario.episodes(self.method)

    @property
    def is_slow(self) -> bool:
        """Whether the job takes much longer than most jobs."""
        method = self.method
        several = method.kind == PLANNER or method.most is not None
        return several or method.name in FEWER or "gate" in method.arguments

    def __call__(self) -> list[Row]:
        """Run the job; return rows of the table of results."""
        names = dict(zip(KEY, self.key, strict=True)) | {"kind": self.method.kind}
        rows = self.scenario.play(self.method, self.seed)
        return [{**names, "episode": k, **row} for k, row in enumerate(rows)]


def _unpack(task: str, packed: bytes) -> ScenarioJob:
    """Unpickle a job in another process, after loading the file of a custom task."""
    find_benchmark(task)
    return ScenarioJob(*pickle.loads(packed))


def make_jobs(scenarios: Sequence[Scenario], methods: Sequence[Method]) -> list[ScenarioJob]:
    """List the jobs of a task: one per method, scenario and seed, grouped by method."""
    return [
        ScenarioJob(each, method, seed)
        for method in methods
        for each in scenarios
        if each.accepts(method)
        for seed in method.seeds[: each.extent.seeds]
    ]


@dataclass(frozen=True)
class StartScenario(Scenario):
    """The starts of a benchmark with one parcel, under a preset."""

    presets: ClassVar[Mapping[str, Preset]] = PRESETS

    @property
    def name(self) -> str:
        return STARTS

    def count(self, method: Method) -> int | None:
        """Return how many starts a method gets; None means all starts."""
        asked = [each for each in (self.extent.starts, method.most) if each is not None]
        if method.most is not None and self.extent.searched is not None:
            asked.append(self.extent.searched)
        return min(asked, default=None)

    def episodes(self, method: Method) -> int:
        starts, count = len(start_benchmark(self.task).starts), self.count(method)
        return starts if count is None else min(starts, count)

    def play(self, method: Method, seed: int) -> list[Row]:
        episodes, config, starts = self.run(method, seed)
        more = _path_metrics(config, episodes, starts)
        return _list_rows(
            episodes, more | {"decision_time": [episodes.decision_time] * len(starts)}
        )

    def run(
        self, method: Method, seed: int
    ) -> tuple[Episodes, EnvConfig, tuple[dict[str, Any], ...]]:
        """Run a method with a seed. Return the episodes, the configuration and the starts."""
        preset, benchmark = self.presets[self.preset], start_benchmark(self.task)
        starts = choose_starts(benchmark, self.count(method), preset)
        config = method.config(benchmark.task, preset)
        run = run_episodes if method.most is None else run_sequentially
        return run(method.controller(config, seed), config, starts, SEED), config, starts


def _list_rows(episodes: Episodes, more: Mapping[str, Sequence[Any]]) -> list[Row]:
    """List a row per episode, with outcome, metrics, and the additional columns `more`."""
    columns: dict[str, Any] = {
        "success": episodes.success, "time": episodes.time, **episodes.metrics, **more,
    }  # fmt: skip
    return [
        {name: values[k] for name, values in columns.items()} for k in range(len(episodes.success))
    ]


def start_scenarios(task: str, extent: Extent = WHOLE) -> list[Scenario]:
    """List a task's scenarios, one per preset. `extent` limits the starts of each scenario."""
    return [StartScenario(task, preset, extent) for preset in PRESETS]


def choose_starts(
    benchmark: Benchmark, count: int | None, preset: Preset
) -> tuple[dict[str, Any], ...]:
    """Choose the starts of a benchmark under a preset.

    Args:
        count: number of evenly spaced starts. If `count` is None, all starts are chosen.
        preset: preset of the scenario. If the preset has its own parcels, the starts do not set the
            parcel.
    """
    starts = benchmark.starts
    if count is not None:
        places = np.linspace(0, len(starts) - 1, min(count, len(starts))).round()
        starts = tuple(starts[place] for place in places.astype(int).tolist())
    if not preset.parcels:
        return starts
    return tuple({key: start[key] for key in start if key != "parcel"} for start in starts)


def drawn_parcels(
    config: EnvConfig, starts: Sequence[dict[str, Any]], seed: int
) -> tuple[sg.Parcel, ...]:
    """List the parcel of each start; start k is seeded by `seed` + k."""
    env = sg.SmartSurfaceVectorEnv(num_envs=len(starts), **config.arguments())
    env.reset(seed=seed, options=list(starts))
    parcels = tuple(env.batch.parcel(i) for i in range(len(starts)))
    env.close()
    return parcels


def _path_metrics(
    config: EnvConfig, episodes: Episodes, starts: Sequence[dict[str, Any]]
) -> dict[str, list[float]]:
    """Return the task's path metrics by name. A metric is a list with one value per start."""
    task, line = config.task, config.chosen_line
    found: dict[str, list[float]] = {}
    if type(task).path_metrics is sg.tasks.Task.path_metrics:
        return found
    for k, parcel in enumerate(drawn_parcels(config, starts, SEED)):
        for name, value in task.path_metrics(episodes.path(k), parcel, line, None).items():
            found.setdefault(name, []).append(value)
    return found


# Methods that the study leaves out: for one parcel or zone, or with a search per start.
LEFT_OUT = (BEST_FIXED, ANY_ANGLE, BELIEF)
EXACT = PRESETS["exact"]
TRAINED, LAB = "trained", "lab"
# The planner sees the true state of a start, so it shows the reachable success. It runs on these
# factors, at the displayed levels.
PLANNED = (TRAINED, "square", LAB)
ORACLE_WIDTH = 32  # maximum width of the planner's beam
DIRECTIONS = 16  # number of evenly spaced directions of an off-centre load
SENSORS = {
    "exact": sg.sensors.Exact(),
    "camera": sg.sensors.Camera(),
    "presence": sg.sensors.Presence(),
}
SHAPES = ("square", "rectangle", "disc", "polygon")

Level = float | int | str


@dataclass(frozen=True)
class Change:
    """Changes to the environment of a method; the defaults change nothing."""

    preset: Preset = EXACT  # sensors, randomisation, actuators and parcels
    control_period: float | None = None  # [s] between decisions; None: the method's
    # Obeying columns of the line; None: the line's. With more columns, episodes may last longer.
    zone_columns: int | None = None
    drag: float = 1.0  # [-] factor of mu_max, unknown to every controller
    rolling: float = 1.0  # [-] factor of mu_min and mu_support, unknown to every controller
    offset: float = 0.0  # [m] lateral offset of the entry, to either side
    turn: float = 0.0  # [rad] angle at the entry, to the same side


class Situation(NamedTuple):
    """The environment that a controller assumes, and the true environment."""

    assumed: EnvConfig
    true: EnvConfig


def situation(method: Method, benchmark: Benchmark, change: Change) -> Situation:
    """Apply a change to a benchmark's task; return the assumed and the true environment.

    Only the true environment gets the change of friction. The method assumes nominal friction.
    """
    period = change.control_period or method.control_period
    task = benchmark.task
    line = task.line
    slower = method.control_period / period
    if change.zone_columns is not None:
        assert isinstance(line, sg.lines.Line)
        slower *= time_for(line, change.zone_columns)
        line = with_zone(line, change.zone_columns)
    limit = None if slower == 1.0 else round(task.periods * slower)
    task = replace(task, entry_offset=change.offset, entry_turn=change.turn, time_limit=limit)
    config = method.config(task, change.preset)
    assumed = replace(config, control_period=period, line=line)
    factors = {"mu_max": change.drag, "mu_min": change.rolling, "mu_support": change.rolling}
    changed = {name: np.multiply(getattr(line, name), each) for name, each in factors.items()}
    return Situation(assumed, replace(assumed, line=replace(line, **changed)))


@dataclass(frozen=True)
class Factor:
    """A factor of the robustness study, with its levels."""

    name: str
    label: str  # label of its panels
    unit: str  # unit of its levels; "": names, or numbers without a unit
    levels: tuple[Level, ...]
    change: Callable[[Any], Change]  # function from a level to a change
    shown: tuple[Level, ...]  # levels in the table
    trained: Level | None = None  # level of the training; None: none
    of_lines: bool = False  # whether it applies to tasks on a line only

    @property
    def swept(self) -> tuple[Level, ...]:
        return tuple(level for level in self.levels if level != self.trained)

    @property
    def is_named(self) -> bool:
        return any(isinstance(level, str) for level in self.levels)


def _load(centimetres: float) -> Change:
    # Half S-boxes and half B-boxes, in the tasks' order of drawing.
    turns = [2.0 * math.pi * k / DIRECTIONS for k in range(DIRECTIONS)]
    away = 0.01 * centimetres
    parcels = tuple(
        replace(sg.layouts.box(size), com_offset=(away * math.cos(turn), away * math.sin(turn)))
        for size in ("S", "B")
        for turn in turns
    )
    return Change(replace(EXACT, parcels=parcels))


def _axis(milliseconds: float) -> Change:
    speed = 0.5 * math.pi / (1e-3 * milliseconds) if milliseconds else math.inf
    return Change(replace(EXACT, actuators=sg.Actuators(axis_speed=speed)))


_EACH = (
    Factor(TRAINED, "as trained", "", (TRAINED,), lambda _: Change(), (TRAINED,)),
    Factor(
        "square", "square", "m", tuple(k / 100.0 for k in range(15, 51)),
        lambda side: Change(replace(EXACT, parcels=(sg.Parcel(sg.Rectangle(side, side)),))),
        (0.15, 0.20, 0.30, 0.35, 0.40, 0.50),
    ),
    Factor("load", "load off centre", "cm", tuple(range(9)), _load, (3, 5, 8), 0),
    Factor("axis", "axes, 90 deg in", "ms", (0, 25, 50, 100, 200), _axis, (50, 100, 200), 0),
    Factor(
        "drag", "friction", "times", (0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3),
        lambda level: Change(drag=level), (0.7, 1.3), 1.0,
    ),
    Factor(
        "rolling", "rolling friction", "times", (0.5, 0.75, 1.0, 1.3, 1.6, 2.0),
        lambda level: Change(rolling=level), (0.5, 1.3, 2.0), 1.0,
    ),
    Factor(
        "sensors", "sensors", "", tuple(SENSORS),
        lambda level: Change(replace(EXACT, sensors=SENSORS[level])), ("camera", "presence"),
        "exact",
    ),
    Factor(
        "period", "decision every", "ms", (20, 40, 60, 80, 120),
        lambda level: Change(control_period=1e-3 * level), (20, 80, 120), 40,
    ),
    Factor(
        "zone", "zone", "columns", (8, 12, 16, 20, 24), lambda level: Change(zone_columns=level),
        (8, 12, 24), 16, of_lines=True,
    ),
    Factor(
        "aside", "entry aside", "cm", tuple(range(6)), lambda level: Change(offset=0.01 * level),
        (2, 5), 0,
    ),
    Factor(
        "turned", "entry turned", "deg", (0, 2, 4, 6, 8, 10),
        lambda level: Change(turn=math.radians(level)), (4, 10), 0,
    ),
    Factor(
        "stuck", "stuck modules", "%", (0, 2, 4, 6, 8, 10),
        lambda level: Change(replace(EXACT, actuators=sg.Actuators(stuck_share=0.01 * level))),
        (2, 10), 0,
    ),
    Factor(LAB, "lab", "", (LAB,), lambda _: Change(PRESETS["lab"]), (LAB,)),
)  # fmt: skip
FACTORS = {factor.name: factor for factor in _EACH}


@dataclass(frozen=True)
class ChangedScenario(Scenario):
    """Random starts of a task. One factor, e.g. friction, has another value (level) than usual."""

    factor: str
    level: Level

    @property
    def name(self) -> str:
        return scenario_name(self.factor, self.level)

    def accepts(self, method: Method) -> bool:
        factor = FACTORS[self.factor]
        if method.name in LEFT_OUT or self.level == factor.trained:
            return False
        if factor.of_lines and not isinstance(start_benchmark(self.task).task.line, sg.lines.Line):
            return False
        return method.kind != PLANNER or (self.factor in PLANNED and self.level in factor.shown)

    def episodes(self, method: Method) -> int:
        return max(1, self.extent.level_starts // FEWER.get(method.name, 1))

    def play(self, method: Method, seed: int) -> list[Row]:
        benchmark = start_benchmark(self.task)
        where = situation(method, benchmark, FACTORS[self.factor].change(self.level))
        count = self.episodes(method)
        drawn: list[dict[str, Any]] = [{}] * count
        if method.kind == PLANNER:
            episodes = run_oracle(where.true, drawn, SEED, ORACLE_WIDTH)
        else:
            run = run_episodes if method.most is None else run_sequentially
            episodes = run(method.controller(where.assumed, seed), where.true, drawn, SEED)
        shapes = {"shape": lab_shapes(self.task, count)} if self.factor == LAB else {}
        return _list_rows(episodes, shapes)


def scenario_name(factor: str, level: Level) -> str:
    """Return the name of a scenario in which one varied quantity, `factor`, has the value `level`.

    If `level` is the value used in training, the name is `TRAINED` for every factor.
    """
    return TRAINED if level in (FACTORS[factor].trained, TRAINED) else f"{factor} {level}"


def changed_scenarios(task: str, extent: Extent = WHOLE) -> list[Scenario]:
    """List a task's robustness scenarios, one per factor and level. `extent` limits the levels."""
    found: list[Scenario] = []
    for factor in FACTORS.values():
        levels = factor.shown[: extent.levels] if extent.levels else factor.levels
        for level in levels:
            preset = factor.change(level).preset.name
            found.append(ChangedScenario(task, preset, extent, factor.name, level))
    return found


def name_shape(base: Base) -> str:
    """Return the name of a base's shape: "square", "rectangle", "disc" or "polygon"."""
    if isinstance(base, sg.Rectangle):
        return "square" if base.length == base.width else "rectangle"
    return "disc" if isinstance(base, sg.Disc) else "polygon"


@lru_cache(maxsize=16)
def lab_shapes(task: str, starts: int) -> tuple[str, ...]:
    """Return the name of the shape of each start's parcel. The preset "lab" draws the parcels."""
    config = EnvConfig(task=start_benchmark(task).task, preset=PRESETS[LAB])
    drawn = drawn_parcels(config, [{}] * starts, SEED)
    return tuple(name_shape(each.base) for each in drawn)
