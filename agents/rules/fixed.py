"""Sort by the paper's fixed layout: every axis at 45 deg from the start."""

import numpy as np

from agents.rules.axes import axes_of
from agents.rules.lane_rule import Booleans, Commands, LaneRule, Memory, Observations
from agents.sight import line_sight
from surface_gym.settings import Settings


class FixedLayout(LaneRule):
    """Figure 6a: axes at -45 deg sort to y > 0, at +45 deg to y < 0, whatever the parcel does.

    Straight through, the axes stay at 90 deg.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("sort",))
        self._axes = axes_of(settings)

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        del memory, fresh
        side = line_sight(self._settings, observations).side
        axes = self._axes
        choice = np.select([side > 0.0, side < 0.0], [axes.left, axes.right], axes.roll)
        return np.repeat(choice[:, np.newaxis], self._kind.size, axis=1), None
