"""Upper bounds on the throughput of schedules."""

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import HOUR

from ..base import Numbers
from .maneuvers import Library
from .trajectories import list_asked


def entrance_bound(config: EnvConfig, odds: Numbers | None = None) -> float:
    """Compute an upper bound [parcels/h] on the throughput of any controller.

    A parcel enters once its base and `entry_gap` ahead of it are clear. Until then, the parcel
    before it rolls over the lead-in at 90 deg, at most at its entry speed. So the time between
    entries is at least the clear length divided by that speed. The bound holds if the lead-in is
    long enough, the slope is at most `LEVELLING`, and nothing pushes the parcels.

    Args:
        odds: (kinds,) independent odds of the kinds in `list_asked`; None: equal.
    """
    kinds = list_asked(config)
    share = np.full(len(kinds), 1.0 / len(kinds)) if odds is None else odds / odds.sum()
    length = np.array([np.ptp(parcel.base.outline[:, 0]) for parcel, _, _ in kinds])
    speed = np.array([each for _, each, _ in kinds])
    clear = length + config.stream_task.entry_gap
    return float(HOUR / (share @ (1.0 / speed) * (share @ clear)))


def clairvoyant_bound(library: Library, odds: Numbers, parcels: int = 5000, seed: int = 0) -> float:
    """Compute an upper bound [parcels/h] for schedules that know the whole sequence of parcels.

    The bound holds for schedules of a library's maneuvers on one random sequence.

    It is the shortest path through the maneuvers of the parcels, with gaps between successive
    parcels only. Constraints from parcels farther ahead could only make the path longer.

    Args:
        odds: (kinds,) independent odds of the kinds.
    """
    kinds = np.random.default_rng(seed).choice(len(odds), size=parcels, p=odds / odds.sum())
    own = library.options[kinds[0]]
    own = own[own >= 0]
    time = np.zeros(len(own))
    for kind in kinds[1:]:
        after = library.options[kind]
        after = after[after >= 0]
        time = (time[:, np.newaxis] + library.gaps[np.ix_(own, after)]).min(axis=0)
        own = after
    return float(HOUR * (parcels - 1) / time.min())
