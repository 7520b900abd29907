"""Threshold logic: each module compares the error above it with thresholds."""

from dataclasses import dataclass

import numpy as np

from surface_gym.settings import Settings

from .lane_rule import Booleans, Commands, Memory
from .local_rule import Above, LocalRule


@dataclass(frozen=True)
class Thresholds:
    """Errors from which on a module acts."""

    across: float  # [m/s] too little speed to one side: it leads there
    along: float  # [m/s] too much speed along x: it brakes


# Found by trying, on other starts than any reported. Sort asks for more than there is: any do.
THRESHOLDS = {
    "sort": Thresholds(across=0.05, along=0.05),
    "orient": Thresholds(across=0.03, along=0.2),
    "track": Thresholds(across=0.12, along=0.02),
}


class ThresholdRule(LocalRule):
    """-45 or 45 deg where the parcel should go more to the one or the other side, else 0 deg where
    it is too fast, else 90 deg.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._thresholds = THRESHOLDS[self._task]

    def _turn(
        self, above: Above, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        del memory, fresh
        along, across = above.error[..., 0], above.error[..., 1]
        least, axes = self._thresholds, self._axes
        return np.select(
            [across > least.across, across < -least.across, along < -least.along],
            [axes.left, axes.right, axes.brake],
            axes.roll,
        ), None
