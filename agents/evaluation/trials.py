"""The starts that controllers are compared on, by task."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surface_gym.conditions import Condition
from surface_gym.tasks import Task, Track

from ..tasks import find_task, kind_of, label_of

SEED = 20_261_121  # of every start's draws
DRAWN = 500  # starts of a task that draws them

SORT_SPEEDS = np.arange(30, 271, 2) / 100.0  # [m/s]
SIDES = (1, -1)
PARCELS = ("S", "B")
ORIENT_ANGLES = tuple(math.radians(angle) for angle in (-45.0, -30.0, -15.0, 15.0, 30.0, 45.0))
ORIENT_SPEEDS = np.linspace(1.3, 1.7, 41)  # [m/s]


@dataclass(frozen=True, eq=False)
class Trial:
    """A task and the starts it is tried on."""

    name: str  # of the task, as `agents.tasks` has it
    task: Task
    starts: tuple[dict[str, Any], ...]  # options of each; what is left open is drawn
    told: str  # the starts, in a sentence

    @property
    def kind(self) -> str:
        """The name of the package's task that it is or inherits from; else its own."""
        return kind_of(self.name)

    @property
    def label(self) -> str:
        """The task's name in tables and in names of files."""
        return label_of(self.name)

    def some(self, count: int) -> "Trial":
        """`count` of the starts, or all where there are fewer, spread evenly."""
        places = np.linspace(0, len(self.starts) - 1, min(count, len(self.starts))).round()
        chosen = tuple(self.starts[place] for place in places.astype(int).tolist())
        return Trial(self.name, self.task, chosen, f"{len(chosen)} of these: {self.told}")

    def under(self, condition: Condition) -> "Trial":
        """The same under a condition: one of parcels of its own leaves open which it is."""
        if not condition.parcels:
            return self
        starts = tuple(
            {name: value for name, value in start.items() if name != "parcel"}
            for start in self.starts
        )
        return replace(self, starts=starts)


def _sort() -> tuple[list[dict[str, Any]], str]:
    starts = [
        {"speed": float(speed), "side": side, "parcel": parcel}
        for parcel in PARCELS
        for speed in SORT_SPEEDS
        for side in SIDES
    ]
    return starts, "entry speeds 0.30 to 2.70 m/s in steps of 0.02 m/s, both sides, both boxes"


def _orient() -> tuple[list[dict[str, Any]], str]:
    starts = [
        {"speed": float(speed), "angle": angle, "parcel": parcel}
        for parcel in PARCELS
        for speed in ORIENT_SPEEDS
        for angle in ORIENT_ANGLES
    ]
    return starts, "by 15, 30 and 45 deg to either side, entry speeds 1.3 to 1.7 m/s, both boxes"


def make_trial(name: str) -> Trial:
    """The trial of a task, the package's or one's own."""
    kind = kind_of(name)
    if kind == "sort":
        starts, told = _sort()
    elif kind == "orient":
        starts, told = _orient()
    else:
        starts, told = [{}] * DRAWN, f"{DRAWN} starts drawn by the task's own law"
    task = find_task(name)
    if name == "track":
        task = Track(tilts=(math.radians(10.0), math.radians(15.0)), kinds=("sine",))
        told = f"{DRAWN} drawn starts on sines, tilts 10 to 15 deg"
    return Trial(name, task, tuple(starts), told)
