"""What a picture shows, told in metres and radians: nothing here knows of environments."""

from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.rendering.elements import (
    OnElements,
    check_readings,
    checked_axis,
    checked_outline,
    checked_pose,
    checked_rotor,
    checked_zone,
)


@dataclass(frozen=True)
class ExitSide:
    """Leave the line on one side, or at its end."""

    side: int  # -1 for y < 0, +1 for y > 0, 0 for straight through

    def __post_init__(self) -> None:
        checks.one_of("side", self.side, (-1, 0, 1))


@dataclass(frozen=True)
class StopLine:
    """Come to rest with the centre on a line across the surface."""

    x: float  # [m]

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", checks.number("x", self.x))


@dataclass(frozen=True)
class ExitSpeed:
    """Leave the line's end at a share of the entry speed."""

    ratio: float  # [-] exit speed / entry speed
    speed: float  # [m/s] exit speed

    def __post_init__(self) -> None:
        object.__setattr__(self, "ratio", checks.not_negative("ratio", self.ratio))
        object.__setattr__(self, "speed", checks.not_negative("speed", self.speed))


@dataclass(frozen=True, eq=False)
class Path:
    """Follow a curve with the centre."""

    points: Any  # (points, 2) [m], at least two; kept as an array

    def __post_init__(self) -> None:
        points = checks.array("points", self.points, (None, 2))
        if len(points) < 2:
            raise ValueError(f"points must be at least 2, got {len(points)}")
        object.__setattr__(self, "points", points)


@dataclass(frozen=True)
class Heading:
    """Turn to an angle."""

    angle: float  # [rad] the asked theta

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", checks.number("angle", self.angle))


Goal: TypeAlias = ExitSide | StopLine | ExitSpeed | Path | Heading


@dataclass(frozen=True, eq=False)
class Scene(OnElements):
    """One moment of a parcel on a surface.

    Raises:
        ValueError: arrays whose shapes do not fit each other or are not finite, a zone outside
            the surface, an outline that encloses no area, a goal of another kind, or readings
            that are not pairs of texts.
    """

    axis: NDArray[np.float64]  # (rows, columns) [rad] rotor axis from x, anti-clockwise
    rotor: NDArray[np.bool_]  # (rows, columns) an orientable rotor, else a support
    outline: NDArray[np.float64]  # (points, 2) [m] of the parcel's base, in its own frame
    pose: tuple[float, float, float]  # [m, m, rad] of that frame
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    origin: tuple[float, float] = (0.05, 0.05)  # [m] centre of element [0, 0]
    # First row, rows, first column and columns of the modules that obey a controller; None: all do.
    zone: tuple[int, int, int, int] | None = None
    # (points, 2) [m] where the parcel's centre has been, oldest first
    trail: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    sensed_pose: tuple[float, float, float] | None = None  # [m, m, rad] what the sensors say
    goal: Goal | None = None
    tilt: float = 0.0  # [rad] downhill towards +x
    title: str = ""
    readings: tuple[tuple[str, str], ...] = ()  # label and text of each number shown

    def __post_init__(self) -> None:
        axis = checked_axis(self.axis)
        rotor = checked_rotor(self.rotor, axis.shape)
        outline = checked_outline(self.outline)
        set_field = object.__setattr__
        set_field(self, "axis", axis)
        set_field(self, "rotor", rotor)
        set_field(self, "outline", outline)
        set_field(self, "trail", checks.array("trail", self.trail, (None, 2)))
        set_field(self, "pose", checked_pose("pose", self.pose))
        if self.sensed_pose is not None:
            set_field(self, "sensed_pose", checked_pose("sensed_pose", self.sensed_pose))
        set_field(self, "pitch", checks.pitch("pitch", self.pitch))
        set_field(self, "origin", tuple(checks.array("origin", self.origin, (2,)).tolist()))
        set_field(self, "tilt", checks.number("tilt", self.tilt))
        if self.zone is not None:
            set_field(self, "zone", checked_zone(self.zone, self.rows, self.columns))
        if self.goal is not None and not isinstance(self.goal, Goal):
            raise ValueError(f"goal must be one of the goals or None, got {self.goal!r}")
        check_readings(self.readings)
