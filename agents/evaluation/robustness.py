"""The robustness study: scenarios in which one factor at a time differs from training."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

import surface_gym as sg
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.parcel import Base
from surface_gym.tasks.benchmark import Benchmark

from ..base import time_for, with_zone
from ..planning.planner import run_oracle
from ..rollout import run_episodes, run_sequentially
from .method import ANY_ANGLE, BEST_FIXED, PLANNER, Method, start_benchmark
from .scenario import SEED, WHOLE, Extent, Row, Scenario, drawn_parcels

# Methods for one parcel or zone, or with a search per start.
LEFT_OUT = (BEST_FIXED, ANY_ANGLE)
# Methods with a long look-ahead use a quarter of the starts, the planner a sixth.
FEWER = {"turning rule": 4, "sliding mode": 4, PLANNER: 6}
EXACT = PRESETS["exact"]
TRAINED, LAB = "trained", "lab"
# The planner sees the true state of a start, so it shows the reachable success. It runs on these
# factors, at the displayed levels.
PLANNED = (TRAINED, "square", LAB)
FOLLOWED = 32  # maximum environments of the planner at a time
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
    """Differences from a method's own environment; none by default."""

    preset: Preset = EXACT  # sensors, randomisation, actuators and parcels
    control_period: float | None = None  # [s] between decisions; None: the method's
    # Obeying columns of the line; None: the line's. With more columns, episodes may last longer.
    zone_columns: int | None = None
    drag: float = 1.0  # [-] factor of mu_max, unknown to every controller
    rolling: float = 1.0  # [-] factor of mu_min and mu_support, unknown to every controller
    offset: float = 0.0  # [m] lateral offset of the entry, to either side
    turn: float = 0.0  # [rad] angle at the entry, to the same side


class Situation(NamedTuple):
    """An environment: assumed by the controller, and true."""

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
    """One changed factor."""

    name: str
    label: str  # label of its panels
    unit: str  # unit of its levels; "": names, or numbers without a unit
    meaning: str  # explanation in a sentence
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


def _square(length: float) -> Change:
    return Change(replace(EXACT, parcels=(sg.Parcel(sg.Rectangle(length, length)),)))


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
class ChangedScenario(Scenario):
    """Random starts of a task, with one factor at one level."""

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
            episodes = run_oracle(where.true, drawn, SEED, FOLLOWED)
        else:
            run = run_episodes if method.most is None else run_sequentially
            episodes = run(method.controller(where.assumed, seed), where.true, drawn, SEED)
        rows = [
            {
                "success": episodes.success[k], "time": episodes.time[k],
                **{name: values[k] for name, values in episodes.metrics.items()},
            }
            for k in range(count)
        ]  # fmt: skip
        if self.factor == LAB:
            shapes = lab_shapes(self.task, count)
            rows = [{**row, "shape": shape} for row, shape in zip(rows, shapes, strict=True)]
        return rows


def scenario_name(factor: str, level: Level) -> str:
    """Return the name of a factor's level; the level of the training is common to all factors."""
    return TRAINED if level in (FACTORS[factor].trained, TRAINED) else f"{factor} {level}"


def changed_scenarios(task: str, extent: Extent = WHOLE) -> list[Scenario]:
    """List the robustness scenarios of a task."""
    found: list[Scenario] = []
    for factor in FACTORS.values():
        levels = factor.shown[: extent.levels] if extent.levels else factor.levels
        for level in levels:
            preset = factor.change(level).preset.name
            found.append(ChangedScenario(task, preset, extent, factor.name, level))
    return found


def name_shape(base: Base) -> str:
    """Return the name of the shape of a base in the lab."""
    if isinstance(base, sg.Rectangle):
        return "square" if base.length == base.width else "rectangle"
    return "disc" if isinstance(base, sg.Disc) else "polygon"


@lru_cache(maxsize=16)
def lab_shapes(task: str, starts: int) -> tuple[str, ...]:
    """Return the name of the shape of each start's parcel in the lab."""
    config = EnvConfig(task=start_benchmark(task).task, preset=PRESETS[LAB])
    drawn = drawn_parcels(config, [{}] * starts, SEED)
    return tuple(name_shape(each.base) for each in drawn)
