"""A smart surface that steers parcels by friction: the simulator and its environments."""

from importlib import import_module
from types import ModuleType

from surface_gym import layouts, lines, sensors, tasks
from surface_gym.env import SmartSurfaceEnv
from surface_gym.parcel import Disc, Parcel, Polygon, Rectangle
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.registration import register, register_all
from surface_gym.simulation import simulate, simulate_together
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.vector_env import SmartSurfaceVectorEnv

register_all()

__version__ = "0.1.0"
__all__ = [
    "Actuators",
    "Disc",
    "Parcel",
    "Polygon",
    "Randomisation",
    "Rectangle",
    "SmartSurfaceEnv",
    "SmartSurfaceVectorEnv",
    "Surface",
    "Trajectory",
    "layouts",
    "lines",
    "register",
    "sensors",
    "simulate",
    "simulate_together",
    "tasks",
]


def __getattr__(name: str) -> ModuleType:
    """Import `surface_gym.agents` when it is first asked for: its libraries are an extra."""
    if name == "agents":
        return import_module("surface_gym.agents")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
