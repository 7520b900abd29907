"""Whether any fixed layout at all does what is asked at an entry speed, by trying every one.

A zone of two rows and 16 columns has 4^32 layouts, but a parcel knows only of the columns it has
touched: layouts that are alike there are one. So the columns are arranged one after another, and
only where the parcel came farther is there a next one. Slow parcels soon come to rest.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.case import Case
from surface_gym.design.runs import make_runs, run_all
from surface_gym.layouts import ROLLING
from surface_gym.lines import ORIENTATIONS
from surface_gym.sharing import Workers, check_workers

AT_ONCE = 4096  # runs in one go, about

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EveryLayout:
    """What came of trying every layout."""

    speed: float  # [m/s] at entry
    axis: Numbers | None  # (rows, columns) [rad] of one that does what is asked; None: none does
    complete: bool  # one was found, or every one was tried: else it is not known
    runs: int  # carried out


def every_layout(
    case: Case,
    columns: int = 16,
    rows: int | None = None,
    orientations: Sequence[float] = ORIENTATIONS,
    most: int = 1_000_000,
    workers: Workers = 1,
    advance: Callable[[int, int], None] = lambda *_: None,
) -> EveryLayout:
    """Try every layout of a zone at the case's speed, with nothing unknown, until one does it.

    Args:
        case: what it is for.
        columns: of the zone; a parcel past them has failed to be sorted.
        rows: of rotors; None: as many as lie under the parcel.
        orientations: [rad] axes on offer.
        most: runs to carry out, about; then the answer is not known.
        workers: threads that share the runs, or a cluster.
        advance: called with how many runs were carried out, and `most`.

    Raises:
        ValueError: an argument that is not allowed.

    >>> from surface_gym import layouts
    >>> every_layout(Case(layouts.box("S"), speed=0.6)).axis is None  # no layout sorts it
    True
    """
    checks.integer("columns", columns, least=1)
    checks.integer("most", most, least=1)
    check_workers(workers)
    offered = np.array(checks.orientations("orientations", np.array(orientations)))
    line = case.line(columns, rows)
    count = len(offered) ** line.rows
    if count > most:
        raise ValueError(f"most must be at least the {count} arrangements of a column, got {most}")
    one_column = offered[np.array(list(itertools.product(range(len(offered)), repeat=line.rows)))]
    open_ends = np.full((1, line.rows, columns), ROLLING)
    done = 0
    for column in range(columns):
        further = []
        share = max(1, AT_ONCE // count)
        for first in range(0, len(open_ends), share):
            own = open_ends[first : first + share]
            axes = np.repeat(own, count, axis=0)
            axes[:, :, column] = np.tile(one_column, (len(own), 1))
            if done + len(axes) > most:
                return EveryLayout(case.speed, None, False, done)
            runs = make_runs(case.speed, case.tilt, layout=np.arange(len(axes)), columns=columns)
            ends = run_all(line, axes, [case.parcel], runs, dt=case.step, workers=workers)
            done += len(axes)
            advance(done, most)
            # What a parcel does that touched no more columns is the same whatever these are.
            final = (ends.touched <= column + 1) | (column + 1 == columns)
            found = np.nonzero(final & case.purpose.succeeds(line, runs, ends))[0]
            if len(found):
                return EveryLayout(case.speed, axes[found[0]], True, done)
            further.append(axes[~final])
        open_ends = np.concatenate(further)
        if not len(open_ends):
            break
    return EveryLayout(case.speed, None, True, done)
