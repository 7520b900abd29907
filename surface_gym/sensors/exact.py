"""Exact: pose and velocity as they are."""

from dataclasses import dataclass

from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import Array
from surface_gym.lanes.lane import Lane
from surface_gym.sensors.sensor import Sensor


@dataclass(frozen=True)
class Exact(Sensor):
    """Sees pose and velocity of the base's centroid as they are, without delay."""

    @staticmethod
    @lane_function
    def estimate(numbers: Array, lane: Lane) -> None:
        """Show the truth."""
        for k in range(6):
            lane.sensed[k] = lane.truth[k]
