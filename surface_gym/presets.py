"""Presets: sensors, randomisation and actuators that are less than ideal, by name."""

import math
from dataclasses import dataclass

from surface_gym.parcel import Parcel, assortment
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import AdaptiveCamera, Camera, Entry, Exact, Sensor


@dataclass(frozen=True)
class Preset:
    """Sensors, randomisation and actuators of an environment: its argument `preset`."""

    name: str
    label: str  # for tables
    meaning: str  # in a sentence
    sensors: Sensor = Exact()
    randomisation: Randomisation = Randomisation()
    actuators: Actuators = Actuators()
    parcels: tuple[Parcel, ...] = ()  # that a task draws from; none: the task's own


SURE = Entry(position=0.0, angle=0.0, speed=0.0, turning=0.0)
LATENCY = 0.08  # [s] two control periods

# Of the assortment that the lab draws its parcels from.
LAB_PARCELS, LAB_SEED = 128, 20_261_122
QUARTER_TURN = 0.05  # [s] that an axis of the lab takes to turn by 90 deg

_EACH = (
    Preset("exact", "exact", "Sensors show pose and velocity as they are."),
    Preset(
        "camera",
        "camera",
        "A camera's frames, 1 mm and 0.5 deg off and 20 ms late, and a filter; the entry speed is "
        "known to 0.05 m/s.",
        sensors=Camera(),
    ),
    Preset(
        "friction",
        "friction ±20 %",
        "mu_max differs from parcel to parcel by up to 20 %; sensors are exact.",
        randomisation=Randomisation(friction=0.2),
    ),
    Preset(
        "latency",
        "80 ms late",
        "Frames without noise, 80 ms late, with friction that differs by up to 20 % from what the "
        "filter assumes, so that it cannot reckon the delay away.",
        sensors=Camera(latency=LATENCY, position_noise=0.0, angle_noise=0.0, entry=SURE),
        randomisation=Randomisation(friction=0.2),
    ),
    Preset(
        "stuck",
        "5 % stuck",
        "Each module is stuck at 90 deg with a probability of 5 %; sensors are exact.",
        actuators=Actuators(stuck_share=0.05),
    ),
    Preset(
        "lab",
        "lab",
        "All at once, mildly: squares, rectangles, discs and polygons of 0.2 to 0.45 m with loads "
        "up to 3 cm off centre, that enter 1 cm and 3 deg off; friction that differs by up to "
        "15 %; axes that take 50 ms for 90 deg, 2 % of the modules stuck; a camera of 50 Hz, "
        "40 ms late, 2 mm and 0.5 deg off.",
        sensors=AdaptiveCamera(
            latency=0.04,
            position_noise=0.002,
            entry=Entry(position=0.005, angle=0.02),
        ),
        randomisation=Randomisation(
            friction=0.15, rolling=0.15, lateral=0.01, heading=math.radians(3.0)
        ),
        actuators=Actuators(axis_speed=0.5 * math.pi / QUARTER_TURN, stuck_share=0.02),
        parcels=assortment(LAB_PARCELS, LAB_SEED),
    ),
)
PRESETS = {preset.name: preset for preset in _EACH}
