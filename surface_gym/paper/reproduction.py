"""Everything the paper tabulates, computed."""

from dataclasses import dataclass
from itertools import product

from surface_gym.paper import alignment, sorting, standstill, steps, tables
from surface_gym.paper.comparison import Table
from surface_gym.paper.convergence import (
    ABOUT_COARSE,
    NEAR_THE_LIMIT,
    Spread,
    StepSpread,
    between_last_digits,
    between_steps,
)
from surface_gym.paper.integration import COARSE, INTEGRATIONS
from surface_gym.paper.sorting import SortingCase
from surface_gym.paper.tables import Track, untracked
from surface_gym.paper.targets import SIZES, load_targets

TILTS = tuple(range(5, 16))  # [deg] of Figure 8; Table 5's range


@dataclass(frozen=True)
class Reproduction:
    """The paper's tables and claims beside ours."""

    tables: tuple[Table, ...]
    sorted_by_speed: tuple[SortingCase, ...]  # Figure 8, red
    sorted_by_tilt: tuple[SortingCase, ...]  # Figure 8, blue
    near_the_limit: tuple[StepSpread, ...]
    about_coarse: StepSpread
    last_digits: Spread  # at the coarse step
    by_step: tuple[steps.Agreement, ...]
    self_stopping: tuple[standstill.SelfStop, ...]
    alignment: tuple[alignment.Aligned, ...]

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
    by_speed = tuple(
        sorting.sort_case(size, speed, 0.0, INTEGRATIONS)
        for size, speed in track(speeds, "Table 3")
    )
    tilts = tuple(product(SIZES, TILTS))
    by_tilt = tuple(
        sorting.sort_case(size, 0.0, tilt, INTEGRATIONS) for size, tilt in track(tilts, "Figure 8")
    )
    return Reproduction(
        tables=(
            tables.table2(targets, INTEGRATIONS, track),
            tables.passing(targets, INTEGRATIONS),
            tables.table3(targets, by_speed),
            tables.slowest_sorted(targets, INTEGRATIONS, track),
            tables.table4(targets, INTEGRATIONS, track),
            tables.slowing_ratios(targets, INTEGRATIONS),
            tables.stopping(targets, INTEGRATIONS, track),
        ),
        sorted_by_speed=by_speed,
        sorted_by_tilt=by_tilt,
        near_the_limit=tuple(
            between_steps(targets.sorting_runs, pair)
            for pair in track(NEAR_THE_LIMIT, "Convergence")
        ),
        about_coarse=between_steps(targets.sorting_runs, ABOUT_COARSE),
        last_digits=between_last_digits(targets.sorting_runs, COARSE),
        by_step=steps.agreements(targets, track),
        self_stopping=standstill.self_stopping(track),
        alignment=alignment.study(track),
    )
