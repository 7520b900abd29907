"""The compiled half of every kind of sensor, by its number.

`begin` is called once at a start, `look` after every physics step, `estimate` when the controller
asks. Before each, `lanes.truth` holds the base's true pose and velocity.
"""

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import Scratch
from surface_gym.lanes.memory import Geometry, Lanes
from surface_gym.sensors import camera, exact, observer, presence
from surface_gym.sensors.camera import CAMERA
from surface_gym.sensors.exact import EXACT
from surface_gym.sensors.presence import PRESENCE
from surface_gym.sensors.sensor import Sensing


@inlined
def watches(sensing: Sensing) -> bool:
    """Whether the sensor looks between decisions; if not, `look` need not be called."""
    return sensing.number != EXACT


@inlined
def begin(sensing: Sensing, lanes: Lanes, lane: int) -> None:
    """Set the sensor's memory at a start."""
    if sensing.number == CAMERA:
        camera.begin(sensing.settings, lanes, lane)
    elif sensing.number == PRESENCE:
        presence.begin(sensing.settings, lanes, lane)


@inlined
def look(
    sensing: Sensing, lanes: Lanes, lane: int, geometry: Geometry, scratch: Scratch, dt: float
) -> None:
    """Take in what a physics step brought; `lanes.steps` has been counted up."""
    if sensing.number == CAMERA:
        camera.look(sensing.settings, lanes, lane, geometry, scratch, dt)
    elif sensing.number == PRESENCE:
        presence.look(sensing.settings, lanes, lane, geometry, scratch, dt)


@inlined
def estimate(sensing: Sensing, lanes: Lanes, lane: int) -> None:
    """Write the estimate of pose and velocity into `lanes.sensed`."""
    if sensing.number == EXACT:
        exact.estimate(lanes, lane)
    elif sensing.number in (CAMERA, PRESENCE):
        observer.estimate(lanes, lane)
