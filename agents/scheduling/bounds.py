"""Bounds on what a schedule can carry."""

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import HOUR

from ..base import Numbers
from .maneuvers import Library
from .trajectories import list_asked


def entrance_bound(config: EnvConfig, odds: Numbers | None = None) -> float:
    """Compute the rate [parcels/h] that no controller can exceed, whatever it does on the line.

    A parcel enters once its base and `entry_gap` ahead of it are clear. Until then the one before
    it rolls over the lead-in, whose axes stand at 90 deg, no faster than it came: so it takes at
    least the one's clear length over the other's speed. This holds where the lead-in is as long,
    the slope no steeper than makes up for rolling (`LEVELLING`), and nothing pushes.

    Args:
        odds: (kinds,) of `list_asked`, independent of each other; None: all the same.
    """
    kinds = list_asked(config)
    share = np.full(len(kinds), 1.0 / len(kinds)) if odds is None else odds / odds.sum()
    length = np.array([np.ptp(parcel.base.outline[:, 0]) for parcel, _, _ in kinds])
    speed = np.array([each for _, each, _ in kinds])
    clear = length + config.stream_task.entry_gap
    return float(HOUR / (share @ (1.0 / speed) * (share @ clear)))


def clairvoyant_bound(library: Library, odds: Numbers, parcels: int = 5000, seed: int = 0) -> float:
    """Compute the rate [parcels/h] that no schedule of a library's maneuvers can exceed on a drawn
    sequence, even one that knows all parcels to come.

    It is the shortest path through the maneuvers of each parcel, where each is held against the one
    before it alone: what those farther ahead ask for could only make it longer.

    Args:
        odds: (kinds,) independent of each other.
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
