"""The paper's numbers, the runs that reproduce them, and tests of two of its claims."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import layouts
from surface_gym.compiler.jit import compiled
from surface_gym.physics.references import find_contacts
from surface_gym.physics.types import ARM_X, KIND, SUPPORT, Array, Body, Grid, Scratch, make_scratch
from surface_gym.simulation import expect_tipping, simulate
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory

SIZES = ("S", "B")


class SlowingLayout(NamedTuple):
    """Layout of a slowing area: an entry of Table 4."""

    columns: int  # columns of the slowing area
    angle: int  # [deg] 0, or 45 for +-45 deg in alternate rows

    def __str__(self) -> str:
        return f"{self.columns} at {'±' if self.angle else ''}{self.angle}°"


@dataclass(frozen=True)
class SortingRun:
    """A row of Table 2."""

    speed: float  # [m/s] at the start
    tilt: float  # [deg]
    time: float  # [s] simulated
    x: float  # [m] displacement from the start
    y: float  # [m]
    theta: float  # [deg]
    figure: str  # figure of the paper

    @property
    def side(self) -> int:
        """Side of sorting: 1 is y > 0 (axes at -45 deg), and -1 is y < 0 (axes at +45 deg)."""
        return 1 if self.y > 0.0 else -1


@dataclass(frozen=True)
class Passing:
    """State of the S-box at one moment of its run at a tilt of 10 deg (Section 5.1).

    At this moment, y is equal to the final y of the run at a tilt of 5 deg.
    """

    tilt: float  # [deg]
    y: float  # [m] displacement of the state
    x: float  # [m] displacement
    theta: float  # [deg]
    time: float  # [s]


@dataclass(frozen=True)
class Targets:
    """The paper's numbers of Section 5. The keys of each dict are the boxes, "S" and "B".

    Lists of Tables 3 and 4 have one entry per speed.
    """

    sorting_runs: list[SortingRun]  # Table 2
    passing: Passing
    sorting_speeds: list[float]  # [m/s] of Table 3
    sorting_columns: dict[str, list[int | None]]  # Table 3; None: the box is not sorted
    slowest_sorted: dict[str, float]  # [m/s] smallest speed at which the box is sorted
    slowing_speeds: list[float]  # [m/s] of Table 4
    slowing_layouts: dict[str, list[SlowingLayout]]  # Table 4
    ratio_speed: float  # [m/s] entry speed of the slowing ratios in Section 5.2
    ratio_columns: int
    slowing_ratios: dict[str, list[float]]  # [-] for each of ANGLES
    medium_rates: tuple[float, float]  # [pcs/h] band of torsional discs in Figure 8


@cache
def load_data() -> dict[str, Any]:
    """Read the file of the paper's numbers. The key "validation" holds the numbers of Section 6."""
    text = resources.files("surface_gym.paper").joinpath("data/targets.json").read_text("utf-8")
    return json.loads(text)


@cache
def load_targets() -> Targets:
    """Read the paper's tables of Section 5."""
    data = dict(load_data()["targets"])
    data["sorting_runs"] = [SortingRun(*row) for row in data["sorting_runs"]]
    data["passing"] = Passing(**data["passing"])
    data["slowing_layouts"] = {
        size: [SlowingLayout(*entry) for entry in entries]
        for size, entries in data["slowing_layouts"].items()
    }
    return Targets(**data)


Value = int | float | SlowingLayout | None


@dataclass(frozen=True)
class ComputedValue:
    """A value that we computed, and the share of steps in which Eq. (1) has no solution."""

    value: Value
    tipping: float | None  # [-] share of the steps up to the value; None: no step


@dataclass(frozen=True)
class TableCell:
    """A value of the paper, and our values for comparison. The field `column` names the unit.

    A number of ours is rounded to the paper's decimals. Our number and the paper's number agree if
    they differ by at most `tolerance`. Values that are not numbers agree if they are equal.
    """

    row: str
    column: str
    size: str  # of the box, "S" or "B"
    paper: Value
    ours: tuple[ComputedValue, ...]  # one per integration, in the order of `INTEGRATIONS`
    decimals: int = 0  # decimals printed in the paper
    tolerance: float = 0.0

    def agrees(self, integration: int) -> bool:
        """Return whether our value by `INTEGRATIONS[integration]` agrees with the paper's value."""
        ours = self.ours[integration].value
        if isinstance(ours, (int, float)) and isinstance(self.paper, (int, float)):
            difference = round(ours, self.decimals) - self.paper
            return abs(round(difference, self.decimals)) <= self.tolerance
        return ours == self.paper


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper, or the numbers in a sentence of the paper."""

    key: str  # its name in the JSON report
    title: str
    rule: str  # definition of the values, and of agreement
    cells: list[TableCell]

    def agreeing(self, integration: int) -> int:
        """Return how many cells agree with the paper by the method `INTEGRATIONS[integration]`."""
        return sum(cell.agrees(integration) for cell in self.cells)

    def tipping(self, integration: int) -> dict[str, tuple[float, float]]:
        """Return the least and the largest share of tipping steps in a table, by box, "S" or "B".

        `integration` is the index of the method in `INTEGRATIONS`.
        """
        shares: dict[str, list[float]] = {}
        for cell in self.cells:
            share = cell.ours[integration].tipping
            if share is not None:
                shares.setdefault(cell.size, []).append(share)
        return {size: (min(found), max(found)) for size, found in shares.items()}


LONGEST = 6.0  # [s] maximum time to sort a box, or to cross a slowing area
ANGLES = (0, 45)  # [deg] axis angles in Table 4
MOST_COLUMNS = 10  # columns in Table 4's layouts
NONE = -1  # column if no rotor lies under the base


@dataclass(frozen=True)
class Integration:
    """A method of integration and its time step."""

    method: Literal["implicit", "explicit"]
    dt: float  # [s]

    def __str__(self) -> str:
        return f"{self.method}, {1000 * self.dt:g} ms"

    @expect_tipping()
    def run(self, surface: Surface, size: str, speed: float, duration: float) -> Trajectory:
        """Run the "S" or "B" box from the paper's start at `speed` [m/s] for `duration` [s]."""
        return simulate(
            surface, layouts.box(size), layouts.start(size), (speed, 0.0, 0.0), duration, self.dt,
            self.method,
        )  # fmt: skip


# The paper states no step. We infer about 5 ms from agreement with its tables and from its run
# times; `reproduction.count_agreements` measures how weak this evidence is.
COARSE = Integration("explicit", 5e-3)
# The limit of the same equations; `reproduction.compare_steps` measures its error.
CONVERGED = Integration("explicit", 5e-5)
# The method of the environments. It does not chatter, so chatter causes no tipping here.
SMOOTH = Integration("implicit", 1e-3)
INTEGRATIONS = (COARSE, CONVERGED, SMOOTH)


def tipping_share(trajectory: Trajectory, end: int | None = None) -> float | None:
    """Return the share [-] of tipping steps in a trajectory, or None if no step is counted.

    The steps up to row `end` are counted, or all steps if `end` is None. In a tipping step,
    Eq. (1) has no solution. Then the simulation uses forces that carry the weight, with moments as
    close to balance as possible.
    """
    steps = trajectory.tipping[1:] if end is None else trajectory.tipping[1 : end + 1]
    return float(steps.mean()) if len(steps) else None


def displacement(trajectory: Trajectory) -> tuple[float, float, float]:
    """Return the displacement (x, y, theta) [m, m, deg] from a trajectory's start to its end."""
    x, y, theta = (trajectory.pose[-1] - trajectory.pose[0]).tolist()
    return x, y, math.degrees(theta)


@compiled
def _find_columns(
    grid: Grid, body: Body, pose: Array, scratch: Scratch, columns: NDArray[np.int64]
) -> None:
    """Write to `columns` (T, 2) the first and last rotor column under a base at `pose` (T, 3)."""
    for k in range(pose.shape[0]):
        columns[k, 0] = NONE
        columns[k, 1] = NONE
        contacts = find_contacts(grid, body, pose[k, 0], pose[k, 1], pose[k, 2], scratch)
        for i in range(contacts.total):
            if scratch.marks[KIND + i] != SUPPORT:
                column = round((pose[k, 0] + scratch.table[ARM_X + i] - grid.x0) / grid.pitch_x)
                if columns[k, 0] == NONE or column < columns[k, 0]:
                    columns[k, 0] = column
                columns[k, 1] = max(columns[k, 1], column)


def rotor_columns(
    surface: Surface, size: str, pose: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and the last column (T,) of the rotors under a box, at poses (T, 3).

    If only supports carry the box at a pose, the first and the last column are `NONE`.
    """
    columns = np.empty((len(pose), 2), dtype=np.int64)
    _find_columns(surface.grid, layouts.box(size).body, pose, make_scratch(), columns)
    return columns[:, 0], columns[:, 1]


# Section 5.1: sorting


@dataclass(frozen=True)
class SortingResult:
    """Result of sorting a box."""

    columns: int | None  # touched columns from the first inclined one; None: it stays in the line
    rate: float | None  # [pcs/h] rate in Figure 8; None: it does not reach Figure 8's distance
    tipping: float | None  # [-] share of tipping steps until it is out of the line


@dataclass(frozen=True)
class SortingCase:
    """A start of a box on the sorting layout, and the results of the simulations."""

    size: str  # "S" or "B"
    speed: float  # [m/s] at the start
    tilt: float  # [deg]
    ours: tuple[SortingResult, ...]  # one per integration


def run_table2(case: SortingRun, integration: Integration) -> Trajectory:
    """Run a row of Table 2 by a method of integration."""
    surface = layouts.sorting("S", case.side, tilt=math.radians(case.tilt))
    return integration.run(surface, "S", case.speed, case.time)


def pass_by(case: Passing, integration: Integration) -> list[ComputedValue]:
    """Return the changes in x [m], theta [deg] and time [s] while y changes by `case.y` [m]."""
    surface = layouts.sorting("S", side=-1, tilt=math.radians(case.tilt))
    trajectory = integration.run(surface, "S", speed=0.0, duration=2.0 * case.time)
    moved = trajectory.pose - trajectory.pose[0]
    after = int(np.argmax(moved[:, 1] <= case.y))
    part = (case.y - moved[after - 1, 1]) / (moved[after, 1] - moved[after - 1, 1])
    x, _, theta = moved[after - 1] + part * (moved[after] - moved[after - 1])
    time = trajectory.time[after - 1] + part * integration.dt
    found = (float(x), math.degrees(theta), float(time))
    return [ComputedValue(value, tipping_share(trajectory, after)) for value in found]


def sort(size: str, speed: float, tilt: float, integration: Integration) -> SortingResult:
    """Simulate a box on the sorting layout with a `tilt` [deg]. The box enters at `speed` [m/s].

    The result has the number of columns that the box needs, as in Section 5.1. The count begins at
    the first inclined column, and ends at the last column that the box touches. The result also
    has Figure 8's rate [boxes/h], which is 3600 s / (time until the box is clear). A clear box is
    off the line for any angle theta: |y - y0| >= h / 2 + hypot(b / 2, h / 2). Here b and h are the
    box's lengths along x and y, and y0 is y at the start.
    """
    surface = layouts.sorting(size, side=-1, tilt=math.radians(tilt))
    trajectory = integration.run(surface, size, speed, LONGEST)
    _, last = rotor_columns(surface, size, trajectory.pose)
    out = last == NONE
    end = int(np.argmax(out)) if out.any() else None
    columns = None if end is None else int(last[:end].max()) - layouts.LEAD_IN[size] + 1
    base = layouts.box(size).base
    distance = float(base.outline[:, 1].max()) + base.reach
    clear = abs(trajectory.pose[:, 1] - trajectory.pose[0, 1]) >= distance
    rate = 3600.0 / float(trajectory.time[np.argmax(clear)]) if clear.any() else None
    return SortingResult(columns, rate, tipping_share(trajectory, end))


def sort_case(
    size: str, speed: float, tilt: float, integrations: Sequence[Integration]
) -> SortingCase:
    """Simulate a box once per entry of `integrations`. `speed` is in m/s, `tilt` in deg."""
    return SortingCase(size, speed, tilt, tuple(sort(size, speed, tilt, k) for k in integrations))


def slowest_sorted(size: str, integration: Integration) -> ComputedValue:
    """Find the smallest speed among 0.1, 0.2, ... m/s at which a box is sorted on a level line."""
    tenths = 1
    while (done := sort(size, tenths / 10.0, 0.0, integration)).columns is None:
        tenths += 1
    return ComputedValue(tenths / 10.0, done.tipping)


# Sections 5.2 and 5.3: slowing and stopping


def slowing_surface(size: str, layout: SlowingLayout, stops: bool = False) -> Surface:
    """Build a line with a slowing area in the middle. All other columns are at 90 deg.

    If `stops` is true, the slowing area ends with one more column, at 0 deg.
    """
    build = layouts.stopping if stops else layouts.slowing
    columns = layout.columns + stops + 2 * layouts.LEAD_IN[size]
    return build(size, math.radians(layout.angle), layout.columns, columns=columns)


def leave(
    surface: Surface, size: str, speed: float, integration: Integration
) -> tuple[float, float | None]:
    """Run a box over a `slowing_surface`.

    Return the speed [m/s] at which the base leaves the slowing area, and the share [-] of the steps
    until then in which the box tips. If the box does not leave the area, the speed is 0.
    """
    trajectory = integration.run(surface, size, speed, LONGEST)
    first, _ = rotor_columns(surface, size, trajectory.pose)
    past = first >= surface.columns - layouts.LEAD_IN[size]
    if not past.any():
        return 0.0, tipping_share(trajectory)
    end = int(np.argmax(past))
    return float(trajectory.velocity[end, 0]), tipping_share(trajectory, end)


def smallest_layout(size: str, speed: float, integration: Integration) -> ComputedValue:
    """Find the layout with the fewest columns that slows a box to half its entry speed or less.

    The entry speed v0 is `speed` [m/s]. The exit speed v_out must satisfy 0.5 v0 >= v_out > 0. The
    result's value is None if no layout of at most `MOST_COLUMNS` columns satisfies this condition.
    """
    for columns in range(1, MOST_COLUMNS + 1):
        for angle in ANGLES:
            layout = SlowingLayout(columns, angle)
            left, tipping = leave(slowing_surface(size, layout), size, speed, integration)
            if 0.5 * speed >= left > 0.0:
                return ComputedValue(layout, tipping)
    return ComputedValue(None, None)


# Section 5.2: axes at +-45 deg that align a box. Section 6.2: tilts that stop it.
#
# docs/reproduction.md derives the steepest tilt gamma at which a box stops by itself. It is
# tan(gamma) = sqrt(2) mu_min on axes at +45 deg, and tan(gamma) = (mu_max + mu_min) / sqrt(2) on
# alternate rows at +45 and -45 deg.

INWARDS, OUTWARDS = 1, -1  # sign of the outer row's angle at y > 1 m
ZONES = ((2, 1.5), (6, 2.5), (30, 2.5))  # columns, and entry speed [m/s] of a box
ZONE_TILTS = (0.0, 10.0)  # [deg]
OFFSETS = (0.01, 0.02, 0.04)  # [m] offset from the middle of boxes without a turn
TURNS = (5.0, 10.0)  # [deg] turn of boxes in the middle
NEARER = 0.9  # [-] maximum ratio of final to initial offset that counts as nearer
LONGEST_CROSSING = 6.0  # [s]
STEP = 1e-3  # [s] implicit step

METHODS = (Integration("implicit", 5e-3), Integration("explicit", 1e-3))
PUSH = 0.05  # [m/s] along x at the start
LONGEST_PUSH = 60.0  # [s]
STEEPEST = 30.0  # [deg]
RESOLUTION = 0.005  # [deg] resolution of a threshold
ELEMENTS = 80  # elements per side of the field
START = (1.0, 7.0, 0.0)  # [m, m, rad]
# [m/s] With the explicit method, a box at rest still oscillates at some mm/s.
STANDING = 0.02


@dataclass(frozen=True)
class Zone:
    """A slowing zone, and a box's entry speed. Axes of a row are parallel, at 45 or at -45 deg."""

    size: str  # size of the box, "S" or "B"
    towards: int  # INWARDS or OUTWARDS: direction in which the outer rows push
    columns: int
    speed: float  # [m/s]
    tilt: float  # [deg]

    @property
    def surface(self) -> Surface:
        """Surface with equally many columns at 90 deg before the zone and after the zone."""
        return layouts.slowing(
            self.size,
            self.towards * 0.25 * math.pi,
            self.columns,
            columns=self.columns + 2 * layouts.LEAD_IN[self.size],
            tilt=math.radians(self.tilt),
        )


@dataclass(frozen=True)
class Alignment:
    """Offsets [m] and turns [deg] of boxes that leave a zone or stop in the zone."""

    zone: Zone
    straight: list[tuple[float, float]]  # for each of OFFSETS, boxes without a turn
    centred: list[tuple[float, float]]  # for each of TURNS, boxes in the middle
    nearer: int  # number of boxes with offset and turn that end nearer in both
    mixed: int  # number of boxes with offset and turn
    tipping: float  # [-] share of all steps that would tip the box


def study_alignment() -> list[Alignment]:
    """Compute how zones align boxes, for all combinations of box, zone, tilt and push direction."""
    zones = product(SIZES, ZONES, ZONE_TILTS, (INWARDS, OUTWARDS))
    return [align(Zone(size, towards, *zone, tilt)) for size, zone, tilt, towards in zones]


def align(zone: Zone) -> Alignment:
    """Measure how a zone aligns boxes that enter with an offset, a turn, or offset and turn."""
    mixed = [(offset, side * turn) for offset, turn, side in product(OFFSETS, TURNS, (1.0, -1.0))]
    starts = (*((offset, 0.0) for offset in OFFSETS), *((0.0, turn) for turn in TURNS), *mixed)
    runs = [cross(zone, *start) for start in starts]
    ends = [end_of_run(run) for run in runs]
    straight, centred = ends[: len(OFFSETS)], ends[len(OFFSETS) : -len(mixed)]
    both = sum(
        abs(offset) <= NEARER * abs(came[0]) and abs(turn) <= NEARER * abs(came[1])
        for (offset, turn), came in zip(ends[-len(mixed) :], mixed, strict=True)
    )
    tipping = float(np.mean([tipping_share(run) or 0.0 for run in runs]))
    return Alignment(zone, straight, centred, both, len(mixed), tipping)


@expect_tipping()
def cross(zone: Zone, offset: float, turn: float) -> Trajectory:
    """Run a box with an initial offset [m] and turn [deg] until the box stops or leaves `zone`."""
    surface = zone.surface
    x, y, _ = layouts.start(zone.size)
    run = simulate(
        surface, layouts.box(zone.size), (x, y + offset, math.radians(turn)),
        (zone.speed, 0.0, 0.0), LONGEST_CROSSING, STEP,
    )  # fmt: skip
    first, _ = rotor_columns(surface, zone.size, run.pose)
    past = (first >= surface.columns - layouts.LEAD_IN[zone.size]) | (first == NONE)
    rows = int(np.argmax(past)) + 1 if past.any() else len(past)
    return Trajectory(
        run.time[:rows], run.pose[:rows], run.velocity[:rows], run.tipping[:rows], run.end
    )


def end_of_run(run: Trajectory) -> tuple[float, float]:
    """Return the box's offset from the middle [m] and its turn [deg] at the end of a run."""
    return float(run.pose[-1, 1]) - layouts.LINE_Y, math.degrees(run.pose[-1, 2])


@dataclass(frozen=True)
class SelfStop:
    """The steepest tilt at which a pushed box stops by itself."""

    layout: str
    integration: Integration
    measured: float  # [deg]
    expected: float  # [deg] by the balance of forces
    study: float | None  # [deg] value in Section 6.2; None: not stated for this layout


def wide_field(signs: tuple[int, ...], tilt: float) -> Surface:
    """Build a field with a `tilt` [rad]. Axes in row k are at 45 deg * `signs[k % len(signs)]`."""
    axis = np.tile(0.25 * math.pi * np.resize(signs, (ELEMENTS, 1)), ELEMENTS)
    return Surface(axis, np.ones(axis.shape, dtype=bool), tilt=tilt)


def study_standstill() -> list[SelfStop]:
    """Find the steepest tilt at which a box stops by itself, for 2 layouts with 2 methods each."""
    surface = wide_field((1,), 0.0)
    printed = math.degrees(math.asin(math.sqrt(0.5) * surface.mu_min))
    rolling = math.degrees(math.atan(math.sqrt(2.0) * surface.mu_min))
    both = math.degrees(math.atan(math.sqrt(0.5) * (surface.mu_max + surface.mu_min)))
    fields = (
        ("+45° everywhere", (1,), rolling, printed),
        ("±45° in alternate rows", (-1, 1), both, None),
    )
    return [
        SelfStop(name, integration, steepest_stop(signs, integration), expected, study)
        for (name, signs, expected, study), integration in product(fields, METHODS)
    ]


def steepest_stop(signs: tuple[int, ...], integration: Integration) -> float:
    """Find the steepest tilt [deg] at which a pushed box stops by itself on `wide_field(signs)`."""
    low, high = 0.0, STEEPEST
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        if _stops(wide_field(signs, math.radians(middle)), integration):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@expect_tipping()
def _stops(surface: Surface, integration: Integration) -> bool:
    """Push the S-box, a box of 0.25 m. Return whether the box rests in the run's last quarter."""
    run = simulate(
        surface, layouts.box("S"), START, (PUSH, 0.0, 0.0), LONGEST_PUSH, integration.dt,
        integration.method,
    )  # fmt: skip
    speed = np.hypot(run.velocity[:, 0], run.velocity[:, 1])
    return run.end != "left the surface" and bool(speed[-len(speed) // 4 :].mean() < STANDING)
