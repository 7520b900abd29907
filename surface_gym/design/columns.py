"""Numbers of columns and rows that a purpose needs: the study's Tables 3 and 4 for any parcel."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surface_gym import checks, parallel
from surface_gym.design import case as cases
from surface_gym.design.case import SURE, TOGETHER, WORST, Case, Purpose, is_reliable
from surface_gym.design.runs import DesignLine, OnProgress, make_runs
from surface_gym.physics.types import Array, Integers

MOST = 30  # maximum number of columns to try
MORE = 3  # additional columns to try for the worst draws
SPEED_STEP = 0.1  # [m/s] between the speeds of a report


@dataclass(frozen=True)
class Worst:
    """Number of columns for a purpose if a group of quantities, e.g. friction, is unknown."""

    group: str  # key of `case.GROUPS`, or `TOGETHER`
    columns: int | None  # sufficient for all but `WORST` of the draws; None: no number suffices
    success: float  # share of draws for which the nominal columns suffice


@dataclass(frozen=True)
class Columns:
    """Smallest number of columns that suffices on a line with `rows` rows of rotors."""

    rows: int  # rows of rotors
    columns: int | None  # columns of the zone; None: no number suffices
    layout: str  # name of the zone's layout
    # Sort: `columns` is the last touched column as in Table 3. But `fewest` columns suffice: the
    # parcel rolls on behind them and is sorted, too. Other purposes: equal to `columns`.
    fewest: int | None
    measure: float  # see `Purpose.measure`; NaN: none
    tipping: float  # [-] share of the steps in which a real parcel would tip
    worst: tuple[Worst, ...]

    @property
    def modules(self) -> int | None:
        return None if self.columns is None else self.rows * self.columns

    @property
    def together(self) -> Worst | None:
        """Columns needed if all unknown quantities vary at once, or None if nothing is unknown."""
        return next((worst for worst in self.worst if worst.group == TOGETHER), None)


def least_columns(
    case: Case, rows: int | None = None, most: int = MOST, workers: parallel.Workers = 1
) -> Columns:
    """Find the fewest columns, at most `most`, with which one of the study's layouts succeeds.

    If the purpose is sorting, the result counts all columns that the parcel touches, as the study
    counts in Table 3. The method `line_for` chooses the default number of rows. `workers` is either
    a number of threads or a cluster.

    >>> from surface_gym import layouts
    >>> least_columns(Case(layouts.box("S"), speed=1.5)).columns  # in the study: 4
    5
    """
    checks.integer("most", most, least=1)
    line = case.line(most, rows)
    return (_leaving if case.purpose.leaves_zone else _sorting)(case, line, workers)


def _sorting(case: Case, line: DesignLine, workers: parallel.Workers) -> Columns:
    """Count the zone's columns that the parcel touches until the parcel is off the line."""
    layout = case.purpose.layouts(line, line.columns)[0]
    axes = layout.axis[np.newaxis]
    runs = make_runs(case.speed, case.tilt)
    ends = case.run(line, axes, runs, workers=workers)
    done = bool(case.purpose.succeeds(ends)[0])
    touched = int(ends.touched[0])
    # index of the reliable draw in ascending order
    last = int(np.ceil((1.0 - WORST) * case.draws - 1e-9)) - 1
    worst = []
    for group in case.unknown.groups:
        drawn = case.draw(line, case.unknown.only(group))
        over = drawn.runs(case.speed, case.tilt, -1)
        found = case.run(line, axes, over, drawn, workers)
        needed = np.where(case.purpose.succeeds(found), found.touched, line.columns + 1)
        enough = int(np.sort(needed)[last])
        success = float(np.mean(needed <= touched)) if done else 0.0
        worst.append(Worst(group, enough if enough <= line.columns else None, success))
    return Columns(
        rows=line.rows,
        columns=touched if done else None,
        layout=layout.name,
        fewest=_fewest(case, line, touched, workers) if done else None,
        measure=float(case.purpose.measure(ends)[0]),
        tipping=float(ends.tipping[0]),
        worst=tuple(worst),
    )


def _fewest(case: Case, line: DesignLine, touched: int, workers: parallel.Workers) -> int:
    """Return the least n such that all zones with n, ..., `touched` columns sort the parcel."""
    counts = np.arange(1, touched + 1)
    axes = np.stack([case.purpose.layouts(line, count)[0].axis for count in counts.tolist()])
    runs = make_runs(case.speed, case.tilt, layout=counts - 1)
    ends = case.run(line, axes, runs, workers=workers)
    fails = np.nonzero(~case.purpose.succeeds(ends))[0]
    return int(counts[fails[-1] + 1]) if len(fails) else 1


def _leaving(case: Case, line: DesignLine, workers: parallel.Workers) -> Columns:
    """Try the study's layouts with 1, 2, ... columns; describe the first successful layout."""
    counts = list(range(1, line.columns + 1))
    kinds = [case.purpose.layouts(line, count) for count in counts]
    layouts = [layout for kind in kinds for layout in kind]
    used = np.repeat(counts, len(kinds[0]))
    axes = np.stack([layout.axis for layout in layouts])
    runs = make_runs(case.speed, case.tilt, layout=np.arange(len(layouts)), columns=used)
    ends = case.run(line, axes, runs, workers=workers)
    done = case.purpose.succeeds(ends)
    if not done.any():
        lost = tuple(Worst(group, None, 0.0) for group in case.unknown.groups)
        return Columns(line.rows, None, "-", None, math.nan, 0.0, lost)
    first = int(done.argmax())
    groups = case.unknown.groups
    worst = [_worst_leaving(case, line, axes, used, first, group, workers) for group in groups]
    return Columns(
        rows=line.rows, columns=int(used[first]), layout=layouts[first].name,
        fewest=int(used[first]), measure=float(case.purpose.measure(ends)[first]),
        tipping=float(ends.tipping[first]), worst=tuple(worst),
    )  # fmt: skip


def _worst_leaving(
    case: Case, line: DesignLine, axes: Array, used: Integers, first: int, group: str,
    workers: parallel.Workers,
) -> Worst:  # fmt: skip
    """Find the number of columns of the first reliable layout in `axes`.

    A layout is reliable if it succeeds in 95 % of the draws. These draws vary only the unknown
    quantities in `group`. The search begins with layout `first`, the first layout that succeeds
    with nominal values. `used` (layouts,) holds the number of columns per layout.
    """
    drawn = case.draw(line, case.unknown.only(group))

    def share(which: int) -> float:
        runs = drawn.runs(case.speed, case.tilt, int(used[which]), which)
        ends = case.run(line, axes, runs, drawn, workers)
        return float(case.purpose.succeeds(ends).mean())

    at_nominal = share(first)
    most = used[first] + MORE
    success = at_nominal
    while not is_reliable(success):
        first += 1
        if first == len(used) or used[first] > most:
            return Worst(group, None, at_nominal)
        success = share(first)
    return Worst(group, int(used[first]), at_nominal)


@dataclass(frozen=True, eq=False)
class ColumnsReport(cases.Answer):
    """The fewest columns of a case, for several numbers of rows and for several entry speeds."""

    case: Case
    by_rows: tuple[Columns, ...]  # the last entry has the chosen rows
    speeds: tuple[float, ...]  # [m/s]
    by_speed: tuple[Columns, ...]

    name = "columns"

    @property
    def own(self) -> Columns:
        return self.by_rows[-1]

    @property
    def sentence(self) -> str:
        case, own = self.case, self.own
        purpose = f"to {case.purpose.action}"
        parcel = f"A {case.parcel_text} {case.entry_text}"
        if own.columns is None:
            return (
                f"{parcel}: no number of columns up to {MOST} suffices {purpose}, by the study's "
                "layouts"
            )
        needs = (
            f"{parcel}: {cases.plural(own.columns, 'column')} of {own.rows} rows ({own.modules} "
            f"modules at {own.layout}) suffice {purpose}"
        )
        if own.together is None:
            return needs
        if own.together.columns is None:
            success = f"{own.together.success:.0%}"
            return f"{needs}; no number suffices for {SURE} of the draws (these: {success})"
        return f"{needs}; {own.together.columns} suffice for {SURE} of the draws"

    def tables(self) -> tuple[cases.ReportTable, ...]:
        purpose, own = self.case.purpose, self.own
        together = [each.group for each in own.worst[-1:]]
        groups = [each.group for each in own.worst]
        return (
            cases.ReportTable(
                "columns",
                f"With {own.rows} rows",
                (
                    "unknown",
                    "columns it takes",
                    f"success with {'-' if own.columns is None else own.columns}",
                ),
                (
                    ("nothing", own.columns, float(own.columns is not None)),
                    *(
                        (cases.group_label(each.group), each.columns, each.success)
                        for each in own.worst
                    ),
                ),
            ),
            cases.ReportTable(
                "columns_by_rows",
                "By the rows of the line",
                _header(purpose, together),
                tuple(_row(purpose, each, together) for each in self.by_rows),
            ),
            cases.ReportTable(
                "columns_by_speed",
                "By entry speed",
                ("speed [m/s]", *_header(purpose, groups)),
                tuple(
                    (speed, *_row(purpose, each, groups))
                    for speed, each in zip(self.speeds, self.by_speed, strict=True)
                ),
                shown=False,
            ),
        )

    def draw(self) -> "cases.Figure":
        """Draw the number of columns needed at each entry speed if all quantities are known.

        A band above this curve shows how many columns suffice for 95 % of the random cases.
        """
        from matplotlib.ticker import MaxNLocator

        case, own = self.case, self.own
        figure, axes = cases.new_panel(
            f"How many columns to {case.purpose.action}?",
            f"{case.parcel_text}, {own.rows} rows, the study's layouts",
        )
        speed = np.array(self.speeds)
        needed, worst = (
            np.array([math.nan if count is None else count for count in counts], dtype=np.float64)
            for counts in (
                [each.columns for each in self.by_speed],
                [(each.together or each).columns for each in self.by_speed],
            )
        )
        axes.fill_between(
            speed, needed, worst, step="mid", color=cases.BLUE, alpha=0.2, linewidth=0.0,
            label=f"more for {SURE} of the draws",
        )  # fmt: skip
        axes.step(speed, worst, where="mid", color=cases.BLUE, linestyle="--", linewidth=1.0)
        axes.step(
            speed, needed, where="mid", color=cases.BLUE, linewidth=2.0, marker=".",
            label="nothing unknown",
        )  # fmt: skip
        top = max(4.0, 1.1 * float(np.nanmax([*needed, *worst, 1.0])))
        lost = np.isnan(needed)
        axes.plot(
            speed[lost], np.full(lost.sum(), 0.5), "x", color=cases.ORANGE, clip_on=False,
            label=f"no number up to {MOST}",
        )  # fmt: skip
        unsure = ~lost & np.isnan(worst)
        axes.plot(
            speed[unsure], needed[unsure], "o", color=cases.ORANGE, fillstyle="none", markersize=9,
            label=f"none does it in {SURE} of the draws",
        )  # fmt: skip
        if own.columns is not None:
            axes.plot(
                case.speed, own.columns, "*", color="black", markersize=13, label="as it comes"
            )
        axes.set(xlabel="entry speed [m/s]", ylabel="columns of the zone")
        axes.set(ylim=(0.0, top), xlim=(0.0, None))
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        figure.legend(**cases.legend_of_drawn(axes), loc="outside lower center", ncols=3)
        return figure


def columns_report(
    case: Case, rows: int | None = None, workers: parallel.Workers = 1,
    on_progress: OnProgress = lambda *_: None,
) -> ColumnsReport:  # fmt: skip
    """Find the least number of columns for each number of rows, and for each entry speed.

    If `rows` is given, only this number of rows is used.
    """
    several = range(1, case.line(MOST).rows + 1) if rows is None else [rows]
    by_rows = tuple(least_columns(case, each, workers=workers) for each in several)
    top = max(3.0, 1.5 * case.speed)
    speeds = (SPEED_STEP * np.arange(1, round(top / SPEED_STEP) + 1)).round(9).tolist()
    by_speed = []
    for done, speed in enumerate(speeds):
        on_progress(done, len(speeds))
        by_speed.append(least_columns(replace(case, speed=speed), rows, workers=workers))
    return ColumnsReport(case, by_rows, tuple(speeds), tuple(by_speed))


def _header(purpose: Purpose, groups: Sequence[str]) -> tuple[str, ...]:
    worst = [(f"for {SURE} of draws, {group}", f"success, {group}") for group in groups]
    return (
        "rows", "columns", "modules", "axes", f"{purpose.measured} [{purpose.unit}]",
        "steps that tip", *(name for pair in worst for name in pair),
    )  # fmt: skip


def _row(purpose: Purpose, found: Columns, groups: Sequence[str]) -> tuple[cases.Cell, ...]:
    worst = [(each.columns, each.success) for each in found.worst if each.group in groups]
    return (
        found.rows, found.columns, found.modules, found.layout, purpose.scale * found.measure,
        found.tipping, *(value for pair in worst for value in pair),
    )  # fmt: skip
