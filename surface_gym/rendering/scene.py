"""What a picture shows, told in metres and radians: nothing here knows of environments."""

from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks


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
class Scene:
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
        axis = checks.array("axis", self.axis, (None, None))
        if axis.size == 0:
            raise ValueError(f"axis must have at least one row and one column, got {axis.shape}")
        rotor = np.array(self.rotor)
        if rotor.dtype != np.bool_:
            raise ValueError(f"rotor must be an array of booleans, got one of {rotor.dtype}")
        if rotor.shape != axis.shape:
            raise ValueError(f"rotor must have the shape of axis, {axis.shape}, got {rotor.shape}")
        rotor.setflags(write=False)
        outline = checks.array("outline", self.outline, (None, 2))
        if len(outline) < 3:
            raise ValueError(f"outline must have at least 3 points, got {len(outline)}")
        x, y = outline.T
        if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) == 0.0:
            raise ValueError(f"outline must enclose an area, got {outline.tolist()}")
        set_field = object.__setattr__
        set_field(self, "axis", axis)
        set_field(self, "rotor", rotor)
        set_field(self, "outline", outline)
        set_field(self, "trail", checks.array("trail", self.trail, (None, 2)))
        set_field(self, "pose", tuple(checks.array("pose", self.pose, (3,)).tolist()))
        if self.sensed_pose is not None:
            sensed = checks.array("sensed_pose", self.sensed_pose, (3,))
            set_field(self, "sensed_pose", tuple(sensed.tolist()))
        set_field(self, "pitch", checks.pitch("pitch", self.pitch))
        set_field(self, "origin", tuple(checks.array("origin", self.origin, (2,)).tolist()))
        set_field(self, "tilt", checks.number("tilt", self.tilt))
        if self.zone is not None:
            set_field(self, "zone", self._checked_zone(self.zone))
        if self.goal is not None and not isinstance(self.goal, Goal):
            raise ValueError(f"goal must be one of the goals or None, got {self.goal!r}")
        pairs = all(
            isinstance(pair, tuple) and len(pair) == 2 and all(isinstance(t, str) for t in pair)
            for pair in self.readings
        )
        if not pairs:
            raise ValueError(f"readings must be pairs of label and text, got {self.readings!r}")

    def _checked_zone(self, zone: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        if len(zone) != 4:
            raise ValueError(
                f"zone must be first row, rows, first column and columns, got {zone!r}"
            )
        first_row = checks.integer("zone's first row", zone[0], least=0)
        rows = checks.integer("zone's rows", zone[1], least=1)
        first_column = checks.integer("zone's first column", zone[2], least=0)
        columns = checks.integer("zone's columns", zone[3], least=1)
        if first_row + rows > self.rows or first_column + columns > self.columns:
            raise ValueError(
                f"zone must lie within the {self.rows} rows and {self.columns} columns, "
                f"got {zone!r}"
            )
        return (first_row, rows, first_column, columns)

    @property
    def rows(self) -> int:
        """Number of elements across the line, in y."""
        return int(self.axis.shape[0])

    @property
    def columns(self) -> int:
        """Number of elements along the line, in x."""
        return int(self.axis.shape[1])

    @property
    def pitches(self) -> tuple[float, float]:
        """[m] from column to column, and from row to row."""
        return (self.pitch, self.pitch) if isinstance(self.pitch, float) else self.pitch

    @property
    def obeys(self) -> NDArray[np.bool_]:
        """(rows, columns) the elements in the zone."""
        if self.zone is None:
            return np.ones(self.axis.shape, dtype=bool)
        row, rows, column, columns = self.zone
        obeys = np.zeros(self.axis.shape, dtype=bool)
        obeys[row : row + rows, column : column + columns] = True
        return obeys
