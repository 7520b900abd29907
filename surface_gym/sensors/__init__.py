"""What a controller gets to see of the parcel: emulated sensors, each with its compiled half."""

from surface_gym.sensors.camera import Camera
from surface_gym.sensors.entry import Entry
from surface_gym.sensors.exact import Exact
from surface_gym.sensors.learning_camera import LearningCamera
from surface_gym.sensors.presence import Presence
from surface_gym.sensors.sensor import Sensor

KINDS = (Exact, Camera, LearningCamera, Presence)

__all__ = ["KINDS", "Camera", "Entry", "Exact", "LearningCamera", "Presence", "Sensor"]
