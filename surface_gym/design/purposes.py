"""What a surface is to do with a parcel: which layouts are tried, and when a run has done it."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.line import DesignLine
from surface_gym.design.passage import AT_REST, OUT, PAST
from surface_gym.design.runs import Ends, Runs
from surface_gym.layouts import ROLLING

Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]
Numbers = NDArray[np.float64]

EIGHTH = math.pi / 4  # [rad] 45 deg


@dataclass(frozen=True, eq=False)
class Layout:
    """Axes of a zone, and what to call them."""

    name: str
    axis: Numbers  # (rows, columns) [rad]


class Purpose(ABC):
    """What is asked. Parcels enter along the line, towards +x."""

    name: str
    unit: str  # of `measure`
    measured: str  # what `measure` is
    scale: float  # from SI to `unit`

    @abstractmethod
    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """The study's kinds of layout that use the first `columns` of the line's zone."""

    @property
    @abstractmethod
    def leaves_zone(self) -> bool:
        """Whether a run ends where the parcel has passed the columns that are used."""

    @abstractmethod
    def succeeds(self, line: DesignLine, runs: Runs, ends: Ends) -> Booleans:
        """(runs,) whether each did what is asked."""

    @abstractmethod
    def measure(self, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
        """(runs,) what comes out, in SI units; nan where a run did not come so far."""


class _Braking(Purpose):
    """What is done by taking speed, on the zone."""

    leaves_zone = True

    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """Figure 6b and 6c: the columns at 0 deg, or at 45 and -45 deg from row to row."""
        straight = np.full((line.rows, line.columns), ROLLING)
        straight[:, :columns] = 0.0
        signs = np.where(np.arange(line.rows) % 2, 1.0, -1.0)
        turned = np.full((line.rows, line.columns), ROLLING)
        turned[:, :columns] = EIGHTH * signs[:, np.newaxis]
        return Layout("0 deg", straight), Layout("+-45 deg", turned)


@dataclass(frozen=True)
class Sort(Purpose):
    """Lead the parcel off the line to one side, Section 5.1."""

    side: int = -1  # -1: to y < 0; +1: to y > 0

    name = "sort"
    unit = "s"
    measured = "time until it is off the line"
    scale = 1.0
    leaves_zone = False

    def __post_init__(self) -> None:
        checks.one_of("side", self.side, (-1, 1))

    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        axis = np.full((line.rows, line.columns), ROLLING)
        axis[:, :columns] = -self.side * EIGHTH
        return (Layout(f"{-45 * self.side:+d} deg", axis),)

    def succeeds(self, line: DesignLine, runs: Runs, ends: Ends) -> Booleans:
        del runs
        return (ends.how == OUT) & (self.side * (ends.pose[:, 1] - line.line_y) > 0.0)

    def measure(self, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
        return np.where(self.succeeds(line, runs, ends), ends.time, math.nan)


@dataclass(frozen=True)
class Slow(_Braking):
    """Let the parcel leave the zone at a share of its entry speed or less, Section 5.2.

    Or at just that share, where a tolerance is given.
    """

    ratio: float = 0.5  # [-] of exit and entry speed
    tolerance: float | None = None  # [-] of the ratio; None: any ratio above 0 that is no greater

    name = "slow"
    unit = "-"
    measured = "exit speed over entry speed"
    scale = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < checks.number("ratio", self.ratio) < 1.0:
            raise ValueError(f"ratio must be between 0 and 1, got {self.ratio!r}")
        if self.tolerance is not None:
            checks.positive("tolerance", self.tolerance, most=checks.LENGTH[1])

    def succeeds(self, line: DesignLine, runs: Runs, ends: Ends) -> Booleans:
        left = self.measure(line, runs, ends)
        if self.tolerance is not None:
            return np.abs(left - self.ratio) <= self.tolerance
        return (left > 0.0) & (left <= self.ratio)

    def measure(self, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
        del line
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = ends.velocity[:, 0] / runs.speed
        return np.where((ends.how == PAST) & (runs.speed > 0.0), ratio, math.nan)


@dataclass(frozen=True)
class Stop(_Braking):
    """Bring the parcel to rest on the zone, Section 5.3; or near a place on it, if one is given."""

    place: float | None = None  # [m] from the zone's start to the base's middle at rest
    tolerance: float = 0.05  # [m] off the place

    name = "stop"
    unit = "m"
    measured = "place of rest past the zone's start"
    scale = 1.0

    def __post_init__(self) -> None:
        if self.place is not None:
            checks.within("place", self.place, -checks.FARTHEST, checks.FARTHEST)
        checks.positive("tolerance", self.tolerance, most=checks.LENGTH[1])

    def succeeds(self, line: DesignLine, runs: Runs, ends: Ends) -> Booleans:
        rest = self.measure(line, runs, ends)
        if self.place is None:
            return ~np.isnan(rest)
        return np.abs(rest - self.place) <= self.tolerance

    def measure(self, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
        del runs
        on_zone = (ends.how == AT_REST) & (ends.touched > 0)
        return np.where(on_zone, ends.pose[:, 0] - line.zone_x[0], math.nan)


@dataclass(frozen=True)
class Turn(Purpose):
    """Let the parcel leave the zone turned by an angle."""

    angle: float = math.radians(30.0)  # [rad] anti-clockwise
    tolerance: float = math.radians(5.0)  # [rad]

    name = "turn"
    unit = "deg"
    measured = "angle on leaving the zone"
    scale = 180.0 / math.pi
    leaves_zone = True

    def __post_init__(self) -> None:
        if checks.within("angle", self.angle, -checks.TURNED, checks.TURNED) == 0.0:
            raise ValueError(f"angle must not be 0, got {self.angle!r}")
        checks.positive("tolerance", self.tolerance, most=checks.LENGTH[1])

    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """One half of the rows turned, the other rolling; see also `best_layout.best_layout`."""
        found = []
        left = np.arange(line.rows) >= (line.rows + 1) // 2
        turning = left if self.angle > 0.0 else left[::-1]
        for degrees in (45, 0):
            axis = np.full((line.rows, line.columns), ROLLING)
            axis[turning, :columns] = math.copysign(math.radians(degrees), self.angle)
            found.append(Layout(f"{degrees} deg on one half", axis))
        return tuple(found)

    def succeeds(self, line: DesignLine, runs: Runs, ends: Ends) -> Booleans:
        return np.abs(self.measure(line, runs, ends) - self.angle) <= self.tolerance

    def measure(self, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
        del line, runs
        return np.where(ends.how == PAST, ends.pose[:, 2], math.nan)
