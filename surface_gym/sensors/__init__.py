"""What a controller gets to see of the parcel: emulated sensors, each with its compiled half."""

from surface_gym.sensors.exact import Exact
from surface_gym.sensors.sensor import Sensors

KINDS = (Exact,)

__all__ = ["KINDS", "Exact", "Sensors"]
