"""Sort by the paper's fixed layout: every axis at 45 deg from the start."""

from surface_gym.settings import Settings

from ..sight import line_sight
from .axes import axes_of
from .lane_rule import Commands, Observations, UniformRule


class FixedLayout(UniformRule):
    """Figure 6a: axes at -45 deg sort to y > 0, at +45 deg to y < 0, whatever the parcel does.

    Straight through, the axes stay at 90 deg.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("sort",))
        self._axes = axes_of(settings)

    def _choose(self, observations: Observations) -> Commands:
        return self._axes.towards(line_sight(self._settings, observations).side)
