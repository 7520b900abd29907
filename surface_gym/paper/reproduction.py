"""Everything the paper tabulates, computed."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from surface_gym.paper import slowing, sorting
from surface_gym.paper.comparison import SlowingLayout, Table
from surface_gym.paper.convergence import ABOUT_PAPER_STEP, NEAR_THE_LIMIT, Spread, spread
from surface_gym.paper.sorting import SortingCase
from surface_gym.paper.targets import SIZES, Targets, load_targets

TILTS = tuple(range(5, 16))  # [deg] of Figure 8; Table 5's range

Track = Callable[[Sequence[Any], str], Iterable[Any]]


def untracked(cases: Sequence[Any], description: str) -> Iterable[Any]:  # noqa: ARG001
    """Go through the cases and show no progress."""
    return cases


@dataclass(frozen=True)
class Reproduction:
    """The paper's tables beside ours."""

    tables: tuple[Table, ...]
    sorted_by_speed: tuple[SortingCase, ...]  # Figure 8, red
    sorted_by_tilt: tuple[SortingCase, ...]  # Figure 8, blue
    near_the_limit: tuple[Spread, ...]
    about_paper_step: Spread

    def table(self, key: str) -> Table:
        """The table of that key."""
        return next(table for table in self.tables if table.key == key)


def reproduce(track: Track = untracked) -> Reproduction:
    """Compute every table.

    Args:
        track: wraps a sequence of cases and its description, to show progress.
    """
    targets = load_targets()
    speeds = tuple(product(SIZES, targets.sorting_speeds))
    sorted_by_speed = tuple(sorting.sort_case(*case) for case in track(speeds, "Table 3"))
    tilts = tuple(product(SIZES, TILTS))
    sorted_by_tilt = tuple(
        sorting.sort_case(size, tilt=tilt) for size, tilt in track(tilts, "Figure 8")
    )
    tables = (
        _table2(targets, track),
        _passing(targets),
        _table3(targets, sorted_by_speed),
        _slowest_sorted(targets, track),
        _table4(targets, track),
        _slowing_ratios(targets),
        _stopping(targets, track),
    )
    near_the_limit = tuple(
        spread(targets.sorting_runs, pair) for pair in track(NEAR_THE_LIMIT, "Convergence")
    )
    about_paper_step = spread(targets.sorting_runs, ABOUT_PAPER_STEP)
    return Reproduction(tables, sorted_by_speed, sorted_by_tilt, near_the_limit, about_paper_step)


def _table2(targets: Targets, track: Track) -> Table:
    runs = track(targets.sorting_runs, "Table 2")
    return Table(
        "table2",
        "Table 2: displacement when sorting the S-box",
        "agrees within 10 mm and 3.5°, rounded as the paper prints",
        tuple(cell for run in runs for cell in sorting.table2_cells(run)),
    )


def _passing(targets: Targets) -> Table:
    return Table(
        "passing",
        "Section 5.1: the S-box at 10° on its way",
        "agrees within 10 mm, 3.5° and 10 ms, rounded as the paper prints",
        sorting.passing_cells(targets.passing),
    )


def _table3(targets: Targets, cases: tuple[SortingCase, ...]) -> Table:
    paper = [columns for size in SIZES for columns in targets.sorting_columns[size]]
    return Table(
        "table3",
        "Table 3: columns to sort, by v0 [m/s]",
        "from the first inclined column to the last one touched before the box is out of the "
        "line; / where it stops in the line",
        tuple(map(sorting.table3_cell, cases, paper)),
    )


def _slowest_sorted(targets: Targets, track: Track) -> Table:
    sizes = track(SIZES, "Slowest speed sorted")
    return Table(
        "slowest_sorted",
        "Section 5.1: slowest v0 [m/s] that sorts",
        "in steps of 0.1 m/s",
        tuple(sorting.slowest_cell(size, targets.slowest_sorted[size]) for size in sizes),
    )


def _slowing_cases(targets: Targets) -> tuple[tuple[str, float, SlowingLayout], ...]:
    return tuple(
        (size, speed, layout)
        for size in SIZES
        for speed, layout in zip(targets.slowing_speeds, targets.slowing_layouts[size], strict=True)
    )


def _table4(targets: Targets, track: Track) -> Table:
    cases = track(_slowing_cases(targets), "Table 4")
    return Table(
        "table4",
        "Table 4: columns to slow, and axes, by v0 [m/s]",
        "the fewest columns with 0.5 v0 >= v_out > 0; / where no layout does that",
        tuple(slowing.table4_cell(*case) for case in cases),
    )


def _slowing_ratios(targets: Targets) -> Table:
    return Table(
        "slowing_ratios",
        f"Section 5.2: v_out / v0 at {targets.ratio_speed:g} m/s",
        "v_out is taken as the base leaves the slowing columns; agrees when rounded as printed",
        tuple(
            slowing.ratio_cell(
                size,
                targets.ratio_speed,
                SlowingLayout(targets.ratio_columns, angle),
                targets.slowing_ratios[size][angle],
            )
            for angle in slowing.ANGLES
            for size in SIZES
        ),
    )


def _stopping(targets: Targets, track: Track) -> Table:
    cases = track(_slowing_cases(targets), "Stopping")
    return Table(
        "stopping",
        "Section 5.3: speed [m/s] after one more column",
        "behind the paper's Table 4 layout and one more column at 0°, by v0 [m/s]; "
        "0 where the box stops on them, as the paper says all do",
        tuple(slowing.stopping_cell(*case) for case in cases),
    )
