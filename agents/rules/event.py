"""Sort by one event: the parcel is wholly in the zone."""

import numpy as np

from agents.rules.aims import wholly_in_zone
from agents.rules.axes import axes_of
from agents.rules.lane_rule import Booleans, Commands, LaneRule, Memory, Observations
from agents.sight import line_sight
from surface_gym.settings import Settings


class EventRule(LaneRule):
    """90 deg until the parcel is wholly in the zone, then 45 deg everywhere.

    A lead-in module under the rear pins it while those of the zone push the front aside: what the
    fixed layout loses to that, this rule does not. Straight through, the axes stay at 90 deg.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("sort",))
        self._axes = axes_of(settings)

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        del memory, fresh
        see = line_sight(self._settings, observations)
        side = np.where(wholly_in_zone(see), see.side, 0.0)
        axes = self._axes
        choice = np.select([side > 0.0, side < 0.0], [axes.left, axes.right], axes.roll)
        return np.repeat(choice[:, np.newaxis], self._kind.size, axis=1), None
