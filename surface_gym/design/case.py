"""Cases of a design: a parcel, its entry, its purpose, and the spread of unknown quantities.
A draw is one random choice of the unknown quantities. Sections, tables, figures and equations are
numbered as in "the study", Bianchi et al. (2023).
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from surface_gym import checks, parallel
from surface_gym.design import runs as running
from surface_gym.design.runs import DesignLine, Ends, OnProgress, RunRequests
from surface_gym.layouts import ROLLING
from surface_gym.parcel import Disc, Parcel, Polygon, Rectangle
from surface_gym.physics.types import Array, Booleans
from surface_gym.randomisation import RandomDraw, Randomisation

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure

EIGHTH = math.pi / 4  # [rad] 45 deg


@dataclass(frozen=True, eq=False)
class Layout:
    """Named layout: the axis angles of a zone's modules."""

    name: str
    axis: Array  # (rows, columns) [rad]


class Purpose(ABC):
    """Purpose of a surface, which is what the surface does with a parcel that enters towards +x."""

    name: str
    participle: str = ""  # participle of `name`; "": `name` alone describes the purpose
    unit: str  # of `measure`
    measured: str  # description of `measure`
    scale: float  # factor from SI to `unit`

    @property
    def detail(self) -> str:
        """Last words of the texts `action` and `passive`, e.g. " to 0.5 or less of its speed"."""
        return ""

    @property
    def action(self) -> str:
        """The purpose as a text that follows "to", e.g. "sort it"."""
        return f"{self.name} it{self.detail}" if self.participle else self.name

    @property
    def passive(self) -> str:
        """The purpose as an infinitive in the passive voice, e.g. "be sorted"."""
        return f"be {self.participle}{self.detail}" if self.participle else self.action

    @abstractmethod
    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """Return the study's layouts of the zone's first `columns`. Later columns are at 90 deg."""

    @property
    @abstractmethod
    def leaves_zone(self) -> bool:
        """Whether a run ends once the parcel has passed the columns of the layout."""

    @abstractmethod
    def succeeds(self, ends: Ends) -> Booleans:
        """Return which runs in `ends` are successes, as booleans (runs,)."""

    @abstractmethod
    def measure(self, ends: Ends) -> Array:
        """Return the quantity `measured` of each run (runs,), in SI units. NaN means "unknown"."""

    def shortfall(self, ends: Ends) -> Array:
        """Return the shortfalls (runs,) of the runs in `ends`, from 0 (success) to 1.

        A search for layouts minimises the shortfall. The default shortfall of a failure is 1.
        """
        return np.where(self.succeeds(ends), 0.0, 1.0)

    def search_starts(self, line: DesignLine) -> list[Array]:
        """Return extra layouts (rows, columns) [rad] for the start of a search.

        The search starts from these layouts and from the study's layouts.
        """
        del line
        return []


@dataclass(frozen=True)
class SortPurpose(Purpose):
    """Purpose: lead the parcel off the line to one side (Section 5.1)."""

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
        across = self.side * (ends.pose[:, 1] - ends.line.line_y)
        return (ends.reason == running.OUT) & (across > 0.0)

    def measure(self, ends: Ends) -> Array:
        return np.where(self.succeeds(ends), ends.time, math.nan)

    def shortfall(self, ends: Ends) -> Array:
        """Return the remaining part (runs,) of the way off the line, from 0 (success) to 1.

        The way leads sideways, from the line's middle to one line width beyond the line's edge.
        """
        enough = 1.5 * ends.line.pitch_y * ends.line.rows  # ample for any parcel
        across = self.side * (ends.pose[:, 1] - ends.line.line_y)
        left = 1.0 - np.clip(across / enough, 0.0, 1.0)
        return np.where(self.succeeds(ends), 0.0, left)

    def search_starts(self, line: DesignLine) -> list[Array]:
        """Return layouts in which the axis angle changes step by step from column to column."""
        starts = []
        for turned in np.radians([15.0, 30.0, 45.0, 60.0, 75.0, 90.0]).tolist():
            for over in range(1, line.columns + 1):
                part = np.minimum(1.0, np.arange(1, line.columns + 1) / over)
                column = ROLLING + self.side * turned * part
                starts.append(np.tile(column, (line.rows, 1)))
        return starts


class _Braking(Purpose):
    """Base class of purposes for which the zone brakes the parcel."""

    leaves_zone = True

    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """Return the layouts of Figure 6b (0 deg) and 6c (-45 and 45 deg in alternate rows)."""
        straight = np.full((line.rows, line.columns), ROLLING)
        straight[:, :columns] = 0.0
        signs = np.where(np.arange(line.rows) % 2, 1.0, -1.0)
        turned = np.full((line.rows, line.columns), ROLLING)
        turned[:, :columns] = EIGHTH * signs[:, np.newaxis]
        return Layout("0 deg", straight), Layout("+-45 deg", turned)


@dataclass(frozen=True)
class SlowPurpose(_Braking):
    """Purpose: reduce the parcel's speed to a given ratio of its entry speed (Section 5.2).

    Without a tolerance, every ratio above 0 and up to the given ratio is a success.
    """

    ratio: float = 0.5  # [-] exit speed / entry speed
    # [-] tolerance of the ratio; None: any ratio from above 0 to `ratio`
    tolerance: float | None = None

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

    def measure(self, ends: Ends) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = ends.velocity[:, 0] / ends.runs.speed
        return np.where((ends.reason == running.PAST) & (ends.runs.speed > 0.0), ratio, math.nan)

    def shortfall(self, ends: Ends) -> Array:
        """Return the error (runs,) of the speed ratio. An error above 1 is returned as 1.

        If a parcel does not pass the zone's end, the result is from 0.5 to 1 (see `_way_to_go`).
        """
        error = self.measure(ends) - self.ratio
        error = np.maximum(0.0, error) if self.tolerance is None else np.abs(error)
        return np.where(np.isnan(error), _way_to_go(ends), np.minimum(1.0, error))


@dataclass(frozen=True)
class StopPurpose(_Braking):
    """Purpose: stop the parcel anywhere on the zone, or near a given position (Section 5.3)."""

    place: float | None = None  # [m] from the zone's start to the base's middle at rest
    tolerance: float = 0.05  # [m] allowed distance from the place

    name = "stop"
    participle = "stopped"
    unit = "m"
    measured = "place of rest past the zone's start"
    scale = 1.0

    def __post_init__(self) -> None:
        if self.place is not None:
            checks.coordinate("place", self.place)
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

    def measure(self, ends: Ends) -> Array:
        on_zone = (ends.reason == running.AT_REST) & (ends.touched > 0)
        return np.where(on_zone, ends.pose[:, 0] - ends.line.zone_x[0], math.nan)

    def shortfall(self, ends: Ends) -> Array:
        """Return the shortfall (runs,) of each run, at most 1.

        If a parcel stops on the zone, the shortfall is the distance from the goal position divided
        by the zone's length, at most 0.5. If a parcel passes the zone, the shortfall is 0.5 plus
        half the ratio of exit to entry speed. In all other cases, the shortfall is 1.
        """
        rest = self.measure(ends)
        off = np.zeros(len(rest)) if self.place is None else np.abs(rest - self.place)
        first, last = ends.line.zone_x
        off = np.where(np.isnan(rest), np.nan, off / (last - first))
        faster = ends.velocity[:, 0] / np.maximum(ends.runs.speed, 1e-9)
        passed = np.where(ends.reason == running.PAST, 0.5 + 0.5 * np.clip(faster, 0.0, 1.0), 1.0)
        return np.where(np.isnan(off), passed, np.minimum(0.5, off))


@dataclass(frozen=True)
class TurnPurpose(Purpose):
    """Purpose: turn the parcel by an angle before the parcel leaves the zone."""

    angle: float = math.radians(30.0)  # [rad] anti-clockwise
    tolerance: float = math.radians(5.0)  # [rad]

    name = "turn"
    participle = "turned"
    unit = "deg"
    measured = "angle on leaving the zone"
    scale = 180.0 / math.pi
    leaves_zone = True

    def __post_init__(self) -> None:
        if checks.angle("angle", self.angle) == 0.0:
            raise ValueError(f"angle must not be 0, got {self.angle!r}")
        checks.positive("tolerance", checks.angle("tolerance", self.tolerance))

    @property
    def detail(self) -> str:
        return f" by {math.degrees(self.angle):g} +- {math.degrees(self.tolerance):g} deg"

    def layouts(self, line: DesignLine, columns: int) -> tuple[Layout, ...]:
        """Return two layouts that brake one half of the parcel.

        The braking axes are at 45 deg in the first layout, and at 0 deg in the second layout.
        """
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

    def measure(self, ends: Ends) -> Array:
        return np.where(ends.reason == running.PAST, ends.pose[:, 2], math.nan)

    def shortfall(self, ends: Ends) -> Array:
        """Return the error (runs,) of the angle, divided by 180 deg and limited to 0.5.

        If a parcel does not pass the zone's end, `_way_to_go` gives its shortfall.
        """
        error = np.abs(self.measure(ends) - self.angle) / np.pi
        return np.where(np.isnan(error), _way_to_go(ends), np.minimum(0.5, error))


def _way_to_go(ends: Ends) -> Array:
    """Return the shortfall (runs,) of parcels that did not leave the zone at its end.

    If a parcel rests with the share s of the zone ahead of it, the shortfall is (1 + s) / 2.
    Otherwise the shortfall is 1.
    """
    first, last = ends.line.zone_x
    to_go = (last - ends.pose[:, 0]) / (last - first)
    return np.where(ends.reason == running.AT_REST, 0.5 + 0.5 * np.clip(to_go, 0.0, 1.0), 1.0)


WORST = 0.05  # allowed share of failing draws
SURE = f"{1.0 - WORST:.0%}"  # required share of successful draws
MOST_DRAWS = 1_000_000  # maximum number of draws, with one run each

# Fields of `Unknown` by reported group. Groups are varied one at a time.
GROUPS = {
    "friction": ("friction", "rolling"),
    "load": ("com_offset", "mass"),
    "unevenness": ("stiffness",),
    "entry": ("lateral", "heading", "speed", "tilt"),
}
TOGETHER = "together"  # all groups at once
NOMINAL = "nominal"  # nothing unknown


@dataclass(frozen=True)
class Unknown(Randomisation):
    """Spreads of the quantities that are unknown when a surface is designed.

    Friction, load and unevenness vary by default. Unevenness is modelled by supports of unequal
    stiffness: a spread of 0.35 in stiffness has the same effect as heights that differ by about 1
    micrometre (docs/validation.md).
    """

    friction: float = 0.2  # [-] mu_max times uniform(1 - friction, 1 + friction)
    rolling: float = 0.2  # [-] mu_min and mu_support, each times uniform(1 - rolling, 1 + rolling)
    com_offset: float = 0.1  # [-] centre of mass, within this share of half the base's extent
    stiffness: float = 0.35  # [-] log-normal spread of each element's stiffness
    speed: float = 0.0  # [m/s] normal spread of the entry speed
    tilt: float = 0.0  # [rad] normal spread of the surface's tilt

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size:
            raise ValueError(f"size must be 0, got {self.size!r}: the parcel is given")
        checks.not_negative("speed", self.speed, 20.0)
        checks.angle("tilt", self.tilt, 0.0, math.pi / 4)

    def only(self, group: str) -> "Unknown":
        """Return a copy in which only `group` of `GROUPS` varies; `TOGETHER` means all groups."""
        if group == TOGETHER:
            return self
        names = GROUPS[checks.one_of("group", group, (*GROUPS, TOGETHER))]
        return replace(NOTHING, **{name: getattr(self, name) for name in names})

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of all varying groups, followed by `TOGETHER`, or no names if nothing varies."""
        varying = tuple(group for group in GROUPS if self.only(group) != NOTHING)
        return (*varying, TOGETHER) if varying else ()

    def by_group(self) -> dict[str, "Unknown"]:
        """Return a dict from group names to spreads. The group `NOMINAL` varies no quantity."""
        return {NOMINAL: NOTHING, **{group: self.only(group) for group in self.groups}}


NOTHING = Unknown(friction=0.0, rolling=0.0, com_offset=0.0, stiffness=0.0)


@dataclass(frozen=True)
class Case:
    """A parcel, its entry, its purpose and the unknown quantities of a design."""

    parcel: Parcel
    purpose: Purpose = field(default_factory=SortPurpose)
    speed: float = 1.0  # [m/s] at entry, along the line
    tilt: float = 0.0  # [rad] of the surface, downhill towards +x
    unknown: Unknown = field(default_factory=Unknown)
    draws: int = 100  # number of draws of unknown quantities
    seed: int = 0  # seed of the draws
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    mu_max: float = 0.5  # [-] friction along a rotor's axis
    mu_min: float = 0.01  # [-] friction across it
    mu_support: float = 0.005  # [-] friction of a support
    step: float = running.STEP  # [s] of the simulation

    def __post_init__(self) -> None:
        checks.instance("parcel", self.parcel, Parcel, "a Parcel")
        checks.instance("purpose", self.purpose, Purpose, "a Purpose")
        checks.instance("unknown", self.unknown, Unknown, "an Unknown")
        checks.within("speed", self.speed, 0.0, 20.0)
        if not 0.0 <= checks.number("tilt", self.tilt) < math.pi / 4:
            raise ValueError(
                f"tilt must be from 0 to below pi/4 (45 deg), got {self.tilt!r}; {checks.DEGREES}"
            )
        if self.speed == 0.0 and self.tilt == 0.0:
            raise ValueError("speed must be greater than 0 on a level surface, got 0.0")
        checks.integer("draws", self.draws, least=1, most=MOST_DRAWS)
        checks.integer("seed", self.seed, least=0)
        checks.within("step", self.step, 1e-5, 0.02)

    def line(self, columns: int, rows: int | None = None) -> DesignLine:
        """Return a line whose zone has `columns` columns. `line_for` sets the default of `rows`."""
        return running.line_for(
            self.parcel, columns, rows, self.pitch, self.mu_max, self.mu_min, self.mu_support
        )

    @property
    def parcel_text(self) -> str:
        """Description of the parcel, e.g. "0.3 x 0.4 m parcel"."""
        base = self.parcel.base
        if isinstance(base, Rectangle):
            return f"{base.length:g} x {base.width:g} m parcel"
        if isinstance(base, Disc):
            return f"round parcel of {base.radius:g} m radius"
        if isinstance(base, Polygon):
            return f"parcel of {len(base.vertices)} corners"
        return f"{type(base).__name__} parcel"

    @property
    def entry_text(self) -> str:
        """Description of the entry, e.g. "at 1.2 m/s"."""
        tilt = f" down {math.degrees(self.tilt):g} deg" if self.tilt else ""
        return f"at {self.speed:g} m/s{tilt}"

    def draw(self, line: DesignLine, unknown: Unknown) -> "Draws":
        """Make `draws` random draws of the unknown quantities, or one draw if nothing is unknown.

        Draw k has a generator of its own with the seed (seed, k). So draw k depends on the line's
        rows and columns, but not on the number of draws.
        """
        drawn: list[RandomDraw] = []
        extra: list[list[float]] = []
        for k in range(self.draws if unknown.groups else 1):
            rng = np.random.default_rng((self.seed, k))
            drawn.append(unknown.draw(rng, self.parcel, line.shape))
            extra.append(rng.standard_normal(2).tolist())
        speed, tilt = np.array(extra).T
        stiffness = [each.stiffness for each in drawn if each.stiffness is not None]
        return Draws(
            parcels=tuple(each.parcel for each in drawn),
            stiffness=np.stack(stiffness) if stiffness else None,
            friction=np.array([each.friction for each in drawn]),
            lateral=np.array([each.aside for each in drawn]),
            heading=np.array([each.turned for each in drawn]),
            speed=unknown.speed * speed,
            tilt=unknown.tilt * tilt,
        )

    def run(
        self, line: DesignLine, axes: Array, runs: RunRequests, drawn: "Draws | None" = None,
        workers: parallel.Workers = 1, on_progress: OnProgress = lambda *_: None,
    ) -> Ends:  # fmt: skip
        """Simulate `runs` on a line; `axes` (layouts, rows, columns) [rad] are the zone's layouts.

        A run's `layout` is an index into `axes`. A run's `parcel` and `stiffness` are indices into
        `drawn`. If `drawn` is None, all runs have the case's parcel, and all elements are equally
        stiff. For `workers` and `on_progress` see `run_all`.
        """
        parcels = (self.parcel,) if drawn is None else drawn.parcels
        stiffness = None if drawn is None else drawn.stiffness
        return running.run_all(
            line, axes, parcels, runs, stiffness, self.step, workers, on_progress
        )


@dataclass(frozen=True, eq=False)
class Draws:
    """Random draws of the unknown quantities; all evaluations of a case use the same draws."""

    parcels: tuple[Parcel, ...]  # (draws,)
    stiffness: Array | None  # (draws, rows, columns) [-]; None: all elements alike
    friction: Array  # (draws, 3) [-] factors of mu_max, mu_min and mu_support
    lateral: Array  # (draws,) [m] offset of the start in y
    heading: Array  # (draws,) [rad] of the start
    speed: Array  # (draws,) [m/s] added to the entry speed
    tilt: Array  # (draws,) [rad] added to the tilt

    def __len__(self) -> int:
        return len(self.parcels)

    def runs(
        self, speed: float | Array, tilt: float | Array, columns: int, layout: int = 0,
        friction: ArrayLike = 1.0,
    ) -> RunRequests:  # fmt: skip
        """Build one run per draw, over the layout with index `layout`.

        A run ends when the parcel has passed the first `columns` columns of the zone. If `columns`
        is -1, passing the zone does not end a run. `speed` [m/s] or `tilt` [rad] may have the shape
        (points, 1). The factors `friction` may have the shape (points, 1, 3). With these shapes,
        there is one run for each point and draw.
        """
        every = np.arange(len(self))
        return running.make_runs(
            speed=np.maximum(0.0, speed + self.speed),
            tilt=tilt + self.tilt,
            layout=layout,
            stiffness=every if self.stiffness is not None else 0,
            parcel=every if len(set(self.parcels)) > 1 else 0,
            friction=np.reshape(np.multiply(friction, self.friction), (-1, 3)),
            lateral=self.lateral,
            heading=self.heading,
            columns=columns,
        )


def is_reliable(share: ArrayLike) -> Booleans:
    """Return whether shares of successful draws are at least 0.95, i.e. 1 - `WORST`."""
    return np.asarray(share) >= 1.0 - WORST - 1e-9


Cell = str | float | int | bool | None

BLUE, ORANGE = "#0072B2", "#D55E00"
# Okabe and Ito's colours, safe for colour-blind readers, each with a line style.
LINES: dict[str, tuple[str, Any]] = {
    NOMINAL: ("#999999", "-"),
    "friction": ("#E69F00", "--"),
    "load": ("#56B4E9", "-."),
    "unevenness": ("#009E73", ":"),
    "entry": ("#CC79A7", (0, (3, 1, 1, 1))),
    TOGETHER: ("#000000", "-"),
}


@dataclass(frozen=True)
class ReportTable:
    """A header and rows, written as CSV."""

    name: str  # file name without suffix
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    shown: bool = True  # whether it is shown in a terminal


class Answer(ABC):
    """An answer to a question about a case: a sentence, tables and a figure."""

    @property
    @abstractmethod
    def name(self) -> str:
        """File name of the figure, without suffix."""

    @property
    @abstractmethod
    def sentence(self) -> str:
        """The answer in one sentence."""

    @abstractmethod
    def tables(self) -> tuple[ReportTable, ...]:
        """Return the answer as tables."""

    @abstractmethod
    def draw(self) -> "Figure":
        """Draw the answer with matplotlib."""


def group_label(group: str) -> str:
    """Return the label of a group of unknown quantities."""
    if group == TOGETHER:
        return "all together"
    return group if group in GROUPS else "nothing"


def plural(count: int, noun: str) -> str:
    """Return a count and a noun: "1 column", "2 columns"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def new_figure(width: float, height: float, title: str, fontsize: str = "large") -> "Figure":
    """Make an empty figure with a title; width and height are in inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, fontsize=fontsize)
    return figure


def new_panel(title: str, subtitle: str) -> "tuple[Figure, Axes]":
    """Make a figure with one panel, a title and a subtitle."""
    figure = new_figure(7.2, 4.8, title)
    axes = figure.subplots()
    axes.set_title(subtitle, fontsize="small")
    axes.grid(alpha=0.25)
    return figure, axes


def legend_of_drawn(axes: "Axes") -> dict[str, Any]:
    """Return arguments that let matplotlib's `axes.legend` omit lines without points."""
    drawn = [
        (line, label)
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
        if not hasattr(line, "get_xdata") or len(line.get_xdata())
    ]
    handles, labels = zip(*drawn, strict=True)
    return {"handles": handles, "labels": labels, "fontsize": "small", "framealpha": 0.9}
