"""Exact: pose and velocity as they are."""

from dataclasses import dataclass

import numpy as np

from surface_gym.dynamics.compiled import inlined
from surface_gym.lanes.memory import Lanes
from surface_gym.sensors.sensor import Sensing

EXACT = 0


@dataclass(frozen=True)
class Exact:
    """Sees pose and velocity of the base's centroid as they are, without delay."""

    def sensing(self, dt: float) -> Sensing:
        """The sensor as compiled code reads it; it has no settings."""
        del dt
        return Sensing(EXACT, np.zeros(1))

    def draws(self, dt: float, steps: int) -> int:
        """None: it draws no noise."""
        del dt, steps
        return 0


@inlined
def estimate(lanes: Lanes, lane: int) -> None:
    """Write what is seen into `lanes.sensed`."""
    for k in range(6):
        lanes.sensed[lane, k] = lanes.truth[lane, k]
