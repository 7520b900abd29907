"""Computation of the paper's tables and claims, and their JSON report."""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, product
from typing import Any

from surface_gym import layouts
from surface_gym.paper import runs
from surface_gym.paper.runs import ComputedValue, Integration, PaperTable, TableCell, Targets

NAMES = (f"{1000 * runs.COARSE.dt:g} ms", "converged", "implicit")  # names of INTEGRATIONS
TILTS = tuple(range(5, 16))  # [deg] tilts in Figure 8; Table 5's range
POSITION_TOLERANCE = 0.010  # [m]
ANGLE_TOLERANCE = 3.5  # [deg]
TIME_TOLERANCE = 0.010  # [s]
MILLISECONDS = (0.5, 1, 2, 3, 4, 5, 6, 7, 8, 10)  # [ms] compared steps

# Half the step, and another method.
NEAR_THE_LIMIT = (
    (runs.CONVERGED, Integration("explicit", runs.CONVERGED.dt / 2.0)),
    (runs.CONVERGED, Integration("implicit", 1e-3)),
)
# A tenth to both sides. The sign function of Eq. (2) chatters, so the result of a coarse step is
# random within this range.
ABOUT_COARSE = tuple(
    Integration("explicit", runs.COARSE.dt * percent / 100.0) for percent in range(90, 111, 2)
)
# [rad] larger than 1e-15, the tolerance within which an axis counts as 90 deg.
LAST_DIGITS = (-4e-15, 0.0, 4e-15)


@dataclass(frozen=True)
class AgreementCount:
    """Numbers of table cells that agree with the paper, for one integration (method and step)."""

    integration: Integration
    agreeing: dict[str, int]  # by key of the table


@dataclass(frozen=True)
class EndSpread:
    """Largest distance and angle between two end poses of the same row of Table 2."""

    position: float  # [mm]
    angle: float  # [deg]


@dataclass(frozen=True)
class StepEndSpread(EndSpread):
    """Spread of end poses over several methods and time steps, for the same row of Table 2."""

    integrations: tuple[Integration, ...]


@dataclass(frozen=True)
class Reproduction:
    """The paper's tables and claims, with our values."""

    tables: list[PaperTable]
    sorted_by_speed: list[runs.SortingCase]  # Figure 8, red
    sorted_by_tilt: list[runs.SortingCase]  # Figure 8, blue
    near_the_limit: list[StepEndSpread]
    about_coarse: StepEndSpread
    last_digits: EndSpread  # effect of round-off at the coarse step
    by_step: list[AgreementCount]
    self_stopping: list[runs.SelfStop]
    alignment: list[runs.Alignment]

    def table(self, key: str) -> PaperTable:
        return next(table for table in self.tables if table.key == key)


def reproduce(begin: Callable[[str], None] = lambda _: None) -> Reproduction:
    """Compute all tables and claims. Before each part, `begin` is called with the part's name."""
    targets = runs.load_targets()
    rows = targets.sorting_runs
    begin("Figure 8")
    by_speed, by_tilt = (
        [runs.sort_case(size, *each, runs.INTEGRATIONS) for size, each in product(runs.SIZES, over)]
        for over in (
            [(speed, 0.0) for speed in targets.sorting_speeds],
            [(0.0, tilt) for tilt in TILTS],
        )
    )
    begin("Tables 2 to 4")
    tables = [
        build_table2(targets, runs.INTEGRATIONS),
        build_passing(targets),
        build_table3(targets, by_speed),
        build_slowest_sorted(targets),
        build_table4(targets, runs.INTEGRATIONS),
        build_slowing_ratios(targets),
        build_stopping(targets),
    ]
    begin("Convergence")
    near_the_limit = [compare_steps(rows, pair) for pair in NEAR_THE_LIMIT]
    about_coarse = compare_steps(rows, ABOUT_COARSE)
    turned = ([run_turned(run, turn, runs.COARSE) for turn in LAST_DIGITS] for run in rows)
    last_digits = EndSpread(*_widest(turned))
    begin("Steps")
    by_step = count_agreements(targets)
    begin("Standstill and alignment")
    return Reproduction(
        tables, by_speed, by_tilt, near_the_limit, about_coarse, last_digits, by_step,
        runs.study_standstill(), runs.study_alignment(),
    )  # fmt: skip


def build_table2(targets: Targets, integrations: Sequence[Integration]) -> PaperTable:
    """Build Table 2, which compares the paper's end poses of sorting runs with our end poses.

    We compute an end pose with each of `integrations`.
    """
    cells = []
    for run in targets.sorting_runs:
        push = f"{run.speed:g} m/s" if run.speed > 0.0 else f"{run.tilt:g}°"
        row = f"{run.figure[:2]}, {push}"
        trajectories = [runs.run_table2(run, each) for each in integrations]
        shares = [runs.tipping_share(each) for each in trajectories]
        ends = zip(*map(runs.displacement, trajectories), strict=True)
        x, y, theta = (tuple(map(ComputedValue, values, shares)) for values in ends)
        cells += [
            TableCell(row, "x [m]", "S", run.x, x, 3, POSITION_TOLERANCE),
            TableCell(row, "y [m]", "S", run.y, y, 3, POSITION_TOLERANCE),
            TableCell(row, "theta [°]", "S", run.theta, theta, 2, ANGLE_TOLERANCE),
        ]
    return PaperTable(
        "table2",
        "Table 2: displacement when sorting the S-box",
        "agrees within 10 mm and 3.5°, rounded as the paper prints",
        cells,
    )


def build_passing(targets: Targets) -> PaperTable:
    """Compare our state `Passing` (x, theta and time) with the paper's state in `targets`."""
    case = targets.passing
    row = f"y = {case.y:g}"
    x, theta, time = zip(*(runs.pass_by(case, each) for each in runs.INTEGRATIONS), strict=True)
    cells = [
        TableCell(row, "x [m]", "S", case.x, x, 3, POSITION_TOLERANCE),
        TableCell(row, "theta [°]", "S", case.theta, theta, 2, ANGLE_TOLERANCE),
        TableCell(row, "time [s]", "S", case.time, time, 3, TIME_TOLERANCE),
    ]
    return PaperTable(
        "passing",
        "Section 5.1: the S-box at 10° on its way",
        "agrees within 10 mm, 3.5° and 10 ms, rounded as the paper prints",
        cells,
    )


def build_table3(targets: Targets, cases: Sequence[runs.SortingCase]) -> PaperTable:
    """Build Table 3: how many module columns sorting needs. `cases` are in the paper's order."""
    paper = [columns for size in runs.SIZES for columns in targets.sorting_columns[size]]
    cells = []
    for case, theirs in zip(cases, paper, strict=True):
        ours = [ComputedValue(each.columns, each.tipping) for each in case.ours]
        cells.append(_cell(f"{case.speed:.1f}", case.size, theirs, ours))
    return PaperTable(
        "table3",
        "Table 3: columns to sort, by v0 [m/s]",
        "from the first inclined column to the last one touched before the box is out of the "
        "line; / where it stops in the line",
        cells,
    )


def build_slowest_sorted(targets: Targets) -> PaperTable:
    """Compare our smallest speeds at which sorting succeeds with the speeds in the paper."""
    cells = []
    for size, paper in targets.slowest_sorted.items():
        ours = [runs.slowest_sorted(size, each) for each in runs.INTEGRATIONS]
        cells.append(_cell("v0 [m/s]", size, paper, ours, 1))
    title = "Section 5.1: slowest v0 [m/s] that sorts"
    return PaperTable("slowest_sorted", title, "in steps of 0.1 m/s", cells)


def build_table4(targets: Targets, integrations: Sequence[Integration]) -> PaperTable:
    """Build Table 4: the fewest columns that slow a box to at most half its entry speed.

    The table has the paper's values, and our values by each method of integration.
    """
    cells = []
    for size, speed, layout in _slowing_cases(targets):
        ours = [runs.smallest_layout(size, speed, each) for each in integrations]
        cells.append(_cell(f"{speed:.1f}", size, layout, ours))
    return PaperTable(
        "table4",
        "Table 4: columns to slow, and axes, by v0 [m/s]",
        "the fewest columns with 0.5 v0 >= v_out > 0; / where no layout does that",
        cells,
    )


def build_slowing_ratios(targets: Targets) -> PaperTable:
    """Compare our speed ratios with the paper's ratios.

    A speed ratio is the exit speed after two slowing columns, divided by the entry speed.
    """
    cells, speed = [], targets.ratio_speed
    for (k, angle), size in product(enumerate(runs.ANGLES), runs.SIZES):
        layout = runs.SlowingLayout(targets.ratio_columns, angle)
        surface = runs.slowing_surface(size, layout)
        exits = [runs.leave(surface, size, speed, each) for each in runs.INTEGRATIONS]
        ours = [ComputedValue(left / speed, tipping) for left, tipping in exits]
        cells.append(_cell(f"columns: {layout}", size, targets.slowing_ratios[size][k], ours, 2))
    return PaperTable(
        "slowing_ratios",
        f"Section 5.2: v_out / v0 at {speed:g} m/s",
        "v_out is taken as the base leaves the slowing columns; agrees when rounded as printed",
        cells,
    )


def build_stopping(targets: Targets) -> PaperTable:
    """Add a column of modules to Table 4's layouts. Compare exit speeds with the paper's 0 m/s."""
    cells = []
    for size, speed, layout in _slowing_cases(targets):
        surface = runs.slowing_surface(size, layout, stops=True)
        exits = [runs.leave(surface, size, speed, each) for each in runs.INTEGRATIONS]
        ours = [ComputedValue(*each) for each in exits]
        cells.append(_cell(f"{speed:.1f}", size, 0.0, ours, 3))
    return PaperTable(
        "stopping",
        "Section 5.3: speed [m/s] after one more column",
        "behind the paper's Table 4 layout and one more column at 0°, by v0 [m/s]; "
        "0 where the box stops on them, as the paper says all do",
        cells,
    )


def _cell(
    row: str, size: str, paper: Any, ours: Iterable[ComputedValue], decimals: int = 0
) -> TableCell:
    """Make a box's table cell from the paper's value, with `decimals` decimals, and our values."""
    return TableCell(row, f"{size}-box", size, paper, tuple(ours), decimals)


def _slowing_cases(targets: Targets) -> list[tuple[str, float, runs.SlowingLayout]]:
    return [
        (size, speed, layout)
        for size in runs.SIZES
        for speed, layout in zip(targets.slowing_speeds, targets.slowing_layouts[size], strict=True)
    ]


def count_agreements(targets: Targets) -> list[AgreementCount]:
    """Count the cells of Tables 2, 3 and 4 that agree with the paper, by time step.

    The explicit time steps range from 0.5 to 10 ms.
    """
    found = []
    for integration in [Integration("explicit", 1e-3 * ms) for ms in MILLISECONDS]:
        only = (integration,)
        sorting = product(runs.SIZES, targets.sorting_speeds)
        tables = (
            build_table2(targets, only),
            build_table3(targets, [runs.sort_case(*each, 0.0, only) for each in sorting]),
            build_table4(targets, only),
        )
        agreeing = {table.key: table.agreeing(0) for table in tables}
        found.append(AgreementCount(integration, agreeing))
    return found


def compare_steps(
    rows: Sequence[runs.SortingRun], integrations: tuple[Integration, ...]
) -> StepEndSpread:
    """Simulate each row of Table 2 with all `integrations`, and compare the end poses."""
    ends = (
        [runs.displacement(runs.run_table2(row, each)) for each in integrations] for row in rows
    )
    return StepEndSpread(*_widest(ends), integrations)


def run_turned(
    row: runs.SortingRun, turn: float, integration: Integration
) -> tuple[float, float, float]:
    """Run a row of Table 2 with all axes turned by `turn` [rad].

    Return the displacement (x, y, theta) [m, m, deg]. A tiny turn has the same effect as round-off,
    which makes cos(90 deg) 6e-17 instead of 0. A rotor whose axis is across the motion then pulls
    the parcel sideways with full mu_max. The sign of the turn decides the side.
    """
    surface = layouts.sorting("S", row.side, tilt=math.radians(row.tilt))
    surface = replace(surface, axis=surface.axis + turn)
    return runs.displacement(integration.run(surface, "S", row.speed, row.time))


def _widest(ends: Iterable[Sequence[tuple[float, float, float]]]) -> tuple[float, float]:
    """Return the largest distance [mm] and the largest angle [deg] between two end poses.

    Each row of `ends` is one list of end poses. Poses of different rows are not compared.
    """
    pairs = [pair for row in ends for pair in combinations(row, 2)]
    return (
        max(1000.0 * math.dist(one[:2], other[:2]) for one, other in pairs),
        max(abs(one[2] - other[2]) for one, other in pairs),
    )


def to_json(reproduction: Reproduction) -> str:
    """Return unrounded numbers as JSON. The lists `ours` have one value for each integration."""
    targets, data = runs.load_targets(), asdict(reproduction)
    report = {
        "source": runs.load_data()["source"],
        "integrations": [
            {"name": name, **asdict(integration)}
            for name, integration in zip(NAMES, runs.INTEGRATIONS, strict=True)
        ],
        "step": "The paper prints none; that it took about 5 ms is inferred.",
        "tipping": "Share of the steps up to a value in which Eq. (1) has no solution. Taken "
        "instead: the forces that bear the weight and come nearest to the moments.",
        "tables": {table.key: _table_data(table) for table in reproduction.tables},
        "sorting_rates": {
            "unit": "pcs/h",
            "medium": targets.medium_rates,
            "by_speed": data["sorted_by_speed"],
            "by_tilt": data["sorted_by_tilt"],
        },
        "near_the_limit": data["near_the_limit"],
        "about_coarse_step": data["about_coarse"],
        "last_digits_of_axes": data["last_digits"],
        "agreeing_by_step": data["by_step"],
        "self_stopping": data["self_stopping"],
        "alignment": data["alignment"],
    }
    return json.dumps(report, indent=2) + "\n"


def _table_data(table: PaperTable) -> dict[str, Any]:
    each = range(len(runs.INTEGRATIONS))
    return {
        "title": table.title,
        "rule": table.rule,
        "cells": [
            {**asdict(cell), "agrees": [cell.agrees(k) for k in each]} for cell in table.cells
        ],
        "agreeing": [table.agreeing(k) for k in each],
        "of": len(table.cells),
        "tipping": [table.tipping(k) for k in each],
    }
