"""Any task by axes that are all alike, whatever the parcel does."""

import numpy as np

from surface_gym.settings import Settings

from .axes import choice_of
from .lane_rule import Commands, Observations, UniformRule


class UniformLayout(UniformRule):
    """Every axis at one angle.

    Args:
        settings: of the environment it is to act in.
        angle: [rad] of every axis, one of those on offer.
    """

    def __init__(self, settings: Settings, angle: float) -> None:
        super().__init__(settings, (settings.task_name,))
        self._choice = choice_of(settings, angle)

    def _choose(self, observations: Observations) -> Commands:
        return np.full(len(observations), self._choice)
