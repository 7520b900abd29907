"""How slow or fast a parcel may come, how flat or steep the surface, how far friction may be off.

All on one surface, whose columns stand.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.case import Case, Unknown, enough
from surface_gym.design.sending import Advance
from surface_gym.design.sweep import (
    Arrangement,
    Conditions,
    Tally,
    arrange,
    groups_of,
    own_conditions,
    shares,
    span,
)
from surface_gym.sharing import Workers

SPEED_STEP, SPEED_STEP_DRAWN = 0.01, 0.02  # [m/s] with nothing unknown, and with draws
TILT_STEP, TILT_STEP_DRAWN = math.radians(0.1), math.radians(0.2)  # [rad]
FACTOR_RANGE = 16.0  # [-] friction is tried from one over this to this times what it is
FACTOR_PARTS, FACTOR_PARTS_DRAWN = 48, 8  # factors to a doubling, likewise

Numbers = NDArray[np.float64]
Vary = Callable[[Numbers], Conditions]


@dataclass(frozen=True, eq=False)
class Span:
    """Between which values the purpose is met."""

    group: str  # of what is unknown: `sweep.NOMINAL`, of `case.GROUPS`, or `TOGETHER`
    # Every tried value from the least to the most succeeds, the case's own among them; in all but
    # `WORST` of the draws. None: not even its own does.
    least: float | None
    most: float | None
    values: Numbers  # (values,) that were tried
    share: Numbers  # (values,) of the draws that succeed


@dataclass(frozen=True, eq=False)
class Limits:
    """Between which values of one quantity the purpose is met."""

    varied: str  # what the quantity is
    unit: str
    scale: float  # from SI to `unit`
    own: float  # the case's own value; values are in SI units
    arrangement: Arrangement
    spans: tuple[Span, ...]  # with nothing unknown first, with all of it last

    def of(self, group: str) -> Span:
        """The span of a group.

        Raises:
            ValueError: there is no such group, or nothing varies in it.
        """
        checks.one_of("group", group, [each.group for each in self.spans])
        return next(each for each in self.spans if each.group == group)


@dataclass(frozen=True, eq=False)
class FrictionRange:
    """Between which factors on friction the purpose is met, one coefficient at a time."""

    along: Limits  # of mu_max
    across: Limits  # of mu_min


def least_speed(
    case: Case,
    columns: int | None = None,
    rows: int | None = None,
    highest: float | None = None,
    workers: Workers = 1,
    advance: Advance = lambda *_: None,
) -> Limits:
    """How slow a parcel may come, and how fast, at the case's tilt.

    Args:
        case: what it is for, with an entry speed that is to be among those that succeed.
        columns: of the zone; None: as `sweep.arrange` finds them.
        rows: of rotors; None: as many as lie under the parcel.
        highest: [m/s] entry speed to try; None: 3, or half as much again as the case's.
        workers: threads that share the runs, or a cluster.
        advance: called with how many runs are done and how many there are.

    Returns:
        Speeds [m/s], every 0.01 with nothing unknown, every 0.02 with draws.

    Raises:
        ValueError: `highest` is below the case's speed or above 20, or see `sweep.arrange`.

    >>> from surface_gym import layouts
    >>> from surface_gym.design.case import NOTHING
    >>> case = Case(layouts.box("S"), speed=1.2, unknown=NOTHING)
    >>> least_speed(case).spans[0].least  # as the study has it
    0.72
    """
    top = min(20.0, max(3.0, 1.5 * case.speed)) if highest is None else highest
    checks.within("highest", top, max(case.speed, SPEED_STEP_DRAWN), 20.0)
    arrangement = arrange(case, columns, rows, workers)
    lowest = 0.0 if case.tilt else None

    def at(speeds: Numbers) -> Conditions:
        return replace(own_conditions(case, len(speeds)), speed=speeds)

    grids = [_grid(step, top, case.speed, lowest) for step in (SPEED_STEP, SPEED_STEP_DRAWN)]
    return _limits(
        arrangement, ("entry speed", "m/s", 1.0), case.speed, grids, case.unknown, at, workers,
        advance,
    )  # fmt: skip


def least_tilt(
    case: Case,
    columns: int | None = None,
    rows: int | None = None,
    highest: float | None = None,
    workers: Workers = 1,
    advance: Advance = lambda *_: None,
) -> Limits:
    """How flat the surface may be, and how steep, at the case's entry speed, which may be 0.

    Args:
        case: what it is for, with a tilt that is to be among those that succeed.
        columns: of the zone; None: as `sweep.arrange` finds them.
        rows: of rotors; None: as many as lie under the parcel.
        highest: [rad] tilt to try; None: 15 deg, or half as much again as the case's.
        workers: threads that share the runs, or a cluster.
        advance: called with how many runs are done and how many there are.

    Returns:
        Tilts [rad], every 0.1 deg with nothing unknown, every 0.2 deg with draws.

    Raises:
        ValueError: `highest` is below the case's tilt or not below 45 deg, or see `sweep.arrange`.
    """
    steepest = math.radians(44.0)
    usual = max(math.radians(15.0), 1.5 * case.tilt, case.tilt)
    top = max(case.tilt, min(steepest, usual)) if highest is None else highest
    if not max(case.tilt, TILT_STEP_DRAWN) <= checks.number("highest", top) < math.pi / 4:
        raise ValueError(
            f"highest must be from the case's tilt, {case.tilt:g}, to below pi/4 (45 deg), "
            f"got {top!r}"
        )
    arrangement = arrange(case, columns, rows, workers)
    lowest = 0.0 if case.speed else None

    def at(tilts: Numbers) -> Conditions:
        return replace(own_conditions(case, len(tilts)), tilt=tilts)

    grids = [_grid(step, top, case.tilt, lowest) for step in (TILT_STEP, TILT_STEP_DRAWN)]
    return _limits(
        arrangement, ("tilt", "deg", 180.0 / math.pi), case.tilt, grids, case.unknown, at, workers,
        advance,
    )  # fmt: skip


def friction_range(
    case: Case,
    columns: int | None = None,
    rows: int | None = None,
    workers: Workers = 1,
    advance: Advance = lambda *_: None,
) -> FrictionRange:
    """How far friction may be off, everywhere alike: mu_max along the axes, then mu_min across.

    Args:
        case: what it is for; what is unknown of friction is left out of the draws.
        columns: of the zone; None: as `sweep.arrange` finds them.
        rows: of rotors; None: as many as lie under the parcel.
        workers: threads that share the runs, or a cluster.
        advance: called with how many runs are done and how many there are.

    Returns:
        Factors [-] from 1/16 to 16, 48 to a doubling; 8 with draws.

    Raises:
        ValueError: see `sweep.arrange`.
    """
    arrangement = arrange(case, columns, rows, workers)
    unknown = replace(case.unknown, friction=0.0, rolling=0.0)
    grids = [_factors(parts) for parts in (FACTOR_PARTS, FACTOR_PARTS_DRAWN)]
    found = []
    for place, name in enumerate(("mu_max", "mu_min")):
        told = (f"factor on {name}", "-", 1.0)

        def at(values: Numbers, place: int = place) -> Conditions:
            own = own_conditions(case, len(values))
            own.friction[:, place] = values
            return own

        def half(done: int, total: int, place: int = place) -> None:
            advance(place * total + done, 2 * total)

        found.append(_limits(arrangement, told, 1.0, grids, unknown, at, workers, half))
    return FrictionRange(*found)


def _grid(step: float, top: float, own: float, lowest: float | None) -> Numbers:
    """Multiples of a step, and a case's own value; `lowest` None: 0 is none of them."""
    multiples = step * np.arange(0 if lowest is not None else 1, round(top / step) + 1)
    return np.unique(np.append(multiples[np.abs(multiples - own) > 0.01 * step].round(9), own))


def _factors(parts: int) -> Numbers:
    """From one over `FACTOR_RANGE` to it, so many to a doubling; 1 in the middle."""
    most = round(math.log2(FACTOR_RANGE)) * parts
    factors: Numbers = 2.0 ** (np.arange(-most, most + 1) / parts)
    return factors


def _limits(
    arrangement: Arrangement,
    told: tuple[str, str, float],
    own: float,
    grids: list[Numbers],
    unknown: Unknown,
    at: Vary,
    workers: Workers,
    advance: Advance,
) -> Limits:
    """The span of each group, over the first grid where nothing is unknown, else the second."""
    groups = {group: arrangement.drawn(each) for group, each in groups_of(unknown).items()}
    values = [grids[0] if k == 0 else grids[1] for k in range(len(groups))]
    counts = [len(tried) * len(drawn) for tried, drawn in zip(values, groups.values(), strict=True)]
    tally = Tally(advance, sum(counts))
    spans = []
    for (group, drawn), tried, count in zip(groups.items(), values, counts, strict=True):
        share = shares(arrangement, drawn, at(tried), workers, tally.part(count))
        ends = span(enough(share), int(np.abs(tried - own).argmin()))
        least, most = (None, None) if ends is None else (float(tried[k]) for k in ends)
        spans.append(Span(group, least, most, tried, share))
    return Limits(*told, own, arrangement, tuple(spans))
