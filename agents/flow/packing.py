"""What no controller of a stream can exceed: single parcels' ways packed as close as they go.

A parcel that has the line to itself takes some way to its exit. A stream of such parcels, none of
which disturbs another, can come no closer than their bases allow: that is the bound here. It holds
for parcels that are led as if they were alone; who leads them otherwise may beat it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.flow.arrivals import HOUR

Numbers = NDArray[np.float64]

FINE = 0.0025  # [s] between the moments at which bases are held against each other
LONGEST = 20.0  # [s] gap that is tried


@dataclass(frozen=True, eq=False)
class Way:
    """A parcel's way over the line, from its entry to its exit."""

    outline: Numbers  # (corners, 2) [m] of the base from its centroid
    time: Numbers  # (moments,) [s] since it entered, rising from 0
    pose: Numbers  # (moments, 3) [m, m, rad] of the centroid

    def at(self, time: Numbers) -> Numbers:
        """(moments, corners, 2) [m] of the base at times (moments,) within the way's."""
        x, y, theta = (np.interp(time, self.time, column) for column in self.pose.T)
        cosine, sine = np.cos(theta)[:, np.newaxis], np.sin(theta)[:, np.newaxis]
        along, across = self.outline.T
        return np.stack(
            [
                x[:, np.newaxis] + cosine * along - sine * across,
                y[:, np.newaxis] + sine * along + cosine * across,
            ],
            axis=-1,
        )


def clearance(one: Numbers, other: Numbers) -> Numbers:
    """(moments,) [m] between convex bases (moments, corners, 2), by separating axes: less than what
    lies between two corners, negative where they overlap.
    """
    found = np.full(len(one), -np.inf)
    for base, against in ((one, other), (other, one)):
        side = np.roll(base, -1, axis=1) - base
        length = np.hypot(side[..., 0], side[..., 1])
        normal = np.stack([side[..., 1], -side[..., 0]], axis=-1) / length[..., np.newaxis]
        own = np.einsum("mki,mki->mk", normal, base)
        reach = np.einsum("mki,mci->mkc", normal, against).min(axis=2)
        found = np.maximum(found, (reach - own).max(axis=1))
    return found


def least_gap(first: Way, second: Way, margin: float = 0.0) -> float:
    """[s] the least gap between two entries from which on the second never comes closer to the
    first than a margin [m] while both are on the line.

    Raises:
        ValueError: there is none of at most 20 s.
    """
    low, high = 0.0, LONGEST
    if not _is_clear(first, second, high, margin):
        raise ValueError(f"ways must have a gap of at most {LONGEST:g} s, got none")
    while high - low > FINE:
        middle = 0.5 * (low + high)
        if _is_clear(first, second, middle, margin):
            high = middle
        else:
            low = middle
    return high


def _is_clear(first: Way, second: Way, gap: float, margin: float) -> bool:
    """Whether the second, a gap [s] behind, keeps clear of the first."""
    end = min(first.time[-1], gap + second.time[-1])
    if end <= gap:
        return True
    time = np.linspace(gap, end, max(2, math.ceil((end - gap) / FINE)))
    return bool(clearance(first.at(time), second.at(time - gap)).min() >= margin)


def gaps_between(ways: list[Way], margin: float = 0.0) -> Numbers:
    """(ways, ways) [s] least gap of each way (column) behind each other (row)."""
    return np.array([[least_gap(one, other, margin) for other in ways] for one in ways])


def packed_rate(gaps: Numbers, odds: Numbers) -> float:
    """[parcels/h] of a stream whose gaps are each as small as its two parcels allow.

    Args:
        gaps: (ways, ways) [s] as `gaps_between` gives them.
        odds: (ways,) of each way, independent of the one before.
    """
    share = odds / odds.sum()
    return float(HOUR / (share @ gaps @ share))


def steady_rate(gaps: Numbers) -> float:
    """[parcels/h] of a stream with equal gaps, in which every pair comes some time."""
    return float(HOUR / gaps.max())
