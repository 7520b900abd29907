"""A smart surface that steers parcels by friction: the simulator and its environments.

Names are imported from their modules on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from surface_gym.registration import register, register_all

if TYPE_CHECKING:
    from surface_gym import layouts, lines, sensors, tasks
    from surface_gym.canvas import Image
    from surface_gym.env import SmartSurfaceEnv
    from surface_gym.machine.estimate import Estimate
    from surface_gym.machine.identification import identify
    from surface_gym.machine.log import excitation
    from surface_gym.parcel import Disc, Parcel, Polygon, Rectangle
    from surface_gym.player import replay
    from surface_gym.randomisation import Actuators, Randomisation
    from surface_gym.recorder import RecordReplay
    from surface_gym.recording import Recording
    from surface_gym.simulation import TippingWarning, simulate, simulate_together
    from surface_gym.surface import Surface
    from surface_gym.trajectory import Trajectory
    from surface_gym.vector_env import SmartSurfaceVectorEnv

register_all()

__version__ = "0.2.0"
__all__ = [
    "Actuators",
    "Disc",
    "Estimate",
    "Image",
    "Parcel",
    "Polygon",
    "Randomisation",
    "RecordReplay",
    "Recording",
    "Rectangle",
    "SmartSurfaceEnv",
    "SmartSurfaceVectorEnv",
    "Surface",
    "TippingWarning",
    "Trajectory",
    "excitation",
    "identify",
    "layouts",
    "lines",
    "register",
    "replay",
    "sensors",
    "simulate",
    "simulate_together",
    "tasks",
]
_NAMES = {
    "canvas": ("Image",),
    "env": ("SmartSurfaceEnv",),
    "machine.estimate": ("Estimate",),
    "machine.identification": ("identify",),
    "machine.log": ("excitation",),
    "parcel": ("Disc", "Parcel", "Polygon", "Rectangle"),
    "player": ("replay",),
    "randomisation": ("Actuators", "Randomisation"),
    "recorder": ("RecordReplay",),
    "recording": ("Recording",),
    "simulation": ("TippingWarning", "simulate", "simulate_together"),
    "surface": ("Surface",),
    "trajectory": ("Trajectory",),
    "vector_env": ("SmartSurfaceVectorEnv",),
}
_MODULES = ("agents", "layouts", "lines", "sensors", "tasks")  # agents need the extra of that name


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    for module, names in _NAMES.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f"{__name__}.{module}"), name)
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
