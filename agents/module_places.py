"""Positions of Sort's modules under a parcel, computed from an observation by compiled functions.
The clearance is the distance from the parcel's base to the rotors; it is negative on the rotors.

If observations lack the parcel's outline, the functions infer it and the line's number of rows.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.jit import compiled, linked
from surface_gym.config import EnvConfig
from surface_gym.lines import Line
from surface_gym.tasks.features import Column, read

from .base import Integers, Singles
from .rules import decoding
from .rules.decoding import ABSENT, Sight, see_line

EXACT = 1e-6  # [m] lengths that differ by less are equal: observations are single precision
ELLIPSE = math.pi / 4.0  # share of a rectangle that the ellipse in it fills
ROUND = 0.08  # [pitches] apparent loss of width of a turned disc; half a gap between rows
LEAST_ROWS = 2.0  # minimum rows of a line between supports
MARGIN = 0.01  # [m] modules closer than this to the base count as under it
BESIDE, ACROSS = 0.3, 0.15  # [m] scales of a module's place beside the parcel and the line
PLACE_SIZE = 9  # number of features of a module's place
AHEAD, ASIDE = 6, 7  # features: position relative to the parcel's centre, along and across the line


class Shown(NamedTuple):
    """Columns of features of a base's outline, limits of a line's rows, and the control period."""

    is_observed: int  # 1: the outline is observed; 0: it is inferred from the clearance
    clearance: Column
    length: Column
    width: Column
    fill: Column
    sine: Column  # of the phase within a pitch along x
    cosine: Column
    least: float  # rows of a line
    most: float
    period: float  # [s]


def find_shown(config: EnvConfig) -> Shown:
    """Find the features by which an environment shows the outline of a base."""
    line, columns = config.chosen_line, config.columns
    names = ("clearance", "length", "width", "fill", "sine of phase x", "cosine of phase x")
    shown: list[Any] = [int("parcel" in config.observed_groups)]
    shown += [columns.get(name, ABSENT) for name in names]
    least = LEAST_ROWS if isinstance(line, Line) else float(line.zone_rows)
    shown += [least, float(line.zone_rows), config.control_period]
    return Shown(*shown)


class Outline(NamedTuple):
    """Position and shape of a base. The shape is a rectangle, an ellipse or in between."""

    length: float  # [m] half of it
    width: float  # [m] half of it
    roundness: float  # [-] 0: a rectangle, 1: an ellipse
    rows: float  # rows of the parcel's line
    x: float  # [m] of its centre past the zone's first edge


@linked
def count_rows(pairs: float, shown: Shown) -> float:
    """Infer the line's number of rows from `pairs`, the width of the base in pairs of rows.

    The number is 2 * floor(`pairs`), but at least `shown.least` and at most `shown.most`.
    """
    return min(shown.most, max(shown.least, 2.0 * np.floor(pairs)))


@linked
def find_reach(length: float, width: float, roundness: float, theta: float) -> float:
    """Compute half the extent [m] along x of an `Outline` that is turned by `theta` [rad]."""
    cosine, sine = abs(math.cos(theta)), abs(math.sin(theta))
    straight = length * (cosine + sine) + (width - length) * sine
    bent = math.hypot(length * cosine, width * sine)
    return (1.0 - roundness) * straight + roundness * bent


@linked
def find_outline(
    row: Singles,
    seen: decoding.LineReading,
    sight: Sight,
    shown: Shown,
    theta: float,
    offset: float,
) -> Outline:
    """Read or infer the outline of a base.

    Args:
        row: (features,) observation.
        seen: quantities that `see_line` reads from the observation with `sight`.
        theta: [rad] angle of the base, mirrored if the goal is at y < 0.
        offset: [m] y of the base relative to the middle of the line, mirrored in the same way.
    """
    if shown.is_observed != 0:
        length, width = read(row, shown.length), read(row, shown.width)
        roundness = min(1.0, max(0.0, (1.0 - read(row, shown.fill)) / (1.0 - ELLIPSE)))
        rows = count_rows(width / sight.pitch_y + EXACT, shown)
        x = seen.x + (find_reach(length, width, roundness, theta) - seen.reach)
        # The phase in a pitch makes x exact.
        phase = math.atan2(read(row, shown.sine), read(row, shown.cosine))
        in_pitch = 0.5 + phase / (2.0 * math.pi)  # from a column's first edge
        x = sight.pitch_x * (np.rint(x / sight.pitch_x - in_pitch) + in_pitch)
        return Outline(length, width, roundness, rows, x)
    # The clearance excludes the half line and the base's half extent across it. A wider base has
    # a wider line, so that both follow.
    length, pitch = seen.half_length, sight.pitch_y
    cosine, sine = abs(math.cos(theta)), abs(math.sin(theta))
    total = offset - read(row, shown.clearance)  # half line and half extent
    across = total - length * sine  # half line and the half width's part
    rows = count_rows((across / pitch + 1.5 - ROUND) / (1.0 + cosine), shown)
    half_line = 0.5 * pitch * (rows - 1.0)
    extent = across - half_line
    width = length
    is_disc = abs(total - half_line - length) < EXACT
    if not is_disc and abs(extent - length * cosine) >= EXACT and cosine > 0.0:
        width = min(2.0 * length, max(0.5 * length, extent / cosine))
    x = seen.x + (find_reach(length, width, 0.0, theta) - seen.reach)
    return Outline(length, width, 0.0, rows, x)


@linked
def find_distance(outline: Outline, along: float, across: float) -> float:
    """Compute the distance [m] of a position from a base. Inside, the distance is negative.

    `along` and `across` are the position's coordinates [m] in the base's frame. Outside an ellipse
    that is not a disc, the result is an upper bound.
    """
    length, width, roundness = outline.length, outline.width, outline.roundness
    straight = max(abs(along) - length, abs(across) - width)
    bent = (math.hypot(along / length, across / width) - 1.0) * min(length, width)
    return (1.0 - roundness) * straight + roundness * bent


@compiled
def find_places(
    observations: Singles, sight: Sight, shown: Shown, env: Integers, index: Integers,
    place: Singles,
) -> int:  # fmt: skip
    """Write the modules that are under parcels now or a control period later; return the count.

    Args:
        observations: (num_envs, features). `sight` and `shown` hold the features' columns.
        env: (modules,) output: environment of each module.
        index: (modules,) output: each module's index in the action.
        place: (modules, PLACE_SIZE) output: each module's position under the parcel, mirrored if
            the goal is at y < 0.
    """
    count, columns, period = 0, sight.x.shape[0], shown.period
    for i in range(observations.shape[0]):
        seen = see_line(observations[i], sight)
        mirror = -1.0 if seen.side < 0.0 else 1.0
        theta, offset = mirror * seen.theta, mirror * seen.y
        vx, vy, omega = seen.vx, mirror * seen.vy, mirror * seen.omega
        outline = find_outline(observations[i], seen, sight, shown, theta, offset)
        length, width = outline.length, outline.width
        close = math.hypot(length, width) + period * (abs(vx) + abs(vy)) + 2.0 * MARGIN
        cosine, sine = math.cos(theta), math.sin(theta)
        turned = theta + period * omega
        cosine_later, sine_later = math.cos(turned), math.sin(turned)
        for k in range(columns * sight.y.shape[0]):
            row = mirror * sight.y[k // columns]
            x, y = sight.x[k % columns] - outline.x, row - offset
            is_there = abs(row) < 0.5 * sight.pitch_y * outline.rows
            if not is_there or abs(x) >= close or abs(y) >= close:
                continue
            along, across = cosine * x + sine * y, cosine * y - sine * x
            x_later, y_later = x - period * vx, y - period * vy
            along_later = cosine_later * x_later + sine_later * y_later
            across_later = cosine_later * y_later - sine_later * x_later
            now = find_distance(outline, along, across)
            later = find_distance(outline, along_later, across_later)
            if min(now, later) > MARGIN:
                continue
            env[count], index[count] = i, k
            found = place[count]
            found[0], found[1] = along / length, across / width
            found[2], found[3] = along_later / length, across_later / width
            found[4], found[5] = 1.0 if now <= 0.0 else 0.0, 1.0 if later <= 0.0 else 0.0
            found[6], found[7], found[8] = x / BESIDE, y / BESIDE, (y + offset) / ACROSS
            count += 1
    return count
