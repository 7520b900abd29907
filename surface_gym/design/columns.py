"""How many columns and rows a purpose takes: Tables 3 and 4 for a parcel of one's own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.case import WORST, Case, Draws, draw, enough
from surface_gym.design.line import DesignLine
from surface_gym.design.runs import make_runs, run_all
from surface_gym.sharing import Workers

MOST = 30  # columns that are tried
MORE = 3  # columns beyond the nominal ones that are tried for the worst draws

Booleans = NDArray[np.bool_]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Worst:
    """What it takes where something is not known."""

    group: str  # of `case.GROUPS`, or `TOGETHER`
    columns: int | None  # enough for all but `WORST` of the draws; None: none are
    success: float  # share of the draws in which the nominal columns are enough


@dataclass(frozen=True)
class Columns:
    """The fewest columns of a line with so many rows."""

    rows: int  # of rotors in the line
    columns: int | None  # of the zone; None: no number of them is enough
    layout: str  # of the zone's axes
    # Sort: columns beyond which the parcel touches none, as Table 3 counts, are `columns`; with
    # these it is sorted as well, over columns that roll again. Else the same.
    fewest: int | None
    measure: float  # what comes out, by the purpose's `measured`; nan: nothing
    tipping: float  # [-] share of the steps in which a real parcel would tip
    worst: tuple[Worst, ...]

    @property
    def modules(self) -> int | None:
        """Modules whose axes are turned."""
        return None if self.columns is None else self.rows * self.columns


def least_columns(
    case: Case, rows: int | None = None, most: int = MOST, workers: Workers = 1
) -> Columns:
    """The fewest columns that do what a case asks, by the study's kinds of layout.

    Args:
        case: what it is for.
        rows: of rotors; None: as many as lie under the parcel.
        most: columns to try.
        workers: threads that share the runs, or a cluster.

    >>> from surface_gym import layouts
    >>> least_columns(Case(layouts.box("S"), speed=1.5)).columns  # Table 3: 4, by a coarser step
    5
    """
    checks.integer("most", most, least=1)
    line = case.line(most, rows)
    if case.purpose.leaves_zone:
        return _leaving(case, line, workers)
    return _sorting(case, line, workers)


def columns_by_rows(case: Case, most: int = MOST, workers: Workers = 1) -> tuple[Columns, ...]:
    """`least_columns` for every number of rows from one to as many as lie under the parcel."""
    return tuple(
        least_columns(case, rows, most, workers) for rows in range(1, case.line(most).rows + 1)
    )


def columns_by_speed(
    case: Case,
    speeds: Sequence[float],
    rows: int | None = None,
    most: int = MOST,
    workers: Workers = 1,
) -> tuple[Columns, ...]:
    """`least_columns` at every entry speed [m/s]."""
    return tuple(least_columns(case.at(speed), rows, most, workers) for speed in speeds)


def _sorting(case: Case, line: DesignLine, workers: Workers) -> Columns:
    layout = case.purpose.layouts(line, line.columns)[0]
    axes = layout.axis[np.newaxis]
    runs = make_runs(case.speed, case.tilt)
    ends = run_all(line, axes, [case.parcel], runs, dt=case.step, workers=workers)
    done = bool(case.purpose.succeeds(line, runs, ends)[0])
    touched = int(ends.touched[0])
    worst = []
    for group in case.unknown.groups:
        drawn = draw(case.unknown.only(group), case.parcel, line, case.draws, case.seed)
        over = drawn.runs(case.speed, case.tilt, -1)
        found = run_all(line, axes, drawn.parcels, over, drawn.stiffness, case.step, workers)
        needed = np.where(case.purpose.succeeds(line, over, found), found.touched, line.columns + 1)
        enough = int(np.sort(needed)[_least_place(len(needed))])
        worst.append(
            Worst(
                group,
                enough if enough <= line.columns else None,
                float(np.mean(needed <= touched)) if done else 0.0,
            )
        )
    return Columns(
        rows=line.rows,
        columns=touched if done else None,
        layout=layout.name,
        fewest=_fewest(case, line, touched, workers) if done else None,
        measure=float(case.purpose.measure(line, runs, ends)[0]),
        tipping=float(ends.tipping[0]),
        worst=tuple(worst),
    )


def _least_place(draws: int) -> int:
    """Place, among sorted draws, of the one that all but `WORST` of them do not exceed."""
    return int(np.ceil((1.0 - WORST) * draws - 1e-9)) - 1


def _fewest(case: Case, line: DesignLine, touched: int, workers: Workers) -> int:
    """Columns from which on every number up to those touched sorts."""
    counts = np.arange(1, touched + 1)
    axes = np.stack([case.purpose.layouts(line, count)[0].axis for count in counts.tolist()])
    runs = make_runs(case.speed, case.tilt, layout=counts - 1)
    ends = run_all(line, axes, [case.parcel], runs, dt=case.step, workers=workers)
    fails = np.nonzero(~case.purpose.succeeds(line, runs, ends))[0]
    return int(counts[fails[-1] + 1]) if len(fails) else 1


def _leaving(case: Case, line: DesignLine, workers: Workers) -> Columns:
    """Of every number of columns and every kind of layout, the first that does it."""
    counts = list(range(1, line.columns + 1))
    kinds = [case.purpose.layouts(line, count) for count in counts]
    layouts = [layout for kind in kinds for layout in kind]
    used = np.repeat(counts, len(kinds[0]))
    axes = np.stack([layout.axis for layout in layouts])
    runs = make_runs(case.speed, case.tilt, layout=np.arange(len(layouts)), columns=used)
    ends = run_all(line, axes, [case.parcel], runs, dt=case.step, workers=workers)
    done = case.purpose.succeeds(line, runs, ends)
    measure = case.purpose.measure(line, runs, ends)
    if not done.any():
        lost = tuple(Worst(group, None, 0.0) for group in case.unknown.groups)
        return Columns(line.rows, None, "-", None, float("nan"), 0.0, lost)
    first = int(done.argmax())
    worst = [
        _worst_leaving(case, line, axes, used, first, group, workers)
        for group in case.unknown.groups
    ]
    return Columns(
        rows=line.rows,
        columns=int(used[first]),
        layout=layouts[first].name,
        fewest=int(used[first]),
        measure=float(measure[first]),
        tipping=float(ends.tipping[first]),
        worst=tuple(worst),
    )


def _worst_leaving(
    case: Case, line: DesignLine, axes: Numbers, used: NDArray[np.int64], first: int, group: str,
    workers: Workers,
) -> Worst:  # fmt: skip
    """From the nominal layout on, the first that is enough in all but `WORST` of the draws."""
    drawn = draw(case.unknown.only(group), case.parcel, line, case.draws, case.seed)
    share = _share(case, line, axes, used, first, drawn, workers)
    least, at_nominal = first, share
    while not enough(share):
        least += 1
        if least == len(used) or used[least] > used[first] + MORE:
            return Worst(group, None, at_nominal)
        share = _share(case, line, axes, used, least, drawn, workers)
    return Worst(group, int(used[least]), at_nominal)


def _share(
    case: Case, line: DesignLine, axes: Numbers, used: NDArray[np.int64], which: int, drawn: Draws,
    workers: Workers,
) -> float:  # fmt: skip
    """Of the draws in which a layout does it."""
    runs = drawn.runs(case.speed, case.tilt, int(used[which]), which)
    ends = run_all(line, axes, drawn.parcels, runs, drawn.stiffness, case.step, workers)
    return float(case.purpose.succeeds(line, runs, ends).mean())
