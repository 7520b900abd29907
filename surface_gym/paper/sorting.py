"""Section 5.1: where sorted parcels end, how many columns they touch, how long they take."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surface_gym import layouts
from surface_gym.paper.comparison import Cell, Found
from surface_gym.paper.integration import Integration, tipping_share
from surface_gym.paper.occupancy import NONE, rotor_columns
from surface_gym.paper.targets import Passing, SortingRun
from surface_gym.trajectory import Trajectory

POSITION_TOLERANCE = 0.010  # [m]
ANGLE_TOLERANCE = 3.5  # [deg]
TIME_TOLERANCE = 0.010  # [s]
LONGEST = 6.0  # [s] a sorting run may take; a parcel still in the line then has not been sorted

Integrations = Sequence[Integration]


@dataclass(frozen=True)
class Sorted:
    """How a box was sorted."""

    columns: int | None  # touched, from the first inclined one on; None: it stays in the line
    rate: float | None  # [pcs/h] Figure 8's; None: it stays within Figure 8's distance
    tipping: float | None  # [-] share of the steps, until it is out of the line, that would tip it


@dataclass(frozen=True)
class SortingCase:
    """A box sent through the sorting layout."""

    size: str  # "S" or "B"
    speed: float  # [m/s] at the start
    tilt: float  # [deg]
    ours: tuple[Sorted, ...]  # one an integration


def run_table2(case: SortingRun, integration: Integration) -> Trajectory:
    """The trajectory behind a row of Table 2."""
    surface = layouts.sorting("S", case.side, tilt=math.radians(case.tilt))
    return integration.run(surface, "S", case.speed, case.time)


def displacement(trajectory: Trajectory) -> tuple[float, float, float]:
    """(x, y, theta) [m, m, deg] from start to end."""
    x, y, theta = (trajectory.pose[-1] - trajectory.pose[0]).tolist()
    return x, y, math.degrees(theta)


def table2_cells(case: SortingRun, integrations: Integrations) -> tuple[Cell, ...]:
    """One row of Table 2: x, y and theta."""
    push = f"{case.speed:g} m/s" if case.speed > 0.0 else f"{case.tilt:g}°"
    row = f"{case.figure[:2]}, {push}"
    runs = [run_table2(case, integration) for integration in integrations]
    shares = [tipping_share(run) for run in runs]
    x, y, theta = (
        tuple(map(Found, values, shares)) for values in zip(*map(displacement, runs), strict=True)
    )
    return (
        Cell(row, "x [m]", "S", case.x, x, 3, POSITION_TOLERANCE),
        Cell(row, "y [m]", "S", case.y, y, 3, POSITION_TOLERANCE),
        Cell(row, "theta [°]", "S", case.theta, theta, 2, ANGLE_TOLERANCE),
    )


def pass_by(case: Passing, integration: Integration) -> tuple[Found, Found, Found]:
    """Displacement x [m], theta [deg] and time [s] at which the displacement y is reached."""
    surface = layouts.sorting("S", side=-1, tilt=math.radians(case.tilt))
    trajectory = integration.run(surface, "S", speed=0.0, duration=2.0 * case.time)
    moved = trajectory.pose - trajectory.pose[0]
    after = int(np.argmax(moved[:, 1] <= case.y))
    part = (case.y - moved[after - 1, 1]) / (moved[after, 1] - moved[after - 1, 1])
    x, _, theta = moved[after - 1] + part * (moved[after] - moved[after - 1])
    time = trajectory.time[after - 1] + part * integration.dt
    share = tipping_share(trajectory, after)
    return (
        Found(float(x), share),
        Found(math.degrees(theta), share),
        Found(float(time), share),
    )


def passing_cells(case: Passing, integrations: Integrations) -> tuple[Cell, ...]:
    """The state in which the parcel at 10 deg passes the one at 5 deg."""
    row = f"y = {case.y:g}"
    ours = (pass_by(case, integration) for integration in integrations)
    x, theta, time = zip(*ours, strict=True)
    return (
        Cell(row, "x [m]", "S", case.x, x, 3, POSITION_TOLERANCE),
        Cell(row, "theta [°]", "S", case.theta, theta, 2, ANGLE_TOLERANCE),
        Cell(row, "time [s]", "S", case.time, time, 3, TIME_TOLERANCE),
    )


def sort(size: str, speed: float, tilt: float, integration: Integration) -> Sorted:
    """Sort a box that enters at `speed` [m/s] on a surface tilted by `tilt` [deg].

    The columns are counted as Section 5.1 does: from the first inclined one to the last one the
    box touches before only elements outside the line carry it. The rate is that of Figure 8: its
    clock stops once |y - y0| >= h / 2 + hypot(b / 2, h / 2), clear of the line in any orientation.
    """
    surface = layouts.sorting(size, side=-1, tilt=math.radians(tilt))
    trajectory = integration.run(surface, size, speed, LONGEST)
    _, last = rotor_columns(surface, size, trajectory.pose)
    out = last == NONE
    end = int(np.argmax(out)) if out.any() else None
    columns = None if end is None else int(last[:end].max()) - layouts.LEAD_IN[size] + 1
    clear = abs(trajectory.pose[:, 1] - trajectory.pose[0, 1]) >= clear_distance(size)
    rate = 3600.0 / float(trajectory.time[np.argmax(clear)]) if clear.any() else None
    return Sorted(columns, rate, tipping_share(trajectory, end))


def clear_distance(size: str) -> float:
    """[m] Section 5.1's y limit: half the width of the box and half its diagonal."""
    base = layouts.box(size).base
    return float(base.outline[:, 1].max()) + base.reach


def sort_case(size: str, speed: float, tilt: float, integrations: Integrations) -> SortingCase:
    """Sort a box by each integration."""
    ours = tuple(sort(size, speed, tilt, integration) for integration in integrations)
    return SortingCase(size, speed, tilt, ours)


def table3_cell(case: SortingCase, paper: int | None) -> Cell:
    """An entry of Table 3."""
    ours = tuple(Found(each.columns, each.tipping) for each in case.ours)
    return Cell(f"{case.speed:.1f}", f"{case.size}-box", case.size, paper, ours)


def slowest_sorted(size: str, integration: Integration) -> Found:
    """[m/s] the first of the speeds 0.1, 0.2, ... at which a box leaves the line."""
    tenths = 1
    while (done := sort(size, tenths / 10.0, 0.0, integration)).columns is None:
        tenths += 1
    return Found(tenths / 10.0, done.tipping)


def slowest_cell(size: str, paper: float, integrations: Integrations) -> Cell:
    """The speed below which sorting fails."""
    ours = tuple(slowest_sorted(size, integration) for integration in integrations)
    return Cell("v0 [m/s]", f"{size}-box", size, paper, ours, 1)
