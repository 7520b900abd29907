"""What a picture of a stream of parcels shows: nothing here knows of environments."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.rendering.elements import (
    OnElements,
    Zone,
    check_readings,
    checked_axis,
    checked_outline,
    checked_pose,
    checked_rotor,
    checked_zone,
)

_ROUNDING = 1e-9  # [m] by which a span may pass the surface's end or its neighbour's


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
        set_field = object.__setattr__
        if not isinstance(self.name, str):
            raise ValueError(f"name must be a text, got {self.name!r}")
        set_field(self, "side", checks.one_of("side", self.side, (-1, 0, 1)))
        set_field(self, "first", checks.number("first", self.first))
        set_field(self, "last", checks.number("last", self.last))
        if self.last <= self.first:
            raise ValueError(f"last must be greater than first, {self.first}, got {self.last}")


@dataclass(frozen=True, eq=False)
class FlowParcel:
    """A parcel of the stream.

    Raises:
        ValueError: arrays of another shape or not finite, an outline that encloses no area, an
            exit that is no place, or a label that is no text.
    """

    outline: NDArray[np.float64]  # (points, 2) [m] of the base, in its own frame
    pose: tuple[float, float, float]  # [m, m, rad] of that frame
    exit: int  # where it is to leave: a place among the scene's exits
    # (points, 2) [m] where the parcel's centre has been lately, oldest first
    trail: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    sensed_pose: tuple[float, float, float] | None = None  # [m, m, rad] what the sensors say
    label: str = ""  # written on it where it has room; empty: its exit's name

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "outline", checked_outline(self.outline))
        set_field(self, "pose", checked_pose("pose", self.pose))
        set_field(self, "exit", checks.integer("exit", self.exit, least=0))
        set_field(self, "trail", checks.array("trail", self.trail, (None, 2)))
        if self.sensed_pose is not None:
            set_field(self, "sensed_pose", checked_pose("sensed_pose", self.sensed_pose))
        if not isinstance(self.label, str):
            raise ValueError(f"label must be a text, got {self.label!r}")


@dataclass(frozen=True, eq=False)
class FlowScene(OnElements):
    """One moment of a stream of parcels on a line.

    Raises:
        ValueError: arrays whose shapes do not fit each other or are not finite, a zone or an exit
            outside the surface, exits of one side that overlap, counts that are not whole or not
            one for each exit, parcels that leave or touch at no place, or readings that are not
            pairs of texts.
    """

    axis: NDArray[np.float64]  # (rows, columns) [rad] rotor axis from x, anti-clockwise
    rotor: NDArray[np.bool_]  # (rows, columns) an orientable rotor, else a support
    exits: tuple[ExitMark, ...]
    delivered: tuple[int, ...]  # for each exit, the parcels that rightly left there
    parcels: tuple[FlowParcel, ...] = ()  # the last is drawn above the others
    missorted: int = 0  # parcels that left elsewhere than asked
    waiting: int = 0  # parcels at the entry
    touching: tuple[tuple[int, int], ...] = ()  # places of two parcels that touch now
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    origin: tuple[float, float] = (0.05, 0.05)  # [m] centre of element [0, 0]
    # First row, rows, first column and columns of the modules that obey a controller; None: all do.
    zone: Zone | None = None
    tilt: float = 0.0  # [rad] downhill towards +x
    title: str = ""
    # Label and text of each number shown; those right and wrong are shown without being told.
    readings: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "axis", checked_axis(self.axis))
        set_field(self, "rotor", checked_rotor(self.rotor, self.axis.shape))
        set_field(self, "pitch", checks.pitch("pitch", self.pitch))
        set_field(self, "origin", tuple(checks.array("origin", self.origin, (2,)).tolist()))
        set_field(self, "tilt", checks.number("tilt", self.tilt))
        if self.zone is not None:
            set_field(self, "zone", checked_zone(self.zone, self.rows, self.columns))
        check_readings(self.readings)
        set_field(self, "exits", tuple(self.exits))
        self._check_exits()
        set_field(self, "delivered", _counts("delivered", self.delivered))
        if len(self.delivered) != len(self.exits):
            raise ValueError(
                f"delivered must be one count for each of the {len(self.exits)} exits, "
                f"got {self.delivered!r}"
            )
        set_field(self, "missorted", checks.integer("missorted", self.missorted, least=0))
        set_field(self, "waiting", checks.integer("waiting", self.waiting, least=0))
        set_field(self, "parcels", tuple(self.parcels))
        self._check_parcels()
        set_field(self, "touching", tuple(_pair(pair) for pair in self.touching))
        for pair in self.touching:
            if max(pair) >= len(self.parcels):
                raise ValueError(
                    f"touching must be places among the {len(self.parcels)} parcels, got {pair}"
                )

    def _check_exits(self) -> None:
        begin = self.origin[0] - 0.5 * self.pitches[0]
        end = begin + self.columns * self.pitches[0]
        for mark in self.exits:
            if not isinstance(mark, ExitMark):
                raise ValueError(f"exits must be ExitMark, got {mark!r}")
            if mark.first < begin - _ROUNDING or mark.last > end + _ROUNDING:
                raise ValueError(
                    f"exits must lie within the surface, x from {begin:g} to {end:g} m, "
                    f"got {mark!r}"
                )
        along = sorted(self.exits, key=lambda mark: (mark.side, mark.first))
        for before, mark in pairwise(along):
            if before.side == mark.side and mark.first < before.last - _ROUNDING:
                raise ValueError(f"exits of one side must not overlap, got {before!r} and {mark!r}")

    def _check_parcels(self) -> None:
        for parcel in self.parcels:
            if not isinstance(parcel, FlowParcel):
                raise ValueError(f"parcels must be FlowParcel, got {parcel!r}")
            if parcel.exit >= len(self.exits):
                raise ValueError(
                    f"a parcel's exit must be a place among the {len(self.exits)} exits, "
                    f"got {parcel.exit}"
                )


def _counts(name: str, values: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(checks.integer(name, value, least=0) for value in values)


def _pair(pair: tuple[int, int]) -> tuple[int, int]:
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise ValueError(f"touching must be pairs of places, got {pair!r}")
    first, second = _counts("touching", pair)
    if first == second:
        raise ValueError(f"touching must be pairs of two parcels, got {pair!r}")
    return (first, second)
