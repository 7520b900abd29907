"""What each thing that is not known does alone."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym.design.case import NOTHING, WORST, Case, Unknown
from surface_gym.design.sending import Advance
from surface_gym.design.sweep import Arrangement, Tally, arrange
from surface_gym.sharing import Workers

# Spreads that a field is drawn with where the case's own is 0.
USUAL = Unknown(
    friction=0.2,
    rolling=0.2,
    mass=0.1,
    com_offset=0.1,
    stiffness=0.35,
    lateral=0.01,
    heading=math.radians(2.0),
    speed=0.05,
    tilt=math.radians(0.2),
)
FIELDS = (
    "friction", "rolling", "com_offset", "mass", "stiffness", "lateral", "heading", "speed", "tilt",
)  # fmt: skip

Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Bar:
    """What comes out where one thing is not known."""

    field: str  # of `Unknown`
    spread: float  # it was drawn with, in the field's unit
    usual: bool  # whether that is `USUAL`'s, as the case's own is 0
    # `WORST` and 1 - `WORST` quantile of the purpose's measure, in SI units, among the draws that
    # have one; nan: none has
    low: float
    high: float
    success: float  # [-] share of the draws that succeed


@dataclass(frozen=True)
class Sensitivity:
    """What each thing that is not known does alone, on one surface."""

    arrangement: Arrangement
    measure: float  # with nothing unknown, in SI units; nan: nothing comes out
    success: bool  # with nothing unknown
    bars: tuple[Bar, ...]  # in the order of `FIELDS`


def sensitivity(
    case: Case,
    columns: int | None = None,
    rows: int | None = None,
    workers: Workers = 1,
    advance: Advance = lambda *_: None,
) -> Sensitivity:
    """What each field of `Unknown` does alone: to what comes out, and to success.

    A field whose spread is 0 in the case is drawn with a usual one, `USUAL`, and marked so.

    Args:
        case: what it is for.
        columns: of the zone; None: as `sweep.arrange` finds them.
        rows: of rotors; None: as many as lie under the parcel.
        workers: threads that share the runs, or a cluster.
        advance: called with how many runs are done and how many there are.

    Raises:
        ValueError: see `sweep.arrange`.
    """
    arrangement = arrange(case, columns, rows, workers)
    tally = Tally(advance, 1 + len(FIELDS) * case.draws)
    measure, success = _outcome(arrangement, NOTHING, workers, tally)
    bars = []
    for name in FIELDS:
        own = getattr(case.unknown, name)
        spread = own or getattr(USUAL, name)
        found, done = _outcome(arrangement, replace(NOTHING, **{name: spread}), workers, tally)
        there = found[~np.isnan(found)]
        low, high = np.quantile(there, (WORST, 1.0 - WORST)) if len(there) else (math.nan, math.nan)
        bars.append(Bar(name, spread, not own, float(low), float(high), float(done.mean())))
    return Sensitivity(arrangement, float(measure[0]), bool(success[0]), tuple(bars))


def _outcome(
    arrangement: Arrangement, unknown: Unknown, workers: Workers, tally: Tally
) -> tuple[Numbers, NDArray[np.bool_]]:
    """(draws,) the purpose's measure of each draw, and whether it succeeds."""
    case, line = arrangement.case, arrangement.line
    drawn = arrangement.drawn(unknown)
    runs = drawn.runs(case.speed, case.tilt, arrangement.passed)
    ends = arrangement.run(drawn, runs, workers, tally.part(len(runs)))
    return case.purpose.measure(line, runs, ends), case.purpose.succeeds(line, runs, ends)
