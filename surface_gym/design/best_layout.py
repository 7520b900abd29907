"""The best fixed layout for a purpose: one for all entry speeds, beside the study's."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.case import TOGETHER, Case, draw, enough
from surface_gym.design.line import DesignLine
from surface_gym.design.purposes import Purpose, Sort
from surface_gym.design.runs import LONGEST, Ends, Runs, make_runs, run_all
from surface_gym.design.search import Effort, Score, search
from surface_gym.design.shortfall import shortfall
from surface_gym.design.space import Space
from surface_gym.layouts import ROLLING
from surface_gym.lines import ORIENTATIONS
from surface_gym.sharing import Workers, check_workers

Booleans = NDArray[np.bool_]
Numbers = NDArray[np.float64]

NEAR, HASTE = 0.9, 0.09  # [-] of a speed's success: what shortfall and time may cost, at most


@dataclass(frozen=True, eq=False)
class OverSpeeds:
    """A layout, and what it does over entry speeds."""

    name: str
    axis: Numbers  # (rows, columns) [rad] of the zone
    speeds: Numbers  # (speeds,) [m/s], rising
    success: Booleans  # (speeds,) with nothing unknown
    time: Numbers  # (speeds,) [s] of the run
    measure: Numbers  # (speeds,) what comes out, by the purpose's `measured`; nan: nothing
    share: Numbers  # (speeds,) [-] of the draws of what is not known that succeed

    @property
    def successes(self) -> float:
        """[-] share of the speeds at which it succeeds."""
        return float(self.success.mean())

    @property
    def least_speed(self) -> float:
        """[m/s] from which on it succeeds at every speed; nan: not at the greatest."""
        return self._least(self.success)

    @property
    def least_sure_speed(self) -> float:
        """[m/s] from which on it succeeds in all but `WORST` of the draws; nan: never."""
        return self._least(enough(self.share))

    @property
    def mean_time(self) -> float:
        """[s] of the runs that succeed; nan: none."""
        return float(self.time[self.success].mean()) if self.success.any() else math.nan

    def _least(self, done: Booleans) -> float:
        first = len(done) - int(np.cumprod(done[::-1]).sum())
        return float(self.speeds[first]) if first < len(done) else math.nan


@dataclass(frozen=True, eq=False)
class BestLayout:
    """The best fixed layout that was found, beside the best of the study's kinds."""

    case: Case
    line: DesignLine
    best: OverSpeeds
    study: OverSpeeds
    evaluations: int  # layouts compared, each at every speed
    seconds: float  # this call took

    @cached_property
    def changed(self) -> int:
        """Modules that are not as in the study's layout."""
        apart = np.abs(np.sin(self.best.axis - self.study.axis))
        return int((apart > 1e-9).sum())


def best_layout(
    case: Case,
    speeds: Sequence[float] | Numbers,
    columns: int = 16,
    rows: int | None = None,
    orientations: Sequence[float] | None = ORIENTATIONS,
    effort: Effort = Effort(),
    workers: Workers = 1,
    checkpoint: Path | str | None = None,
    advance: Callable[[int, int], None] = lambda *_: None,
) -> BestLayout:
    """Search the axes of a zone for those that do best over all the speeds.

    Better is, first, to succeed at more speeds; then to come nearer to what is asked, by
    `shortfall`; then to take less time. Modules on which nothing depends are as in the study's
    layout. See `search` for the way there and why.

    Args:
        case: what it is for; its own speed does not count.
        speeds: [m/s] at entry.
        columns: of the zone; a parcel past them has failed to be sorted.
        rows: of rotors; None: as many as lie under the parcel.
        orientations: [rad] axes on offer; None: any.
        effort: how long to search.
        workers: threads that share the runs, or a cluster; what is found does not depend on it.
        checkpoint: file that keeps what is found; a search whose file exists goes on from there.
        advance: called with how much of the search is done and how much there is.

    Raises:
        ValueError: an argument that is not allowed, or a checkpoint of another search.
    """
    begun = time.perf_counter()
    checks.integer("columns", columns, least=1)
    check_workers(workers)
    over = np.unique(checks.array("speeds", speeds, (None,)))
    if len(over) == 0 or over[0] <= 0.0:
        raise ValueError(f"speeds must be some above 0, got {over.tolist()}")
    offered = None
    if orientations is not None:
        offered = tuple(sorted(checks.orientations("orientations", np.array(orientations))))
    line = case.line(columns, rows)
    # Of layouts that do alike, the one of the most columns counts as the study's.
    kinds = [kind for used in range(columns, 0, -1) for kind in case.purpose.layouts(line, used)]
    score = _score(case, line, over, workers)
    study = kinds[int(score(np.stack([kind.axis for kind in kinds])).argmin())]
    space = Space(line.rows, columns, offered)
    known = np.stack([*(kind.axis for kind in kinds), *_fans(case.purpose, line)])
    known = np.unique(space.axes(space.members(known)), axis=0)
    first = np.argsort(score(known), kind="stable")[: effort.members // 2]
    axis, evaluations = search(
        space, score, known[first], effort, case.seed, checkpoint, _told(case, over), advance
    )
    axis = _tidied(axis, study.axis, score)
    return BestLayout(
        case=case,
        line=line,
        best=over_speeds("best fixed layout", axis, case, line, over, workers),
        study=over_speeds(study.name, study.axis, case, line, over, workers),
        evaluations=evaluations,
        seconds=time.perf_counter() - begun,
    )


def over_speeds(
    name: str, axis: Numbers, case: Case, line: DesignLine, speeds: Numbers, workers: Workers = 1
) -> OverSpeeds:
    """What a layout (rows, columns) [rad] of a line's zone does over speeds (speeds,) [m/s]."""
    axes = axis[np.newaxis]
    runs, ends = _sent(case, line, axes, speeds, workers)
    success = case.purpose.succeeds(line, runs, ends)
    share = success.astype(np.float64)
    if case.unknown.groups:
        drawn = draw(case.unknown.only(TOGETHER), case.parcel, line, case.draws, case.seed)
        for k, speed in enumerate(speeds.tolist()):
            unsure = drawn.runs(speed, case.tilt, line.columns)
            found = run_all(line, axes, drawn.parcels, unsure, drawn.stiffness, case.step, workers)
            share[k] = case.purpose.succeeds(line, unsure, found).mean()
    return OverSpeeds(
        name=name,
        axis=axis,
        speeds=speeds,
        success=success,
        time=ends.time,
        measure=case.purpose.measure(line, runs, ends),
        share=share,
    )


def _fans(purpose: Purpose, line: DesignLine) -> list[Numbers]:
    """Axes that turn from column to column, by which a parcel is led aside little by little."""
    if not isinstance(purpose, Sort):
        return []
    fans = []
    for turned in np.radians([15.0, 30.0, 45.0, 60.0, 75.0, 90.0]).tolist():
        for over in range(1, line.columns + 1):
            part = np.minimum(1.0, np.arange(1, line.columns + 1) / over)
            column = ROLLING + purpose.side * turned * part
            fans.append(np.tile(column, (line.rows, 1)))
    return fans


def _tidied(axis: Numbers, plain: Numbers, score: Score) -> Numbers:
    """A layout (rows, columns) [rad] with the study's axes wherever that costs nothing."""
    tidy = axis.copy()
    cost = score(tidy[np.newaxis])[0]
    for column in reversed(range(axis.shape[1])):
        for row in range(axis.shape[0]):
            tried = tidy.copy()
            tried[row, column] = plain[row, column]
            if score(tried[np.newaxis])[0] <= cost:
                tidy = tried
    return tidy


def _sent(
    case: Case, line: DesignLine, axes: Numbers, speeds: Numbers, workers: Workers
) -> tuple[Runs, Ends]:
    """A run over every layout (layouts, rows, columns) [rad] at every speed, layout by layout."""
    runs = make_runs(
        speed=np.tile(speeds, len(axes)),
        tilt=case.tilt,
        layout=np.repeat(np.arange(len(axes)), len(speeds)),
        columns=line.columns,
    )
    return runs, run_all(line, axes, [case.parcel], runs, dt=case.step, workers=workers)


def _score(case: Case, line: DesignLine, speeds: Numbers, workers: Workers) -> Score:
    """What a layout costs: a failure more than shortfalls at all speeds, these more than time."""

    def score(axes: Numbers) -> Numbers:
        runs, ends = _sent(case, line, axes, speeds, workers)
        shape = (len(axes), len(speeds))
        failed = ~case.purpose.succeeds(line, runs, ends).reshape(shape)
        short = shortfall(case.purpose, line, runs, ends).reshape(shape)
        time_taken = ends.time.reshape(shape) / LONGEST
        done = np.maximum(1, (~failed).sum(axis=1))
        haste = np.where(failed, 0.0, time_taken).sum(axis=1) / done
        return failed.sum(axis=1) + NEAR * short.mean(axis=1) + HASTE * haste

    return score


def _told(case: Case, speeds: Numbers) -> str:
    """What a search is of."""
    base = case.parcel.base
    outline = (type(base).__name__, base.outline.tolist())
    return f"{case}, of outline {outline}, at speeds {speeds.tolist()}"
