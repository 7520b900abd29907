"""Track by axes arranged once: every axis at 90 deg, since no path is known beforehand."""

import numpy as np

from surface_gym.settings import Settings

from .axes import axes_of
from .lane_rule import Commands, Observations, UniformRule


class Rolling(UniformRule):
    """90 deg everywhere: the parcel rolls straight downhill.

    A field arranged along a path would have to know the path, of which observations show the next
    0.35 m: to arrange axes by that is to control.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("track",))
        self._roll = axes_of(settings).roll

    def _choose(self, observations: Observations) -> Commands:
        return np.full(len(observations), self._roll)
