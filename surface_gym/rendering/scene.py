"""The contents of a picture in metres and radians, independent of environments."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks

Zone: TypeAlias = tuple[int, int, int, int]  # first row, rows, first column and columns
Pose: TypeAlias = tuple[float, float, float]  # [m, m, rad]

_ROUNDING = 1e-9  # [m] by which a span may pass the surface's end or its neighbour's


@dataclass(frozen=True)
class ExitSide:
    """The goal to leave the line on one side, or at its end."""

    side: int  # -1 for y < 0, +1 for y > 0, 0 for straight through

    def __post_init__(self) -> None:
        checks.one_of("side", self.side, (-1, 0, 1))


@dataclass(frozen=True)
class StopLine:
    """The goal to come to rest with the centre on a line across the surface."""

    x: float  # [m]

    def __post_init__(self) -> None:
        _set(self, x=checks.number("x", self.x))


@dataclass(frozen=True)
class ExitSpeed:
    """The goal to leave the line's end at a share of the entry speed."""

    ratio: float  # [-] exit speed / entry speed
    speed: float  # [m/s] exit speed

    def __post_init__(self) -> None:
        _set(self, ratio=checks.not_negative("ratio", self.ratio))
        _set(self, speed=checks.not_negative("speed", self.speed))


@dataclass(frozen=True, eq=False)
class Path:
    """The goal to follow a curve with the centre."""

    points: Any  # (points, 2) [m], at least two; kept as an array

    def __post_init__(self) -> None:
        _set(self, points=checks.array("points", self.points, (None, 2)))
        if len(self.points) < 2:
            raise ValueError(f"points must be at least 2, got {len(self.points)}")


@dataclass(frozen=True)
class Heading:
    """The goal to turn to an angle."""

    angle: float  # [rad] the asked theta

    def __post_init__(self) -> None:
        _set(self, angle=checks.number("angle", self.angle))


Goal: TypeAlias = ExitSide | StopLine | ExitSpeed | Path | Heading


@dataclass(frozen=True, eq=False)
class SceneParcel:
    """A parcel in a picture.

    Raises:
        ValueError: arrays of another shape or not finite, an outline that encloses no area, an
            exit that is no index, or a label that is no text.
    """

    outline: NDArray[np.float64]  # (points, 2) [m] of the base, in its own frame
    pose: Pose  # of that frame
    exit: int | None = None  # index of the exit that it is to leave by, if there are exits
    # (points, 2) [m] recent positions of the parcel's centre, oldest first
    trail: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    sensed_pose: Pose | None = None  # according to the sensors
    label: str = ""  # written on it where it has room; empty: the name of its exit

    def __post_init__(self) -> None:
        _set(self, outline=checks.array("outline", self.outline, (None, 2)))
        if len(self.outline) < 3:
            raise ValueError(f"outline must have at least 3 points, got {len(self.outline)}")
        x, y = self.outline.T
        if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) == 0.0:
            raise ValueError(f"outline must enclose an area, got {self.outline.tolist()}")
        _set(self, pose=_checked_pose("pose", self.pose))
        if self.exit is not None:
            _set(self, exit=checks.integer("exit", self.exit, least=0))
        _set(self, trail=checks.array("trail", self.trail, (None, 2)))
        if self.sensed_pose is not None:
            _set(self, sensed_pose=_checked_pose("sensed_pose", self.sensed_pose))
        if not isinstance(self.label, str):
            raise ValueError(f"label must be a text, got {self.label!r}")


@dataclass(frozen=True)
class ExitMark:
    """A chute beside the line, or the way straight on.

    Raises:
        ValueError: a name that is no text, another side, or a span that does not go forwards.
    """

    name: str  # short: it is written on the chute and on the parcels that are to leave there
    side: int  # +1 to the left, y > 0; -1 to the right, y < 0; 0 straight on
    first: float  # [m] x where it begins
    last: float  # [m] x where it ends

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ValueError(f"name must be a text, got {self.name!r}")
        _set(self, side=checks.one_of("side", self.side, (-1, 0, 1)))
        _set(self, first=checks.number("first", self.first))
        _set(self, last=checks.number("last", self.last))
        if self.last <= self.first:
            raise ValueError(f"last must be greater than first, {self.first}, got {self.last}")


@dataclass(frozen=True)
class Traffic:
    """The exits of a line, the queue at its entry, and the counts of a stream of parcels.

    Raises:
        ValueError: exits of one side that overlap, or counts that are not whole or not one for
            each exit.
    """

    exits: tuple[ExitMark, ...]
    delivered: tuple[int, ...]  # for each exit, the parcels that rightly left there
    missorted: int = 0  # parcels that left by another exit than asked
    waiting: int = 0  # parcels at the entry

    def __post_init__(self) -> None:
        _set(self, exits=tuple(self.exits))
        for mark in self.exits:
            if not isinstance(mark, ExitMark):
                raise ValueError(f"exits must be ExitMark, got {mark!r}")
        for before, mark in pairwise(sorted(self.exits, key=lambda each: (each.side, each.first))):
            if before.side == mark.side and mark.first < before.last - _ROUNDING:
                raise ValueError(f"exits of one side must not overlap, got {before!r} and {mark!r}")
        counts = (checks.integer("delivered", count, least=0) for count in self.delivered)
        _set(self, delivered=tuple(counts))
        if len(self.delivered) != len(self.exits):
            raise ValueError(
                f"delivered must be one count for each of the {len(self.exits)} exits, "
                f"got {self.delivered!r}"
            )
        _set(self, missorted=checks.integer("missorted", self.missorted, least=0))
        _set(self, waiting=checks.integer("waiting", self.waiting, least=0))


@dataclass(frozen=True, eq=False)
class Scene:
    """One moment of a surface and of the parcels on it.

    With `traffic`, exits and queue are drawn beside the rotor rows, and parcels in the colours of
    their exits; without, the whole surface is drawn, and parcels in grey.

    Raises:
        ValueError: arrays whose shapes do not fit each other or are not finite, a zone or an exit
            outside the surface, a goal of another kind, parcels whose exit is none of the
            scene's, touching pairs that are no parcels, or readings that are not pairs of texts.
    """

    axis: NDArray[np.float64]  # (rows, columns) [rad] rotor axis from x, anti-clockwise
    rotor: NDArray[np.bool_]  # (rows, columns) an orientable rotor, else a support
    parcels: tuple[SceneParcel, ...] = ()  # the last is drawn above the others
    traffic: Traffic | None = None
    touching: tuple[tuple[int, int], ...] = ()  # indices of two parcels that touch now
    goal: Goal | None = None
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    origin: tuple[float, float] = (0.05, 0.05)  # [m] centre of element [0, 0]
    zone: Zone | None = None  # the modules that obey a controller; None: all do
    tilt: float = 0.0  # [rad] downhill towards +x
    title: str = ""
    readings: tuple[tuple[str, str], ...] = ()  # label and text of each number shown

    def __post_init__(self) -> None:
        axis, rotor = checks.array("axis", self.axis, (None, None)), np.array(self.rotor)
        if axis.size == 0:
            raise ValueError(f"axis must have at least one row and one column, got {axis.shape}")
        if rotor.dtype != np.bool_:
            raise ValueError(f"rotor must be an array of booleans, got one of {rotor.dtype}")
        if rotor.shape != axis.shape:
            raise ValueError(f"rotor must have the shape of axis, {axis.shape}, got {rotor.shape}")
        rotor.setflags(write=False)
        _set(self, axis=axis, rotor=rotor, pitch=checks.pitch("pitch", self.pitch))
        _set(self, origin=tuple(checks.array("origin", self.origin, (2,)).tolist()))
        _set(self, tilt=checks.number("tilt", self.tilt))
        if self.zone is not None:
            _set(self, zone=_checked_zone(self.zone, self.rows, self.columns))
        if self.goal is not None and not isinstance(self.goal, Goal):
            raise ValueError(f"goal must be one of the goals or None, got {self.goal!r}")
        _check_readings(self.readings)
        _set(self, parcels=tuple(self.parcels))
        self._check_exits()
        _set(self, touching=tuple(self._checked_pair(pair) for pair in self.touching))

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
        """Distances [m] from column to column, and from row to row."""
        return (self.pitch, self.pitch) if isinstance(self.pitch, float) else self.pitch

    @property
    def obeys(self) -> NDArray[np.bool_]:
        """(rows, columns) the elements in the zone; all without one."""
        row, rows, column, columns = self.zone or (0, self.rows, 0, self.columns)
        obeys = np.zeros(self.axis.shape, dtype=bool)
        obeys[row : row + rows, column : column + columns] = True
        return obeys

    @property
    def exits(self) -> tuple[ExitMark, ...]:
        """The exits; none without traffic."""
        return self.traffic.exits if self.traffic is not None else ()

    def _check_exits(self) -> None:
        begin = self.origin[0] - 0.5 * self.pitches[0]
        end = begin + self.columns * self.pitches[0]
        for mark in self.exits:
            if mark.first < begin - _ROUNDING or mark.last > end + _ROUNDING:
                raise ValueError(
                    f"exits must lie within the surface, x from {begin:g} to {end:g} m, "
                    f"got {mark!r}"
                )
        for parcel in self.parcels:
            if not isinstance(parcel, SceneParcel):
                raise ValueError(f"parcels must be SceneParcel, got {parcel!r}")
            if parcel.exit is not None and parcel.exit >= len(self.exits):
                raise ValueError(
                    f"a parcel's exit must be an index among the {len(self.exits)} exits, "
                    f"got {parcel.exit}"
                )

    def _checked_pair(self, pair: tuple[int, int]) -> tuple[int, int]:
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise ValueError(f"touching must be pairs of indices, got {pair!r}")
        first, second = (checks.integer("touching", each, least=0) for each in pair)
        if first == second:
            raise ValueError(f"touching must be pairs of two parcels, got {pair!r}")
        if max(first, second) >= len(self.parcels):
            raise ValueError(
                f"touching must be indices among the {len(self.parcels)} parcels, got {pair}"
            )
        return (first, second)


def _set(instance: Any, **fields: Any) -> None:
    """Set fields of a frozen dataclass while it is made."""
    for name, value in fields.items():
        object.__setattr__(instance, name, value)


def _checked_pose(name: str, pose: ArrayLike) -> Pose:
    x, y, theta = checks.array(name, pose, (3,)).tolist()
    return (x, y, theta)


def _checked_zone(zone: Zone, rows: int, columns: int) -> Zone:
    if len(zone) != 4:
        raise ValueError(f"zone must be first row, rows, first column and columns, got {zone!r}")
    first_row = checks.integer("zone's first row", zone[0], least=0)
    zone_rows = checks.integer("zone's rows", zone[1], least=1)
    first_column = checks.integer("zone's first column", zone[2], least=0)
    zone_columns = checks.integer("zone's columns", zone[3], least=1)
    if first_row + zone_rows > rows or first_column + zone_columns > columns:
        raise ValueError(
            f"zone must lie within the {rows} rows and {columns} columns, got {zone!r}"
        )
    return (first_row, zone_rows, first_column, zone_columns)


def _check_readings(readings: Any) -> None:
    if not all(
        isinstance(pair, tuple) and len(pair) == 2 and all(isinstance(text, str) for text in pair)
        for pair in readings
    ):
        raise ValueError(f"readings must be pairs of label and text, got {readings!r}")
