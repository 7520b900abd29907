"""What parcels practise on: streams as dense as a line can take, of every speed it is meant for."""

from dataclasses import replace

import numpy as np

from surface_gym.flow.arrivals import HOUR, Steady
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Camera, Exact

SPEEDS = (0.9, 2.2)  # [m/s] of a stream, uniform between them
MIXES: tuple[tuple[str, ...], ...] = (("S",), ("S", "B"))  # parcels of a stream: equal odds
SHORTEST = 0.3  # [m] from parcel to parcel of the densest stream: an S-box and 5 cm
DURATION = 20.0  # [s] of an episode


def densest(speed: float, parcels: tuple[str, ...], load: float = 1.0) -> Stream:
    """A stream of a speed [m/s] that always has a parcel waiting at the gate; or a share of it."""
    return Stream(Steady(HOUR * speed / SHORTEST * load), parcels=parcels, speeds=speed)


def stream_of(rng: np.random.Generator) -> Stream:
    """The stream of an episode: its speed uniform, its mix at equal odds."""
    speed = float(rng.uniform(*SPEEDS))
    return densest(speed, MIXES[int(rng.integers(len(MIXES)))])


def practice_settings(control_period: float) -> FlowSettings:
    """The line that is practised on, seen exactly."""
    return FlowSettings(
        stream=densest(1.5, ("S", "B")),
        exits="sides",
        actions="parcels",
        gate=True,
        control_period=control_period,
        duration=DURATION,
        sensors=Exact(),
    )


def by_camera(settings: FlowSettings, friction: float) -> FlowSettings:
    """The same line seen by a camera, its friction varied."""
    return replace(settings, sensors=Camera(), randomisation=Randomisation(friction=friction))
