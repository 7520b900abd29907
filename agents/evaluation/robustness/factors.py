"""The factors of the sweep: what is changed, one at a time, and how far."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from surface_gym.conditions import CONDITIONS
from surface_gym.layouts import box
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.randomisation import Actuators
from surface_gym.sensors import Camera, Exact, Presence

from .change import EXACT, Change

Level = float | int | str
DIRECTIONS = 16  # evenly around, that a load lies in off centre
SENSORS = {"exact": Exact(), "camera": Camera(), "presence": Presence()}
TRAINED = "trained"
LAB = "lab"


@dataclass(frozen=True)
class Factor:
    """One thing that is changed."""

    name: str
    label: str  # beside its panels
    unit: str  # of its levels; "": they are told by names, or bare numbers
    meaning: str  # in a sentence
    levels: tuple[Level, ...]
    change: Callable[[Any], Change]  # that a level makes
    told: tuple[Level, ...]  # those in the table
    trained: Level | None = None  # the level that is as trained; None: there is none
    of_lines: bool = False  # it is of tasks on a line alone

    @property
    def swept(self) -> tuple[Level, ...]:
        """The levels that are not as trained."""
        return tuple(level for level in self.levels if level != self.trained)

    @property
    def is_named(self) -> bool:
        """Whether its levels are told by names."""
        return any(isinstance(level, str) for level in self.levels)


def _square(length: float) -> Change:
    return Change(replace(EXACT, parcels=(Parcel(Rectangle(length, length)),)))


def _load(centimetres: float) -> Change:
    # Half of them S-boxes and half B-boxes, in the order in which the tasks draw those.
    turns = [2.0 * math.pi * k / DIRECTIONS for k in range(DIRECTIONS)]
    away = 0.01 * centimetres
    parcels = tuple(
        replace(box(size), com_offset=(away * math.cos(turn), away * math.sin(turn)))
        for size in ("S", "B")
        for turn in turns
    )
    return Change(replace(EXACT, parcels=parcels))


def _axis(milliseconds: float) -> Change:
    speed = 0.5 * math.pi / (1e-3 * milliseconds) if milliseconds else math.inf
    return Change(replace(EXACT, actuators=Actuators(axis_speed=speed)))


def _stuck(percent: float) -> Change:
    return Change(replace(EXACT, actuators=Actuators(stuck_share=0.01 * percent)))


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
    Factor("drag", "friction", "times", "mu_max times this, which no controller is told.",
           (0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3), lambda level: Change(drag=level),
           (0.7, 1.3), 1.0),
    Factor("rolling", "rolling friction", "times",
           "mu_min and mu_support times this, which no controller is told.",
           (0.5, 0.75, 1.0, 1.3, 1.6, 2.0), lambda level: Change(rolling=level),
           (0.5, 1.3, 2.0), 1.0),
    Factor("sensors", "sensors", "", "What shows the parcel.",
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
           tuple(range(6)), lambda level: Change(aside=0.01 * level), (2, 5), 0),
    Factor("turned", "entry turned", "deg", "How far turned parcels enter, either way.",
           (0, 2, 4, 6, 8, 10), lambda level: Change(turned=math.radians(level)), (4, 10), 0),
    Factor("stuck", "stuck modules", "%", "Probability of each module to be stuck at 90 deg.",
           (0, 2, 4, 6, 8, 10), _stuck, (2, 10), 0),
    Factor(LAB, "lab", "", CONDITIONS["lab"].meaning, (LAB,),
           lambda _: Change(CONDITIONS["lab"]), (LAB,)),
)  # fmt: skip
FACTORS = {factor.name: factor for factor in _EACH}
