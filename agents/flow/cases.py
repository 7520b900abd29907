"""The streams that controllers of a flow are compared on, and what they are compared under."""

from dataclasses import dataclass

import numpy as np

from surface_gym.conditions import Condition
from surface_gym.flow.arrivals import HOUR, Steady
from surface_gym.flow.stream import Stream
from surface_gym.layouts import box
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Camera

SPEEDS = (1.0, 1.5, 2.0)  # [m/s]
MIXES = {"S": ("S",), "S and B": ("S", "B")}  # parcels by name, of equal odds
EXITS = "sides"  # left, right and straight on, at equal odds
LOADS = tuple(np.linspace(0.1, 1.0, 8).round(3).tolist())  # [-] offered, of the ceiling
APART = 0.05  # [m] between parcels that follow each other at the ceiling

EXACT = Condition("exact", "exact", "Sensors show pose and velocity as they are.")
SEEN = Condition(
    "camera",
    "camera",
    "A camera's frames, 1 mm and 0.5 deg off and 20 ms late, and a filter; mu_max differs from "
    "parcel to parcel by up to 20 %.",
    sensors=Camera(),
    randomisation=Randomisation(friction=0.2),
)
CONDITIONS = {condition.name: condition for condition in (EXACT, SEEN)}
LEAST_RIGHT = {"exact": 0.999, "camera": 0.995}  # [-] of deliveries, for a rate to be held


@dataclass(frozen=True)
class Case:
    """Parcels at one speed under a condition, at whatever rate they are offered."""

    mix: str  # one of MIXES
    speed: float  # [m/s] at which they enter
    condition: str = "exact"  # one of CONDITIONS

    @property
    def label(self) -> str:
        """For tables."""
        return f"{self.mix}, {self.speed:g} m/s"

    @property
    def ceiling(self) -> float:
        """[parcels/h] that a line could take at most, one behind the other."""
        length = float(np.mean([np.ptp(box(kind).base.outline[:, 0]) for kind in MIXES[self.mix]]))
        return HOUR * self.speed / (length + APART)

    def stream(self, rate: float) -> Stream:
        """At an even rate [parcels/h]."""
        return Stream(Steady(rate), parcels=MIXES[self.mix], speeds=self.speed)


CURVE = Case("S and B", 1.5)  # of which the rate is shown against the load


def cases(condition: str = "exact") -> list[Case]:
    """All mixes and speeds under a condition."""
    return [Case(mix, speed, condition) for mix in MIXES for speed in SPEEDS]
