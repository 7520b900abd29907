"""How far a run is from what is asked of it: the slope that a search for a layout goes down."""

from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from surface_gym.design.line import DesignLine
from surface_gym.design.passage import AT_REST, PAST
from surface_gym.design.purposes import Purpose, Slow, Sort, Stop, Turn
from surface_gym.design.runs import Ends, Runs

Numbers = NDArray[np.float64]


@singledispatch
def shortfall(purpose: Purpose, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
    """(runs,) [-] from 0, just as asked, to 1.

    Args:
        purpose: what is asked; for one of one's own, success is all that tells.
        line: on which.
        runs: that were made.
        ends: what came of them.
    """
    return np.where(purpose.succeeds(line, runs, ends), 0.0, 1.0)


@shortfall.register
def _(purpose: Sort, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
    """The part left of the way across: a line's width past the last rotor, ample for any box."""
    enough = 1.5 * line.pitch_y * line.rows
    across = purpose.side * (ends.pose[:, 1] - line.line_y)
    left = 1.0 - np.clip(across / enough, 0.0, 1.0)
    return np.where(purpose.succeeds(line, runs, ends), 0.0, left)


@shortfall.register
def _(purpose: Slow, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
    """The error of the ratio; at rest on the zone, half at least, by the part of it to go."""
    error = purpose.measure(line, runs, ends) - purpose.ratio
    error = np.maximum(0.0, error) if purpose.tolerance is None else np.abs(error)
    to_go = (line.zone_x[1] - ends.pose[:, 0]) / (line.zone_x[1] - line.zone_x[0])
    stopped = np.where(ends.how == AT_REST, 0.5 + 0.5 * np.clip(to_go, 0.0, 1.0), 1.0)
    return np.where(np.isnan(error), stopped, np.minimum(1.0, error))


@shortfall.register
def _(purpose: Stop, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
    """The error of the place over the zone's length; past the zone, half at least, by the speed."""
    rest = purpose.measure(line, runs, ends)
    off = np.zeros(len(rest)) if purpose.place is None else np.abs(rest - purpose.place)
    off = np.where(np.isnan(rest), np.nan, off / (line.zone_x[1] - line.zone_x[0]))
    faster = ends.velocity[:, 0] / np.maximum(runs.speed, 1e-9)
    passed = np.where(ends.how == PAST, 0.5 + 0.5 * np.clip(faster, 0.0, 1.0), 1.0)
    return np.where(np.isnan(off), passed, np.minimum(0.5, off))


@shortfall.register
def _(purpose: Turn, line: DesignLine, runs: Runs, ends: Ends) -> Numbers:
    """The error of the angle, of 180 deg; on the zone still, half at least, by the part to go."""
    error = np.abs(purpose.measure(line, runs, ends) - purpose.angle) / np.pi
    to_go = (line.zone_x[1] - ends.pose[:, 0]) / (line.zone_x[1] - line.zone_x[0])
    held = np.where(ends.how == AT_REST, 0.5 + 0.5 * np.clip(to_go, 0.0, 1.0), 1.0)
    return np.where(np.isnan(error), held, np.minimum(0.5, error))
