"""The surface on which a case is varied, and its success over the draws."""

from dataclasses import dataclass

import numpy as np

from surface_gym import checks, parallel
from surface_gym.design import case as cases, report, runs as running
from surface_gym.design.columns import MOST, Columns, least_columns
from surface_gym.design.runs import DesignLine, OnProgress
from surface_gym.physics.types import Array


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A case on a line whose first columns are turned by one of the purpose's layouts."""

    case: cases.Case
    line: DesignLine  # with as many columns as `least_columns` tries, so that draws are the same
    layout: cases.Layout
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
        drawn: cases.Draws,
        runs: running.Runs,
        workers: parallel.Workers = 1,
        on_progress: OnProgress = lambda *_: None,
    ) -> running.Ends:
        """Simulate runs of draws over the layout."""
        axes = self.layout.axis[np.newaxis]
        return self.case.run(self.line, axes, runs, drawn, workers, on_progress)


def arrange(
    case: cases.Case,
    columns: int | None = None,
    rows: int | None = None,
    workers: parallel.Workers = 1,
) -> Arrangement:
    """Choose the surface on which a case is varied, with the layout that succeeds in most draws.

    Without `columns` it has the fewest for all but `WORST` of the draws of all unknown quantities;
    if no number is enough, the fewest with nothing unknown.
    """
    parallel.check_workers(workers)
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
    point = running.make_runs(case.speed, case.tilt)

    def merit(each: Arrangement) -> tuple[float, ...]:
        """Return the success with nothing unknown, and the share of the draws that succeed."""
        return tuple(
            float(success_shares(each, case.draw(line, unknown), point, workers)[0])
            for unknown in (cases.NOTHING, case.unknown)
        )

    return max(tried, key=merit)


def success_shares(
    arrangement: Arrangement,
    drawn: cases.Draws,
    points: running.Runs,
    workers: parallel.Workers = 1,
    on_progress: OnProgress = lambda *_: None,
) -> Array:
    """Return the share (points,) of the draws that succeed, with the same draws at every point.

    Of the points, speed, tilt and friction count.
    """
    speed, tilt, factors = (
        values[:, np.newaxis] for values in (points.speed, points.tilt, points.friction)
    )
    runs = drawn.runs(speed, tilt, arrangement.passed, friction=factors)
    ends = arrangement.run(drawn, runs, workers, on_progress)
    done = arrangement.case.purpose.succeeds(ends)
    return done.reshape(len(points), len(drawn)).mean(axis=1)


def _fewest(case: cases.Case, found: Columns) -> tuple[int, str]:
    """Return the number of columns to take, and the reason for it."""
    if found.together is not None and found.together.columns is not None:
        return found.together.columns, f"the fewest for {cases.SURE} of the draws"
    if found.columns is None:
        raise ValueError(
            f"columns must be given: by the study's layouts no number up to {MOST} does it "
            f"at {case.speed:g} m/s"
        )
    if not found.worst:
        return found.columns, "the fewest, with nothing unknown"
    return found.columns, f"the fewest with nothing unknown; none do for {cases.SURE} of draws"
