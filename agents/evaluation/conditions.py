"""What controllers are compared under."""

from dataclasses import dataclass

from surface_gym.actuators import Actuators
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Camera, Entry, Exact, Sensor


@dataclass(frozen=True)
class Condition:
    """One way in which the real is less kind than the ideal."""

    name: str
    label: str  # for tables
    meaning: str  # in a sentence
    sensors: Sensor = Exact()
    randomisation: Randomisation = Randomisation()
    actuators: Actuators = Actuators()


SURE = Entry(position=0.0, angle=0.0, speed=0.0, turning=0.0)
LATENCY = 0.08  # [s] two control periods

CONDITIONS = (
    Condition("exact", "exact", "Sensors show pose and velocity as they are."),
    Condition(
        "camera",
        "camera",
        "A camera's frames, 1 mm and 0.5 deg off and 20 ms late, and a filter; the entry speed is "
        "known to 0.05 m/s.",
        sensors=Camera(),
    ),
    Condition(
        "friction",
        "friction ±20 %",
        "mu_max differs from parcel to parcel by up to 20 %; sensors are exact.",
        randomisation=Randomisation(friction=0.2),
    ),
    Condition(
        "latency",
        "80 ms late",
        "Frames without noise, 80 ms late, with friction that differs by up to 20 % from what the "
        "filter assumes, so that it cannot reckon the delay away.",
        sensors=Camera(latency=LATENCY, position_noise=0.0, angle_noise=0.0, entry=SURE),
        randomisation=Randomisation(friction=0.2),
    ),
    Condition(
        "stuck",
        "5 % stuck",
        "Each module is stuck at 90 deg with a probability of 5 %; sensors are exact.",
        actuators=Actuators(stuck_share=0.05),
    ),
)
