"""A scene with parcels, and its layout in a picture."""

from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks

Zone: TypeAlias = tuple[int, int, int, int]  # first row, rows, first column and columns
Pose: TypeAlias = tuple[float, float, float]  # [m, m, rad]


@dataclass(frozen=True)
class ExitSide:
    """The goal to leave the line on one side or at the line's end."""

    side: int  # -1 for y < 0, +1 for y > 0, 0 for straight through

    def __post_init__(self) -> None:
        checks.one_of("side", self.side, (-1, 0, 1))


@dataclass(frozen=True)
class StopLine:
    """Goal: come to rest with the centre on a line across the surface."""

    x: float  # [m]

    def __post_init__(self) -> None:
        checks.settle(self, x=checks.number)


@dataclass(frozen=True)
class ExitSpeed:
    """Goal: the parcel leaves the line's end at a share of its entry speed."""

    ratio: float  # [-] exit speed / entry speed
    speed: float  # [m/s] exit speed

    def __post_init__(self) -> None:
        checks.settle(self, ratio=checks.not_negative, speed=checks.not_negative)


@dataclass(frozen=True, eq=False)
class Path:
    """Goal: the parcel's centre follows a curve."""

    points: Any  # (points, 2) [m] at least two points, converted to an array

    def __post_init__(self) -> None:
        checks.settle(self, points=(checks.array, (None, 2)))
        if len(self.points) < 2:
            raise ValueError(f"points must be at least 2, got {len(self.points)}")


@dataclass(frozen=True)
class Heading:
    """Goal: turn to an angle."""

    angle: float  # [rad] goal theta

    def __post_init__(self) -> None:
        checks.settle(self, angle=checks.number)


Goal: TypeAlias = ExitSide | StopLine | ExitSpeed | Path | Heading


@dataclass(frozen=True, eq=False)
class SceneParcel:
    """A parcel in a picture."""

    outline: NDArray[np.float64]  # (points, 2) [m] outline of the base in its own frame
    pose: Pose  # pose of the base's frame
    exit: int | None = None  # index of the goal exit, if there are exits
    # (points, 2) [m] recent positions of the parcel's centre, oldest first
    trail: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    sensed_pose: Pose | None = None  # according to the sensors
    label: str = ""  # text on the parcel if it fits; empty: the name of its exit, if any
    group: int | None = None  # index of its colour; None: the colour of its exit
    wrong: bool = False  # whether it departed by a wrong exit

    @property
    def colour_index(self) -> int | None:
        """Index of the parcel's colour. A parcel without an index is grey."""
        return self.exit if self.group is None else self.group


@dataclass(frozen=True)
class ExitMark:
    """A chute beside the line, or the exit straight ahead."""

    name: str  # short text on the chute and on parcels with this exit
    side: int  # +1: left, y > 0; -1: right, y < 0; 0: straight ahead
    first: float  # [m] start x
    last: float  # [m] end x
    # [m] smallest and largest y of a mouth straight ahead; None: all rotor rows
    span: tuple[float, float] | None = None


@dataclass(frozen=True)
class InletMark:
    """An inlet at an edge of the rotors. The inlet lies along this edge from `first` to `last`."""

    name: str  # short text on the inlet
    side: int  # 0: start of the line, span in y; +1: left (y > 0), span in x; -1: right, span in x
    first: float  # [m] start x or y
    last: float  # [m] end x or y


@dataclass(frozen=True)
class Traffic:
    """The exits of a line, the queues at its inlets, and a stream's counts of parcels."""

    exits: tuple[ExitMark, ...]
    delivered: tuple[int, ...]  # correctly delivered parcels, by exit
    missorted: int = 0  # parcels that departed by a wrong exit
    waiting: int = 0  # parcels at the entry
    inlets: tuple[InletMark, ...] = ()  # empty: parcels enter over the whole edge
    queues: tuple[int, ...] = ()  # waiting parcels, by inlet
    # whether the conveyor after the exits runs (exits then have no colours); None: no conveyor
    runs: bool | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """Snapshot of a surface and its parcels.

    If `traffic` is given, a picture shows the rotor rows, with exits and queues beside the rows.
    Parcels have the colours of their exits or groups. Without `traffic`, a picture shows the whole
    surface and grey parcels.
    """

    axis: NDArray[np.float64]  # (rows, columns) [rad] rotor axis from x, anti-clockwise
    rotor: NDArray[np.bool_]  # (rows, columns) an orientable rotor, else a support
    parcels: tuple[SceneParcel, ...] = ()  # drawn in this order
    traffic: Traffic | None = None
    touching: tuple[tuple[int, int], ...] = ()  # pairs of indices of touching parcels
    goal: Goal | None = None
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    origin: tuple[float, float] = (0.05, 0.05)  # [m] centre of element [0, 0]
    zone: Zone | None = None  # the modules that obey a controller; None: all do
    tilt: float = 0.0  # [rad] downhill towards `tilt_direction`
    tilt_direction: float = 0.0  # [rad] downhill direction, anti-clockwise from +x
    title: str = ""
    readings: tuple[tuple[str, str], ...] = ()  # label and text of each displayed number
    # (rows, columns, 2) [m/s] velocities of driven surfaces; NaN: idle; None: all are idle
    drive: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        checks.set_fields(self, axis=np.array(self.axis), rotor=np.array(self.rotor))
        if self.goal is not None and not isinstance(self.goal, Goal):
            raise ValueError(f"goal must be one of the goals or None, got {self.goal!r}")
        texts = [text for pair in self.readings for text in (pair if len(pair) == 2 else (None,))]
        if not all(isinstance(text, str) for text in texts):
            raise ValueError(f"readings must be pairs of label and text, got {self.readings!r}")

    @property
    def rows(self) -> int:
        return int(self.axis.shape[0])

    @property
    def columns(self) -> int:
        return int(self.axis.shape[1])

    @property
    def pitches(self) -> tuple[float, float]:
        """Distances [m] from column to column, and from row to row."""
        return (self.pitch, self.pitch) if isinstance(self.pitch, float) else self.pitch

    @property
    def obeys(self) -> NDArray[np.bool_]:
        """Whether elements (rows, columns) are in the zone. Without a zone, all values are True."""
        row, rows, column, columns = self.zone or (0, self.rows, 0, self.columns)
        obeys = np.zeros(self.axis.shape, dtype=bool)
        obeys[row : row + rows, column : column + columns] = True
        return obeys

    @property
    def exits(self) -> tuple[ExitMark, ...]:
        return self.traffic.exits if self.traffic is not None else ()


_BESIDE = 0.5  # [m] margin beside the rotor rows, with traffic
_ENTRY = 4.0  # [cells] room for the queue before the surface
_STRAIGHT = 6.0  # [cells] room for the exit straight ahead
_LABEL = 2.0  # [cells] height of the chutes' labels


@dataclass(frozen=True)
class PixelLayout:
    """Positions of a surface and of the marks beside it in a picture.

    Elements are a whole number of pixels wide and high. For a stream, the picture shows the rotor
    rows with 0.5 m of surface on each side. The labels of exits are above and below the surface.
    """

    rows: int
    columns: int
    pitch: tuple[float, float]  # [m] between elements, in x and in y
    origin: tuple[float, float]  # [m] centre of element [0, 0]
    width: int  # [px] between elements, in x
    height: int  # [px] in y
    left: int  # [px] corner of the whole surface, possibly outside the picture
    top: int  # [px]
    line: tuple[int, int]  # first rotor row, and the number of rows to the last
    band: tuple[int, int]  # first visible row, and the number of visible rows
    box: tuple[int, int, int, int]  # [px] left, top, width and height of the drawing

    @classmethod
    def of(cls, scene: Scene, cell: int, left: int, top: int) -> "PixelLayout":
        """Return a scene's layout, with the upper left corner of the drawing at (left, top) [px].

        `cell` is the width [px] of an element.
        """
        line, band = _shown_rows(scene)
        height = _element_height(scene, cell)
        box = (left, top, *cls.extent(scene, cell))
        if scene.traffic is not None:
            hidden = scene.rows - sum(band)  # rows above the picture
            left += round(_ENTRY * cell)
            top += round(_LABEL * cell) - hidden * height
        rows, columns, pitch, origin = scene.rows, scene.columns, scene.pitches, scene.origin
        return cls(rows, columns, pitch, origin, cell, height, left, top, line, band, box)

    @staticmethod
    def extent(scene: Scene, cell: int) -> tuple[int, int]:
        """Compute the width and height [px] of a scene if elements are `cell` pixels wide."""
        across, down = scene.columns * cell, _shown_rows(scene)[1][1] * _element_height(scene, cell)
        if scene.traffic is None:
            return (across, down)
        across = round(_ENTRY * cell) + across + round(_STRAIGHT * cell)
        return (across, down + 2 * round(_LABEL * cell))

    @staticmethod
    def cells_across(scene: Scene) -> int:
        """Return the width of a scene and of the marks beside it, as a number of elements."""
        return scene.columns if scene.traffic is None else round(_ENTRY + scene.columns + _STRAIGHT)

    @property
    def cell(self) -> int:
        """Side [px] of the largest square within an element."""
        return min(self.width, self.height)

    @property
    def stroke(self) -> float:
        """Width [px] of drawn lines."""
        return 1.0 + min(self.cell, 60) / 30.0

    @property
    def label_size(self) -> int:
        """Font size [px] of labels on exits and parcels."""
        return max(12, round(1.35 * self.cell))

    @property
    def area(self) -> pygame.Rect:
        return pygame.Rect(self.box)

    @property
    def surface(self) -> pygame.Rect:
        return self.cells(0, self.rows, 0, self.columns)

    @property
    def plate(self) -> pygame.Rect:
        return self.cells(*self.band, 0, self.columns)

    @property
    def rotors(self) -> pygame.Rect:
        return self.cells(*self.line, 0, self.columns)

    @property
    def passable(self) -> pygame.Rect:
        """The area in which parcels of a stream are drawn: from the entry to the line's end."""
        plate, left = self.plate, self.box[0]
        return pygame.Rect(left, plate.top, plate.right - left, plate.height)

    def cells(self, first_row: int, rows: int, first_column: int, columns: int) -> pygame.Rect:
        """Compute the area [px] of a block of rows and columns of elements."""
        return pygame.Rect(
            self.left + first_column * self.width,
            self.top + (self.rows - first_row - rows) * self.height,
            columns * self.width,
            rows * self.height,
        )

    def mouth(self, mark: ExitMark) -> pygame.Rect:
        """Compute the area of an exit in the picture.

        The area lies beside the rotor rows. If the exit is straight ahead, the area lies at the
        end of the rotor rows.
        """
        left, right = self.columns_between(mark.first, mark.last)
        plate, rotors = self.plate, self.rotors
        top, bottom = rotors.top, rotors.bottom
        if mark.span is not None:
            top, bottom = self.rows_between(*mark.span)
        if mark.side > 0:
            top, bottom = plate.top, rotors.top
        elif mark.side < 0:
            top, bottom = rotors.bottom, plate.bottom
        return pygame.Rect(left, top, right - left, bottom - top)

    def inlet(self, mark: InletMark) -> pygame.Rect:
        """Compute the area of an inlet, which lies before or beside the surface."""
        area, plate = self.area, self.plate
        if mark.side == 0:
            top, bottom = self.rows_between(mark.first, mark.last)
            return pygame.Rect(area.left, top, plate.left - area.left, bottom - top)
        left, right = self.columns_between(mark.first, mark.last)
        if mark.side > 0:
            return pygame.Rect(left, area.top, right - left, plate.top - area.top)
        return pygame.Rect(left, plate.bottom, right - left, area.bottom - plate.bottom)

    def columns_between(self, first: float, last: float) -> tuple[int, int]:
        """Compute the left and right pixel of the strip from x = `first` to x = `last` [m]."""
        left, right = self.pixels(np.array([[first, 0.0], [last, 0.0]]))[:, 0]
        return round(float(left)), round(float(right))

    def rows_between(self, low: float, high: float) -> tuple[int, int]:
        """Compute the top and bottom pixel of the strip from y = `low` to y = `high` [m]."""
        top, bottom = self.pixels(np.array([[0.0, high], [0.0, low]]))[:, 1]
        return round(float(top)), round(float(bottom))

    def label(self, mark: ExitMark) -> pygame.Rect:
        """Compute the area for an exit's name and the exit's count of parcels."""
        mouth, plate, area = self.mouth(mark), self.plate, self.area
        if mark.side == 0:
            return pygame.Rect(plate.right, mouth.top, area.right - plate.right, mouth.height)
        if mark.side > 0:
            return pygame.Rect(mouth.left, area.top, mouth.width, plate.top - area.top)
        return pygame.Rect(mouth.left, plate.bottom, mouth.width, area.bottom - plate.bottom)

    def length(self, metres: float) -> float:
        """Convert a length along x from metres to pixels."""
        return metres / self.pitch[0] * self.width

    def pixels(self, points: ArrayLike) -> NDArray[np.float64]:
        """Convert points (..., 2) [m] to pixels (..., 2)."""
        steps = (np.asarray(points, dtype=np.float64) - self.origin) / self.pitch + 0.5
        x = self.left + self.width * steps[..., 0]
        y = self.top + self.height * (self.rows - steps[..., 1])
        return np.stack([x, y], axis=-1)


def _element_height(scene: Scene, width: int) -> int:
    """Compute the height [px] of an element that is `width` pixels wide."""
    pitch_x, pitch_y = scene.pitches
    return max(1, round(width * pitch_y / pitch_x))


def _shown_rows(scene: Scene) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the rotor rows, then the visible rows, as pairs (first row, number of rows)."""
    everything = (0, scene.rows)
    rotors = np.flatnonzero(scene.rotor.any(axis=1))
    if len(rotors) == 0:
        return everything, everything
    first, last = int(rotors[0]), int(rotors[-1])
    line = (first, last - first + 1)
    if scene.traffic is None:
        return line, everything
    beside = round(_BESIDE / scene.pitches[1])
    low, high = max(0, first - beside), min(scene.rows - 1, last + beside)
    return line, (low, high - low + 1)
