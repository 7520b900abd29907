"""Runs of a case on one surface while one quantity is swept."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design import report
from surface_gym.design.case import NOTHING, SURE, Case, Draws
from surface_gym.design.columns import MOST, Columns, least_columns
from surface_gym.design.line import DesignLine
from surface_gym.design.purposes import Layout
from surface_gym.design.runs import Ends, OnProgress, Runs, join_runs
from surface_gym.parallel import Workers, check_workers

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A case on a line whose first columns are turned by one of the purpose's layouts."""

    case: Case
    line: DesignLine  # with as many columns as `least_columns` tries, so that draws are the same
    layout: Layout
    columns: int  # that are turned
    chosen: str  # reason for their number

    @property
    def description(self) -> str:
        """The surface as it follows "on": "6 columns of 4 rows, +45 deg"."""
        return (
            f"{report.plural(self.columns, 'column')} of {self.line.rows} rows, {self.layout.name}"
        )

    @property
    def passed(self) -> int:
        """Columns behind which a run ends: of the zone, and of a run-out where it may help."""
        return self.columns + (0 if self.case.purpose.leaves_zone else self.line.run_out)

    def run(
        self,
        drawn: Draws,
        runs: Runs,
        workers: Workers = 1,
        on_progress: OnProgress = lambda *_: None,
    ) -> Ends:
        """Simulate runs of draws over the layout."""
        axes = self.layout.axis[np.newaxis]
        return self.case.run(self.line, axes, runs, drawn, workers, on_progress)


@dataclass(frozen=True, eq=False)
class SweepPoints:
    """Points of a sweep, a row each."""

    speed: Numbers  # (points,) [m/s]
    tilt: Numbers  # (points,) [rad]
    friction: Numbers  # (points, 3) [-] factors of mu_max, mu_min and mu_support

    def __len__(self) -> int:
        return len(self.speed)


def repeat_case(case: Case, count: int = 1) -> SweepPoints:
    """Return the case itself as so many points."""
    return SweepPoints(
        speed=np.full(count, case.speed),
        tilt=np.full(count, case.tilt),
        friction=np.ones((count, 3)),
    )


def arrange(
    case: Case, columns: int | None = None, rows: int | None = None, workers: Workers = 1
) -> Arrangement:
    """Choose the surface on which a case is swept.

    Args:
        case: the parcel, its entry and its purpose.
        columns: of the zone; None: the fewest for all but `WORST` of the draws of all unknown
            quantities; if no number is enough, the fewest with nothing unknown.
        rows: of rotors; None: as many as lie under the parcel.
        workers: threads that share the runs, or a cluster.

    Returns:
        The surface with the purpose's layout that succeeds with nothing unknown; if several do,
        with the one that succeeds in the most draws.

    Raises:
        ValueError: `columns` is None and no number of them is enough, or is below 1.
    """
    check_workers(workers)
    chosen = "as asked"
    if columns is None:
        columns, chosen = _fewest(case, least_columns(case, rows, workers=workers))
    line = case.line(max(MOST, checks.integer("columns", columns, least=1)), rows)
    tried = [
        Arrangement(case, line, layout, columns, chosen)
        for layout in case.purpose.layouts(line, columns)
    ]
    if len(tried) == 1:
        return tried[0]
    point = repeat_case(case)

    def merit(each: Arrangement) -> tuple[float, ...]:
        """Return the success with nothing unknown, and the share of the draws that succeed."""
        return tuple(
            float(success_shares(each, case.draw(line, unknown), point, workers)[0])
            for unknown in (NOTHING, case.unknown)
        )

    return max(tried, key=merit)


def success_shares(
    arrangement: Arrangement,
    drawn: Draws,
    points: SweepPoints,
    workers: Workers = 1,
    on_progress: OnProgress = lambda *_: None,
) -> Numbers:
    """Return the share (points,) of the draws that succeed, with the same draws at every point."""
    each_point = []
    for k in range(len(points)):
        runs = drawn.runs(float(points.speed[k]), float(points.tilt[k]), arrangement.passed)
        each_point.append(replace(runs, friction=runs.friction * points.friction[k]))
    runs = join_runs(each_point)
    ends = arrangement.run(drawn, runs, workers, on_progress)
    done = arrangement.case.purpose.succeeds(ends)
    share: Numbers = done.reshape(len(points), len(drawn)).mean(axis=1)
    return share


def _fewest(case: Case, found: Columns) -> tuple[int, str]:
    """Return the number of columns to take, and the reason for it."""
    if found.together is not None and found.together.columns is not None:
        return found.together.columns, f"the fewest for {SURE} of the draws"
    if found.columns is None:
        raise ValueError(
            f"columns must be given: by the study's layouts no number up to {MOST} does it "
            f"at {case.speed:g} m/s"
        )
    if not found.worst:
        return found.columns, "the fewest, with nothing unknown"
    return found.columns, f"the fewest with nothing unknown; none do for {SURE} of draws"
