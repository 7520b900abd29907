"""Each table of the paper, by whatever integrations."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from surface_gym.paper import slowing, sorting
from surface_gym.paper.comparison import SlowingLayout, Table
from surface_gym.paper.integration import Integration
from surface_gym.paper.sorting import SortingCase
from surface_gym.paper.targets import SIZES, Targets

Integrations = Sequence[Integration]
Track = Callable[[Sequence[Any], str], Iterable[Any]]


def untracked(cases: Sequence[Any], description: str) -> Iterable[Any]:  # noqa: ARG001
    """Go through the cases and show no progress."""
    return cases


def table2(targets: Targets, integrations: Integrations, track: Track = untracked) -> Table:
    """End poses of the sorting runs."""
    runs = track(targets.sorting_runs, "Table 2")
    return Table(
        "table2",
        "Table 2: displacement when sorting the S-box",
        "agrees within 10 mm and 3.5°, rounded as the paper prints",
        tuple(cell for run in runs for cell in sorting.table2_cells(run, integrations)),
    )


def passing(targets: Targets, integrations: Integrations) -> Table:
    """The parcel at 10 deg where that at 5 deg has got to."""
    return Table(
        "passing",
        "Section 5.1: the S-box at 10° on its way",
        "agrees within 10 mm, 3.5° and 10 ms, rounded as the paper prints",
        sorting.passing_cells(targets.passing, integrations),
    )


def table3(targets: Targets, cases: Sequence[SortingCase]) -> Table:
    """Columns to sort, of cases in the order of the paper's sizes and speeds."""
    paper = [columns for size in SIZES for columns in targets.sorting_columns[size]]
    return Table(
        "table3",
        "Table 3: columns to sort, by v0 [m/s]",
        "from the first inclined column to the last one touched before the box is out of the "
        "line; / where it stops in the line",
        tuple(map(sorting.table3_cell, cases, paper)),
    )


def slowest_sorted(targets: Targets, integrations: Integrations, track: Track = untracked) -> Table:
    """The speeds below which sorting fails."""
    sizes = track(SIZES, "Slowest speed sorted")
    return Table(
        "slowest_sorted",
        "Section 5.1: slowest v0 [m/s] that sorts",
        "in steps of 0.1 m/s",
        tuple(
            sorting.slowest_cell(size, targets.slowest_sorted[size], integrations) for size in sizes
        ),
    )


def _slowing_cases(targets: Targets) -> tuple[tuple[str, float, SlowingLayout], ...]:
    return tuple(
        (size, speed, layout)
        for size in SIZES
        for speed, layout in zip(targets.slowing_speeds, targets.slowing_layouts[size], strict=True)
    )


def table4(targets: Targets, integrations: Integrations, track: Track = untracked) -> Table:
    """Columns to slow."""
    cases = track(_slowing_cases(targets), "Table 4")
    return Table(
        "table4",
        "Table 4: columns to slow, and axes, by v0 [m/s]",
        "the fewest columns with 0.5 v0 >= v_out > 0; / where no layout does that",
        tuple(
            slowing.table4_cell(size, speed, layout, integrations) for size, speed, layout in cases
        ),
    )


def slowing_ratios(targets: Targets, integrations: Integrations) -> Table:
    """How much of the speed two columns leave."""
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
                integrations,
            )
            for angle in slowing.ANGLES
            for size in SIZES
        ),
    )


def stopping(targets: Targets, integrations: Integrations, track: Track = untracked) -> Table:
    """What one more column leaves of the speed."""
    cases = track(_slowing_cases(targets), "Stopping")
    return Table(
        "stopping",
        "Section 5.3: speed [m/s] after one more column",
        "behind the paper's Table 4 layout and one more column at 0°, by v0 [m/s]; "
        "0 where the box stops on them, as the paper says all do",
        tuple(
            slowing.stopping_cell(size, speed, layout, integrations)
            for size, speed, layout in cases
        ),
    )
