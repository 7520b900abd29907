"""What an observation says, back in SI units and in the world's axes: what rules reckon with."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.sensors import AdaptiveCamera
from surface_gym.settings import Settings
from surface_gym.tasks.sort import Sort
from surface_gym.tasks.track import AHEAD

Numbers = NDArray[np.float64]


def square_reach(half_length: Numbers | float, theta: Numbers) -> Numbers:
    """[m] a square base turned by theta [rad] reaches along x, and along y, from its centre."""
    reach: Numbers = half_length * (np.abs(np.cos(theta)) + np.abs(np.sin(theta)))
    return reach


@dataclass(frozen=True, eq=False)
class LineSight:
    """The parcel on a line, as a task other than Track shows it; arrays (lanes,)."""

    into_zone: Numbers  # [m] x of the base's centre past the zone's first edge
    offset: Numbers  # [m] y of the base's centre from the line's middle
    theta: Numbers  # [rad]
    vx: Numbers  # [m/s]
    vy: Numbers  # [m/s]
    omega: Numbers  # [rad/s]
    half_length: Numbers  # [m] of the base, taken as a square
    pitch: tuple[float, float]  # [m] of the plant, in x and in y
    side: Numbers  # Sort: +1 for y > 0, -1 for y < 0, 0 for straight through; else 0
    ratio: Numbers  # Slow: [-] asked of the entry speed; else 0
    entry_speed: Numbers  # Slow: [m/s]; else 0
    to_go: Numbers  # Stop: [m] to the asked x; else 0
    angle: Numbers  # Orient: [rad] asked theta; else 0
    front_in_zone: Numbers  # [m] foremost point past the zone's first edge; Sort: as of a square
    rear_to_go: Numbers  # [m] from the rearmost point to the zone's end; Sort: as of a square
    half_width: Numbers  # [m] of the base; taken as a square where it is not shown
    fill: Numbers  # [-] share of the base in the rectangle around it; 1 where it is not shown
    friction: Numbers  # [-] factor of mu_max, as the sensors have learned it; 1 where they do not
    load_ahead: Numbers  # [m] along x from the base's centre to the load, likewise; 0

    @property
    def reach(self) -> Numbers:
        """(lanes,) [m] the base reaches along x, and along y, from its centre."""
        return square_reach(self.half_length, self.theta)


@dataclass(frozen=True, eq=False)
class PathSight:
    """The parcel beside its path, as Track shows it; arrays (lanes,) where nothing else is said."""

    cross_error: Numbers  # [m] off the path, square to it, positive to its left
    speed_error: Numbers  # [m/s] over the asked speed, along the path
    cross_speed: Numbers  # [m/s] square to the path, positive to its left
    asked_speed: Numbers  # [m/s]
    slope: Numbers  # (lanes, 4) dy/dx of the path `AHEAD` [m] of the centre
    tilt: Numbers  # [rad]
    theta: Numbers  # [rad]
    omega: Numbers  # [rad/s]
    half_length: Numbers  # [m] of the base, taken as a square
    pitch: tuple[float, float]  # [m] of the plant, in x and in y
    x_in_pitch: Numbers  # [m] of the centre past the nearest module's, in -pitch/2 to pitch/2
    y_in_pitch: Numbers  # [m]

    @property
    def velocity(self) -> tuple[Numbers, Numbers]:
        """(lanes,) [m/s] vx and vy."""
        along = self.asked_speed + self.speed_error
        cosine = 1.0 / np.sqrt(1.0 + self.slope[:, 0] ** 2)
        sine = self.slope[:, 0] * cosine
        return along * cosine - self.cross_speed * sine, along * sine + self.cross_speed * cosine


class _Columns:
    """The columns of observations by their features' names; absent ones are 0."""

    def __init__(self, settings: Settings, observations: NDArray[np.float32]) -> None:
        self._place = {feature.name: k for k, feature in enumerate(settings.features)}
        self._seen = observations.astype(np.float64)

    def __contains__(self, name: str) -> bool:
        return name in self._place

    def __getitem__(self, name: str) -> Numbers:
        place = self._place.get(name)
        return np.zeros(len(self._seen)) if place is None else self._seen[:, place]

    @property
    def theta(self) -> Numbers:
        return np.arctan2(self["sine of theta"], self["cosine of theta"])

    @property
    def half_length(self) -> Numbers:
        return 0.175 + 0.05 * self["size"]

    def in_pitch(self, axis: str, pitch: float) -> Numbers:
        phase = np.arctan2(self[f"sine of phase {axis}"], self[f"cosine of phase {axis}"])
        return pitch * phase / (2.0 * math.pi)


def _pitch(settings: Settings) -> tuple[float, float]:
    return settings.chosen_plant.pitch_x, settings.chosen_plant.pitch_y


def line_sight(settings: Settings, observations: NDArray[np.float32]) -> LineSight:
    """What observations (lanes, features) of Sort, Slow, Stop or Orient say."""
    see = _Columns(settings, observations)
    side = see["side"]
    # Sort shows a parcel that is to go to y < 0 in a mirror.
    mirror = np.where(side < 0.0, -1.0, 1.0)
    theta = mirror * see.theta
    half_length = see.half_length
    reach = square_reach(half_length, theta)
    if isinstance(settings.task, Sort):
        into_zone = 0.5 * see["distance into zone"] + reach
        front_in_zone = into_zone + reach
        end = settings.chosen_plant.pitch_x * settings.action_kind.columns
        rear_to_go = end - into_zone + reach
    else:
        front_in_zone, rear_to_go = 0.5 * see["front in zone"], 0.5 * see["rear to go"]
        into_zone = front_in_zone - reach
    shown = "width" in see
    friction, load_ahead = _learned(settings, see)
    return LineSight(
        into_zone=into_zone,
        offset=mirror * 0.3 * see["lateral offset"],
        theta=theta,
        vx=1.0 + see["forward speed"],
        vy=mirror * 0.5 * see["lateral speed"],
        omega=mirror * 3.0 * see["turning speed"],
        half_length=half_length,
        pitch=_pitch(settings),
        side=side,
        ratio=see["asked ratio"],
        entry_speed=np.where(see["asked ratio"] > 0.0, 1.5 + see["entry speed"], 0.0),
        to_go=0.5 * see["to go"],
        angle=see["asked angle"],
        front_in_zone=front_in_zone,
        rear_to_go=rear_to_go,
        half_width=0.175 + 0.05 * see["width"] if shown else half_length,
        fill=see["fill"] if shown else np.ones_like(half_length),
        friction=friction,
        load_ahead=load_ahead,
    )


def _learned(settings: Settings, see: _Columns) -> tuple[Numbers, Numbers]:
    """(lanes,) the factor of mu_max, and [m] how far along x the load lies from the centre."""
    sensors, theta = settings.sensors, see.theta
    if not isinstance(sensors, AdaptiveCamera):
        return np.ones_like(theta), np.zeros_like(theta)
    friction = 1.0 + sensors.friction_spread * see["friction learned"]
    # Sort's mirror turns both theta and the load's y round, as seen, and so leaves x as it is.
    load_x, load_y = see["load learned, x"], see["load learned, y"]
    ahead = np.cos(theta) * load_x - np.sin(theta) * load_y
    return friction, sensors.load_spread * ahead


def path_sight(settings: Settings, observations: NDArray[np.float32]) -> PathSight:
    """What observations (lanes, features) of Track say."""
    see = _Columns(settings, observations)
    pitch = _pitch(settings)
    return PathSight(
        cross_error=0.05 * see["cross error"],
        speed_error=0.2 * see["speed error"],
        cross_speed=0.1 * see["lateral speed"],
        asked_speed=0.8 + see["asked speed"],
        slope=np.stack([see[f"slope {ahead:g} m ahead"] for ahead in AHEAD], axis=-1),
        tilt=np.arcsin(0.2 * see["tilt"]),
        theta=see.theta,
        omega=3.0 * see["turning speed"],
        half_length=see.half_length,
        pitch=pitch,
        x_in_pitch=see.in_pitch("x", pitch[0]),
        y_in_pitch=see.in_pitch("y", pitch[1]),
    )
