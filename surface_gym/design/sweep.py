"""Runs of a case on one surface while one thing about them is swept."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.case import NOTHING, TOGETHER, WORST, Case, Draws, Unknown, draw
from surface_gym.design.columns import MOST, Columns, least_columns
from surface_gym.design.line import DesignLine
from surface_gym.design.purposes import Layout
from surface_gym.design.runs import Ends, Runs, run_all
from surface_gym.design.sending import Advance
from surface_gym.sharing import Workers, check_workers

NOMINAL = "nominal"  # beside the groups: everything as it is said to be

Booleans = NDArray[np.bool_]
Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A case's parcel on a line of which the first columns are turned, by one of its layouts."""

    case: Case
    line: DesignLine  # with as many columns as `least_columns` tries, so that draws are the same
    layout: Layout
    columns: int  # that are turned
    chosen: str  # why so many

    @property
    def passed(self) -> int:
        """Columns behind which a run is over: of the zone, and of a run-out where it may help."""
        return self.columns + (0 if self.case.purpose.leaves_zone else self.line.run_out)

    def drawn(self, unknown: Unknown) -> Draws:
        """What is not known, drawn; one draw where nothing is unknown."""
        count = self.case.draws if unknown.groups else 1
        return draw(unknown, self.case.parcel, self.line, count, self.case.seed)

    def run(self, drawn: Draws, runs: Runs, workers: Workers, advance: Advance) -> Ends:
        """Carry out runs of draws over the layout."""
        return run_all(
            self.line, self.layout.axis[np.newaxis], drawn.parcels, runs, drawn.stiffness,
            self.case.step, workers, advance,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Conditions:
    """What is swept: a row a value."""

    speed: Numbers  # (values,) [m/s]
    tilt: Numbers  # (values,) [rad]
    friction: Numbers  # (values, 3) [-] factors of mu_max, mu_min and mu_support

    def __len__(self) -> int:
        return len(self.speed)


class Tally:
    """Adds up the runs of several calls of `run_all`, for one `advance`."""

    def __init__(self, advance: Advance, total: int) -> None:
        self._advance = advance
        self._total = total
        self._before = 0

    def part(self, count: int) -> Advance:
        """The `advance` of the next call, which has so many runs."""
        before = self._before
        self._before += count
        return lambda done, _: self._advance(before + done, self._total)


def arrange(
    case: Case, columns: int | None = None, rows: int | None = None, workers: Workers = 1
) -> Arrangement:
    """The surface on which a case is swept.

    Args:
        case: what it is for.
        columns: of the zone; None: the fewest that do it in all but `WORST` of the draws of all
            that is unknown, else the fewest that do it where nothing is.
        rows: of rotors; None: as many as lie under the parcel.
        workers: threads that share the runs, or a cluster.

    Returns:
        Of the purpose's layouts with so many columns, the one that does it where nothing is
        unknown, and if several do, in the most draws.

    Raises:
        ValueError: `columns` is None and no number of them does it, or is below 1.
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
    return max(tried, key=lambda each: _merit(each, workers)) if len(tried) > 1 else tried[0]


def shares(
    arrangement: Arrangement,
    drawn: Draws,
    conditions: Conditions,
    workers: Workers = 1,
    advance: Advance = lambda *_: None,
) -> Numbers:
    """(values,) share of the draws that do what is asked, the same draws at every value."""
    runs = join(
        [
            _at(arrangement, drawn, float(speed), float(tilt), factors)
            for speed, tilt, factors in zip(
                conditions.speed, conditions.tilt, conditions.friction, strict=True
            )
        ]
    )
    ends = arrangement.run(drawn, runs, workers, advance)
    done = arrangement.case.purpose.succeeds(arrangement.line, runs, ends)
    share: Numbers = done.reshape(len(conditions), len(drawn)).mean(axis=1)
    return share


def own_conditions(case: Case, count: int = 1) -> Conditions:
    """A case's own, so many times."""
    return Conditions(
        speed=np.full(count, case.speed),
        tilt=np.full(count, case.tilt),
        friction=np.ones((count, 3)),
    )


def join(runs: list[Runs]) -> Runs:
    """Runs one after the other."""
    names = Runs.__dataclass_fields__
    return Runs(**{name: np.concatenate([getattr(each, name) for each in runs]) for name in names})


def groups_of(unknown: Unknown) -> dict[str, Unknown]:
    """Nothing unknown, each group that varies alone, and all of them together, by name."""
    return {NOMINAL: NOTHING, **{group: unknown.only(group) for group in unknown.groups}}


def span(done: Booleans, own: int) -> tuple[int, int] | None:
    """First and last place of the run of successes around a place; None: it fails there."""
    if not done[own]:
        return None
    fails = np.nonzero(~done)[0]
    below, above = fails[fails < own], fails[fails > own]
    first = int(below[-1]) + 1 if len(below) else 0
    last = int(above[0]) - 1 if len(above) else len(done) - 1
    return first, last


def _fewest(case: Case, found: Columns) -> tuple[int, str]:
    together = next((worst.columns for worst in found.worst if worst.group == TOGETHER), None)
    if together is not None:
        return together, f"the fewest for {1.0 - WORST:.0%} of the draws"
    if found.columns is None:
        raise ValueError(
            f"columns must be given: by the study's layouts no number up to {MOST} does it "
            f"at {case.speed:g} m/s"
        )
    if not found.worst:
        return found.columns, "the fewest, with nothing unknown"
    return found.columns, f"the fewest with nothing unknown; none do for {1.0 - WORST:.0%} of draws"


def _merit(arrangement: Arrangement, workers: Workers) -> tuple[float, float]:
    """Success where nothing is unknown, and the share of draws where all is."""
    at = own_conditions(arrangement.case)
    known, drawn = (
        float(shares(arrangement, arrangement.drawn(unknown), at, workers)[0])
        for unknown in (NOTHING, arrangement.case.unknown)
    )
    return known, drawn


def _at(
    arrangement: Arrangement, drawn: Draws, speed: float, tilt: float, factors: Numbers
) -> Runs:
    runs = drawn.runs(speed, tilt, arrangement.passed)
    return replace(runs, friction=runs.friction * factors)
