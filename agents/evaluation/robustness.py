"""The sweep of robustness: success where one thing at a time differs from training."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.parallel import Workers
from surface_gym.parcel import Base
from surface_gym.tasks.benchmark import Benchmark

from ..base import Booleans, time_for, with_zone
from ..planning.oracle import run_oracle
from ..rollout import Episodes, run_episodes, run_sequentially
from .benchmark import SEED, Advance, compute_kept, drawn_parcels, find_benchmark, interval
from .methods import ANY_ANGLE, BEST_FIXED, PLANNER, Method

FILE = "robustness.jsonl"
# Made for one parcel or zone, or a search for each start.
LEFT_OUT = (BEST_FIXED, ANY_ANGLE)
# Methods that look far ahead run on a quarter of the starts, the planner on a sixth.
FEWER = {"turning rule": 4, "sliding mode": 4, PLANNER: 6}
EXACT = PRESETS["exact"]
TRAINED, LAB = "trained", "lab"
# The planner sees the true state of a start, and so shows what can be reached; it runs on these
# factors, at the levels that are shown.
PLANNED = (TRAINED, "square", LAB)
FOLLOWED = 32  # environments that it follows at a time at most
DIRECTIONS = 16  # evenly around, that a load lies in off centre
SENSORS = {
    "exact": sg.sensors.Exact(),
    "camera": sg.sensors.Camera(),
    "presence": sg.sensors.Presence(),
}
SHAPES = ("square", "rectangle", "disc", "polygon")

Level = float | int | str
SweepKey = tuple[Any, ...]


@dataclass(frozen=True)
class Change:
    """Differences from a method's own environment; by default none."""

    preset: Preset = EXACT  # sensors, randomisation, actuators and parcels
    control_period: float | None = None  # [s] between decisions; None: the method's own
    # Of the line that obey; None: its own. An episode may last the longer where there are more.
    zone_columns: int | None = None
    drag: float = 1.0  # [-] factor of mu_max, unknown to every controller
    rolling: float = 1.0  # [-] factor of mu_min and of mu_support, likewise
    offset: float = 0.0  # [m] from where parcels enter, to either side
    turn: float = 0.0  # [rad] from how they enter, to the same side


class Situation(NamedTuple):
    """An environment: as a controller assumes it, and as it is."""

    assumed: EnvConfig
    true: EnvConfig


def situation(method: Method, benchmark: Benchmark, change: Change) -> Situation:
    """Make the environment of a method on a benchmark under a change."""
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
    """One thing that is changed."""

    name: str
    label: str  # beside its panels
    unit: str  # of its levels; "": they are names, or bare numbers
    meaning: str  # in a sentence
    levels: tuple[Level, ...]
    change: Callable[[Any], Change]  # that a level makes
    shown: tuple[Level, ...]  # those in the table
    trained: Level | None = None  # the level that is as trained; None: there is none
    of_lines: bool = False  # it is of tasks on a line alone

    @property
    def swept(self) -> tuple[Level, ...]:
        return tuple(level for level in self.levels if level != self.trained)

    @property
    def is_named(self) -> bool:
        return any(isinstance(level, str) for level in self.levels)


def _square(length: float) -> Change:
    return Change(replace(EXACT, parcels=(sg.Parcel(sg.Rectangle(length, length)),)))


def _load(centimetres: float) -> Change:
    # Half of them S-boxes and half B-boxes, in the order in which the tasks draw those.
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


def _stuck(percent: float) -> Change:
    return Change(replace(EXACT, actuators=sg.Actuators(stuck_share=0.01 * percent)))


_EACH = (
    Factor(TRAINED, "as trained", "", "Everything is as agents were trained, sensors exact.",
           (TRAINED,), lambda _: Change(), (TRAINED,)),
    Factor("square", "square", "m", "Length and width of the parcel.",
           tuple(k / 100.0 for k in range(15, 51)), _square, (0.15, 0.20, 0.30, 0.35, 0.40, 0.50)),
    Factor("load", "load off centre", "cm",
           f"How far the load lies off centre, in one of {DIRECTIONS} directions drawn.",
           tuple(range(9)), _load, (3, 5, 8), 0),
    Factor("axis", "axes, 90 deg in", "ms", "How long an axis takes to turn by 90 deg.",
           (0, 25, 50, 100, 200), _axis, (50, 100, 200), 0),
    Factor("drag", "friction", "times", "mu_max times this, unknown to every controller.",
           (0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3), lambda level: Change(drag=level),
           (0.7, 1.3), 1.0),
    Factor("rolling", "rolling friction", "times",
           "mu_min and mu_support times this, unknown to every controller.",
           (0.5, 0.75, 1.0, 1.3, 1.6, 2.0), lambda level: Change(rolling=level),
           (0.5, 1.3, 2.0), 1.0),
    Factor("sensors", "sensors", "", "The sensors that show the parcel.",
           tuple(SENSORS), lambda level: Change(replace(EXACT, sensors=SENSORS[level])),
           ("camera", "presence"), "exact"),
    Factor("period", "decision every", "ms",
           "From decision to decision; an episode may last as long as ever.",
           (20, 40, 60, 80, 120), lambda level: Change(control_period=1e-3 * level), (20, 80, 120),
           40),
    Factor("zone", "zone", "columns",
           "Columns that obey, behind the parcel's lead-in; as many lie behind them as ever. Where "
           "there are more, an episode may last the longer.",
           (8, 12, 16, 20, 24), lambda level: Change(zone_columns=level), (8, 12, 24), 16, True),
    Factor("aside", "entry aside", "cm", "How far off the middle parcels enter, to either side.",
           tuple(range(6)), lambda level: Change(offset=0.01 * level), (2, 5), 0),
    Factor("turned", "entry turned", "deg", "How far turned parcels enter, either way.",
           (0, 2, 4, 6, 8, 10), lambda level: Change(turn=math.radians(level)), (4, 10), 0),
    Factor("stuck", "stuck modules", "%", "Probability of each module to be stuck at 90 deg.",
           (0, 2, 4, 6, 8, 10), _stuck, (2, 10), 0),
    Factor(LAB, "lab", "", PRESETS["lab"].meaning, (LAB,),
           lambda _: Change(PRESETS["lab"]), (LAB,)),
)  # fmt: skip
FACTORS = {factor.name: factor for factor in _EACH}


@dataclass(frozen=True)
class SweepResult:
    """A method's seed on a task at the levels of a factor."""

    task: str
    method: str
    factor: str
    seed: int
    starts: int  # at each level
    levels: list[Level]
    success: list[str]  # (levels,) a letter for each start: 1 for success, else 0
    error: list[float]  # (levels,) median size of the task's first metric; 0 where it has none

    def __post_init__(self) -> None:
        checks.integer("seed", self.seed, least=0)
        checks.integer("starts", self.starts, least=1)
        if not len(self.levels) == len(self.success) == len(self.error):
            raise ValueError(f"success and error must be of each level, got {self.levels}")
        for letters in self.success:
            if len(str(letters)) != self.starts or set(str(letters)) - {"0", "1"}:
                raise ValueError(f"success must be {self.starts} of '0' and '1', got {letters!r}")

    @property
    def key(self) -> SweepKey:
        """The job that gave it: another number of starts, or other levels, make another result."""
        return (
            self.task, self.method, self.factor, self.seed, self.starts, tuple(self.levels)
        )  # fmt: skip


def can_sweep(methods: Sequence[Method]) -> list[Method]:
    """List methods that run on any parcel and any zone."""
    return [method for method in methods if method.name not in LEFT_OUT]


def levels_for(method: Method, factor: Factor) -> tuple[Level, ...]:
    """List levels of a factor that a method runs at; none where the factor does not concern it."""
    if factor.of_lines and not isinstance(find_benchmark(method.task).task.line, sg.lines.Line):
        return ()
    if method.name != PLANNER:
        return factor.swept
    return factor.shown if factor.name in PLANNED else ()


def starts_for(method: Method, starts: int) -> int:
    """Count the starts that a method runs on."""
    return max(1, starts // FEWER.get(method.name, 1))


def compute_factor(
    method: Method, seed: int, name: str, levels: tuple[Level, ...], starts: int
) -> SweepResult:
    """Run a method's seed at the levels of a factor."""
    benchmark = find_benchmark(method.task)
    success, errors = [], []
    for level in levels:
        where = situation(method, benchmark, FACTORS[name].change(level))
        episodes = _run(method, seed, where, starts)
        success.append("".join("1" if each else "0" for each in episodes.success))
        metric = next(iter(episodes.metrics.values()), np.zeros(1))
        errors.append(float(np.median(np.abs(metric))))
    return SweepResult(method.task, method.name, name, seed, starts, list(levels), success, errors)


def _run(method: Method, seed: int, where: Situation, starts: int) -> Episodes:
    drawn: list[dict[str, Any]] = [{}] * starts
    if method.name == PLANNER:
        return run_oracle(where.true, drawn, SEED, FOLLOWED)
    run = run_episodes if method.starts is None else run_sequentially
    return run(method.make(where.assumed, seed), where.true, drawn, SEED)


def sweep_jobs(methods: Sequence[Method], starts: int) -> dict[SweepKey, Callable[[], SweepResult]]:
    """List every result to compute, by its key; the slowest first, to fill the cores."""
    jobs = [
        (method, seed, factor.name, levels_for(method, factor), starts_for(method, starts))
        for method in sorted(methods, key=lambda each: -FEWER.get(each.name, 1))
        for seed in method.seeds
        for factor in FACTORS.values()
    ]
    return {
        (method.task, method.name, factor, seed, count, levels): partial(
            compute_factor, method, seed, factor, levels, count
        )
        for method, seed, factor, levels, count in jobs
        if levels
    }


def compute_sweep(
    methods: Sequence[Method],
    starts: int,
    workers: Workers,
    folder: Path | None = None,
    advance: Advance = lambda *_: None,
) -> list[SweepResult]:
    """Compute all results, in an order that does not depend on the processes."""
    file = None if folder is None else folder / FILE
    found = compute_kept(sweep_jobs(methods, starts), SweepResult, workers, file, advance)
    order = {(each.task, each.name): place for place, each in enumerate(methods)}
    factors = list(FACTORS)
    return sorted(
        found.values(),
        key=lambda row: (order[row.task, row.method], factors.index(row.factor), row.seed),
    )


@dataclass(frozen=True)
class Rate:
    """A share of successes, over seeds and starts."""

    value: float  # [-]
    low: float  # [-] of the 95 % interval
    high: float  # [-]
    seeds: int
    starts: int  # of each seed

    @classmethod
    def of(cls, success: Booleans) -> "Rate":
        return cls(float(success.mean()), *interval(success), *success.shape)


@dataclass(frozen=True, eq=False)
class Sweep:
    """All results of a sweep."""

    rows: tuple[SweepResult, ...]

    @cached_property
    def _found(self) -> dict[tuple[str, str, str], list[SweepResult]]:
        found: dict[tuple[str, str, str], list[SweepResult]] = {}
        for row in self.rows:
            found.setdefault((row.task, row.method, row.factor), []).append(row)
        return found

    @property
    def tasks(self) -> list[str]:
        return list(dict.fromkeys(row.task for row in self.rows))

    def methods(self, task: str | None = None) -> list[str]:
        """List names in their order; None: of all tasks."""
        return list(dict.fromkeys(r.method for r in self.rows if task in (None, r.task)))

    def success(self, task: str, method: str, factor: str, level: Level) -> Booleans | None:
        """Collect successes (seeds, starts); None where the method did not run."""
        rows, place = self._at(task, method, factor, level)
        if place is None:
            return None
        return np.array([[letter == "1" for letter in row.success[place]] for row in rows])

    def rate(self, task: str, method: str, factor: str, level: Level) -> Rate | None:
        """Compute the share of successes; None where the method did not run."""
        success = self.success(task, method, factor, level)
        return None if success is None else Rate.of(success)

    def error(self, task: str, method: str, factor: str, level: Level) -> float | None:
        """Compute the first metric's median size, mean over seeds; None where it did not run."""
        rows, place = self._at(task, method, factor, level)
        return None if place is None else float(np.mean([row.error[place] for row in rows]))

    def by_shape(self, task: str, method: str) -> dict[str, Rate]:
        """Compute rates in the lab by the shape of the parcel, without those that no start drew."""
        success = self.success(task, method, LAB, LAB)
        if success is None:
            return {}
        shapes = np.array(lab_shapes(task, success.shape[1]))
        return {shape: Rate.of(success[:, shapes == shape]) for shape in SHAPES if shape in shapes}

    def _at(
        self, task: str, method: str, factor: str, level: Level
    ) -> tuple[Sequence[SweepResult], int | None]:
        """Find a result for each seed, and the level's place in each; None where there is none."""
        if level == FACTORS[factor].trained:
            factor = level = TRAINED
        rows = self._found.get((task, method, factor), [])
        tried = rows[0].levels if rows else []
        return rows, tried.index(level) if level in tried else None


def name_shape(base: Base) -> str:
    """Name the shape of a base of the lab."""
    if isinstance(base, sg.Rectangle):
        return "square" if base.length == base.width else "rectangle"
    return "disc" if isinstance(base, sg.Disc) else "polygon"


@lru_cache(maxsize=16)
def lab_shapes(task: str, starts: int) -> tuple[str, ...]:
    """Name the shape of each start's parcel, as the lab draws it."""
    config = EnvConfig(task=find_benchmark(task).task, preset=PRESETS[LAB])
    drawn = drawn_parcels(config, [{}] * starts, SEED)
    return tuple(name_shape(each.base) for each in drawn)
