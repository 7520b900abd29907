"""Emulated sensors of a parcel's motion, with their compiled functions."""

from surface_gym.sensors.base import Entry, Exact, Sensor
from surface_gym.sensors.camera import AdaptiveCamera, Camera
from surface_gym.sensors.presence import Presence

KINDS = (Exact, Camera, AdaptiveCamera, Presence)

__all__ = ["KINDS", "AdaptiveCamera", "Camera", "Entry", "Exact", "Presence", "Sensor"]
