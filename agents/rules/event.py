"""Sort by one event: the parcel is wholly in the zone."""

import numpy as np

from surface_gym.settings import Settings

from ..sight import line_sight
from .aims import wholly_in_zone
from .axes import axes_of
from .lane_rule import Commands, Observations, UniformRule


class EventRule(UniformRule):
    """90 deg until the parcel is wholly in the zone, then 45 deg everywhere.

    A lead-in module under the rear pins it while those of the zone push the front aside: what the
    fixed layout loses to that, this rule does not. Straight through, the axes stay at 90 deg.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("sort",))
        self._axes = axes_of(settings)

    def _choose(self, observations: Observations) -> Commands:
        see = line_sight(self._settings, observations)
        return self._axes.towards(np.where(wholly_in_zone(see), see.side, 0.0))
