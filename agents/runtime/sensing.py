"""The camera that a device has."""

from surface_gym.conditions import SURE
from surface_gym.sensors import Camera, Exact, Sensor

IDEAL = Camera(latency=0.0, position_noise=0.0, angle_noise=0.0, entry=SURE)


def camera_of(sensor: Sensor) -> Camera:
    """The camera of an environment's sensor; that of an exact one has no noise and no delay.

    Raises:
        ValueError: a sensor that takes no frames.
    """
    if isinstance(sensor, Camera):
        return sensor
    if isinstance(sensor, Exact):
        return IDEAL
    raise ValueError(f"sensors must be a Camera or Exact, which has frames, got {sensor!r}")
