"""Purposes of a surface: the layouts to try, and the success of a run."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.line import DesignLine
from surface_gym.design.runs import AT_REST, OUT, PAST, Ends
from surface_gym.layouts import ROLLING

Booleans = NDArray[np.bool_]
Numbers = NDArray[np.float64]

EIGHTH = math.pi / 4  # [rad] 45 deg


@dataclass(frozen=True, eq=False)
class Layout:
    """Axes of a zone, and their name."""

    name: str
    axis: Numbers  # (rows, columns) [rad]


class EnvGoal(NamedTuple):
    """A purpose as a goal of an environment's task."""

    task: str  # key of `surface_gym.tasks.TASKS`
    option: str  # of `reset`, which sets the goal
    value: float
    description: str  # of an episode's success


class Purpose(ABC):
    """Task of a surface, for parcels that enter along the line towards +x."""

    name: str
    participle: str = ""  # of `name`; "": `name` alone describes the purpose
    unit: str  # of `measure`
    measured: str  # description of `measure`
    scale: float  # from SI to `unit`

    @property
    def detail(self) -> str:
        """Continuation of "sort it" or "be sorted"."""
        return ""

    @property
    def action(self) -> str:
        """The purpose as it follows "to": "sort it"."""
        return f"{self.name} it{self.detail}" if self.participle else self.name

    @property
    def passive(self) -> str:
        """The purpose as it follows "for it to": "be sorted"."""
        return f"be {self.participle}{self.detail}" if self.participle else self.action

    @abstractmethod
    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """Return the study's kinds of layout that use the first `columns` of the line's zone."""

    @property
    @abstractmethod
    def leaves_zone(self) -> bool:
        """Whether a run ends where the parcel has passed the columns that are used."""

    @abstractmethod
    def succeeds(self, ends: Ends) -> Booleans:
        """Return the success (runs,) of each run."""

    @abstractmethod
    def measure(self, ends: Ends) -> Numbers:
        """Return the measured result (runs,) in SI units; nan where a run has none."""

    def shortfall(self, ends: Ends) -> Numbers:
        """Return the distance (runs,) [-] from success, 0 to 1: the slope that a search descends.

        By default success alone counts.
        """
        return np.where(self.succeeds(ends), 0.0, 1.0)

    def search_starts(self, line: DesignLine) -> list[Numbers]:
        """Return further axes (rows, columns) [rad] with which a search for a layout begins."""
        del line
        return []

    def env_goal(self, line: DesignLine) -> EnvGoal:
        """Return the goal that an environment on the line has for this purpose.

        Raises:
            ValueError: no environment has such a task.
        """
        del line
        raise ValueError(f"purpose must be one that an environment's task has, got {self.name!r}")


@dataclass(frozen=True)
class Sort(Purpose):
    """Lead the parcel off the line to one side, Section 5.1."""

    side: int = -1  # -1: to y < 0; +1: to y > 0

    name = "sort"
    participle = "sorted"
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

    def succeeds(self, ends: Ends) -> Booleans:
        return (ends.reason == OUT) & (self.side * (ends.pose[:, 1] - ends.line.line_y) > 0.0)

    def measure(self, ends: Ends) -> Numbers:
        return np.where(self.succeeds(ends), ends.time, math.nan)

    def shortfall(self, ends: Ends) -> Numbers:
        """Return the rest of the way across, to a line's width past the last rotor."""
        enough = 1.5 * ends.line.pitch_y * ends.line.rows  # ample for any parcel
        across = self.side * (ends.pose[:, 1] - ends.line.line_y)
        left = 1.0 - np.clip(across / enough, 0.0, 1.0)
        return np.where(self.succeeds(ends), 0.0, left)

    def search_starts(self, line: DesignLine) -> list[Numbers]:
        """Return axes that turn from column to column, which lead a parcel aside bit by bit."""
        starts = []
        for turned in np.radians([15.0, 30.0, 45.0, 60.0, 75.0, 90.0]).tolist():
            for over in range(1, line.columns + 1):
                part = np.minimum(1.0, np.arange(1, line.columns + 1) / over)
                column = ROLLING + self.side * turned * part
                starts.append(np.tile(column, (line.rows, 1)))
        return starts

    def env_goal(self, line: DesignLine) -> EnvGoal:
        del line
        sign = ">" if self.side > 0 else "<"
        return EnvGoal("sort", "side", self.side, f"off the line to y {sign} 0")


class _Braking(Purpose):
    """Purpose that takes speed off the parcel, on the zone."""

    leaves_zone = True

    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """Return Figure 6b and 6c: columns at 0 deg, or at 45 and -45 deg from row to row."""
        straight = np.full((line.rows, line.columns), ROLLING)
        straight[:, :columns] = 0.0
        signs = np.where(np.arange(line.rows) % 2, 1.0, -1.0)
        turned = np.full((line.rows, line.columns), ROLLING)
        turned[:, :columns] = EIGHTH * signs[:, np.newaxis]
        return Layout("0 deg", straight), Layout("+-45 deg", turned)


@dataclass(frozen=True)
class Slow(_Braking):
    """Let the parcel leave the zone at a share of its entry speed or less, Section 5.2.

    With a tolerance, at that share.
    """

    ratio: float = 0.5  # [-] of exit and entry speed
    tolerance: float | None = None  # [-] of the ratio; None: any ratio above 0 that is no greater

    name = "slow"
    participle = "slowed"
    unit = "-"
    measured = "exit speed over entry speed"
    scale = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < checks.number("ratio", self.ratio) < 1.0:
            raise ValueError(f"ratio must be between 0 and 1, got {self.ratio!r}")
        if self.tolerance is not None:
            checks.positive("tolerance", self.tolerance, most=checks.LENGTH[1])

    @property
    def detail(self) -> str:
        near = "or less" if self.tolerance is None else f"+- {self.tolerance:g}"
        return f" to {self.ratio:g} {near} of its speed"

    def succeeds(self, ends: Ends) -> Booleans:
        left = self.measure(ends)
        if self.tolerance is not None:
            return np.abs(left - self.ratio) <= self.tolerance
        return (left > 0.0) & (left <= self.ratio)

    def measure(self, ends: Ends) -> Numbers:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = ends.velocity[:, 0] / ends.runs.speed
        return np.where((ends.reason == PAST) & (ends.runs.speed > 0.0), ratio, math.nan)

    def shortfall(self, ends: Ends) -> Numbers:
        """Return the error of the ratio; at rest on the zone, half plus half the way to go."""
        error = self.measure(ends) - self.ratio
        error = np.maximum(0.0, error) if self.tolerance is None else np.abs(error)
        return np.where(np.isnan(error), _way_to_go(ends), np.minimum(1.0, error))

    def env_goal(self, line: DesignLine) -> EnvGoal:
        del line
        success = f"exit speed {self.ratio:g} of the entry speed, within 0.01"
        return EnvGoal("slow", "ratio", self.ratio, success)


@dataclass(frozen=True)
class Stop(_Braking):
    """Bring the parcel to rest on the zone, Section 5.3; near a place on it, if one is given."""

    place: float | None = None  # [m] from the zone's start to the base's middle at rest
    tolerance: float = 0.05  # [m] off the place

    name = "stop"
    participle = "stopped"
    unit = "m"
    measured = "place of rest past the zone's start"
    scale = 1.0

    def __post_init__(self) -> None:
        if self.place is not None:
            checks.within("place", self.place, -checks.FARTHEST, checks.FARTHEST)
        checks.positive("tolerance", self.tolerance, most=checks.LENGTH[1])

    @property
    def detail(self) -> str:
        if self.place is None:
            return ""
        return f" within {self.tolerance:g} m of {self.place:g} m into the zone"

    def succeeds(self, ends: Ends) -> Booleans:
        rest = self.measure(ends)
        if self.place is None:
            return ~np.isnan(rest)
        return np.abs(rest - self.place) <= self.tolerance

    def measure(self, ends: Ends) -> Numbers:
        on_zone = (ends.reason == AT_REST) & (ends.touched > 0)
        return np.where(on_zone, ends.pose[:, 0] - ends.line.zone_x[0], math.nan)

    def shortfall(self, ends: Ends) -> Numbers:
        """Return the error of the place over the zone's length.

        Past the zone, half plus half the share of the speed that is left.
        """
        rest = self.measure(ends)
        off = np.zeros(len(rest)) if self.place is None else np.abs(rest - self.place)
        first, last = ends.line.zone_x
        off = np.where(np.isnan(rest), np.nan, off / (last - first))
        faster = ends.velocity[:, 0] / np.maximum(ends.runs.speed, 1e-9)
        passed = np.where(ends.reason == PAST, 0.5 + 0.5 * np.clip(faster, 0.0, 1.0), 1.0)
        return np.where(np.isnan(off), passed, np.minimum(0.5, off))

    def env_goal(self, line: DesignLine) -> EnvGoal:
        first, last = line.zone_x
        place = 0.5 * (last - first) if self.place is None else self.place
        success = f"at rest {place:g} m past the zone's start, within 5 mm"
        return EnvGoal("stop", "position", first + place, success)


@dataclass(frozen=True)
class Turn(Purpose):
    """Let the parcel leave the zone turned by an angle."""

    angle: float = math.radians(30.0)  # [rad] anti-clockwise
    tolerance: float = math.radians(5.0)  # [rad]

    name = "turn"
    participle = "turned"
    unit = "deg"
    measured = "angle on leaving the zone"
    scale = 180.0 / math.pi
    leaves_zone = True

    def __post_init__(self) -> None:
        if checks.within("angle", self.angle, -checks.TURNED, checks.TURNED) == 0.0:
            raise ValueError(f"angle must not be 0, got {self.angle!r}")
        checks.positive("tolerance", self.tolerance, most=checks.LENGTH[1])

    @property
    def detail(self) -> str:
        return f" by {math.degrees(self.angle):g} +- {math.degrees(self.tolerance):g} deg"

    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """Return layouts of which one half of the rows turns; see also `best_layout`."""
        found = []
        left = np.arange(line.rows) >= (line.rows + 1) // 2
        turning = left if self.angle > 0.0 else left[::-1]
        for degrees in (45, 0):
            axis = np.full((line.rows, line.columns), ROLLING)
            axis[turning, :columns] = math.copysign(math.radians(degrees), self.angle)
            found.append(Layout(f"{degrees} deg on one half", axis))
        return tuple(found)

    def succeeds(self, ends: Ends) -> Booleans:
        return np.abs(self.measure(ends) - self.angle) <= self.tolerance

    def measure(self, ends: Ends) -> Numbers:
        return np.where(ends.reason == PAST, ends.pose[:, 2], math.nan)

    def shortfall(self, ends: Ends) -> Numbers:
        """Return the error of the angle over 180 deg; at rest, half plus half the way to go."""
        error = np.abs(self.measure(ends) - self.angle) / np.pi
        return np.where(np.isnan(error), _way_to_go(ends), np.minimum(0.5, error))

    def env_goal(self, line: DesignLine) -> EnvGoal:
        del line
        success = f"turned by {math.degrees(self.angle):g} deg on leaving the zone, within 2 deg"
        return EnvGoal("orient", "angle", self.angle, success)


def _way_to_go(ends: Ends) -> Numbers:
    """Return half plus half the share of the zone left to a parcel at rest; 1 for all others."""
    first, last = ends.line.zone_x
    to_go = (last - ends.pose[:, 0]) / (last - first)
    return np.where(ends.reason == AT_REST, 0.5 + 0.5 * np.clip(to_go, 0.0, 1.0), 1.0)
