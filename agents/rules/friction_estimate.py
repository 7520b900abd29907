"""How much friction acts, estimated from what it has taken, against what was predicted."""

from dataclasses import dataclass

import numpy as np

from surface_gym.sensors import Exact
from surface_gym.settings import Settings

from .brake_model import Frictions
from .lane_rule import Memory, Numbers

SIZE = 5  # numbers that an estimate is: two frictions, their variances and covariance
UNSURE = np.array([0.12, 0.12])  # [-] of braking and of rolling, before anything is seen
LEAST, MOST = 0.4, 1.7  # [-] that an estimate is kept to

# What a period's loss of speed may be seen or predicted wrong by.
SEEN_EXACTLY, SEEN = 2e-4, 0.01  # [m/s] where sensors are exact, and else
PREDICTED = 0.16  # [-] of what braking takes: columns come and go, loads lie off centre


@dataclass(frozen=True, eq=False)
class FrictionEstimate:
    """A Kalman filter's, in two states: friction along axes and across them, a lane each."""

    noise: float  # [m/s] of a loss that is seen

    @classmethod
    def of(cls, settings: Settings) -> "FrictionEstimate":
        """That for sensors of an environment."""
        return cls(SEEN_EXACTLY if isinstance(settings.sensors, Exact) else SEEN)

    @staticmethod
    def unknown(lanes: int) -> Memory:
        """(lanes, SIZE) nominal frictions, of which nothing is known yet."""
        return np.tile([1.0, 1.0, *UNSURE**2, 0.0], (lanes, 1))

    @staticmethod
    def frictions(estimate: Memory) -> Frictions:
        """What is estimated."""
        braking, rolling = np.clip(estimate[:, :2], LEAST, MOST).T
        return Frictions(braking, rolling, np.sqrt(np.maximum(0.0, estimate[:, 3])))

    def learnt(self, estimate: Memory, lost: Numbers, braking: Numbers, rolling: Numbers) -> Memory:
        """(lanes, SIZE) after a period.

        Args:
            estimate: (lanes, SIZE) before.
            lost: (lanes,) [m/s] of speed in the period, as seen.
            braking: (lanes,) [m/s] of it by nominal friction along axes.
            rolling: (lanes,) [m/s] of it by nominal friction across them.
        """
        along, across, var_along, var_across, both = estimate.T
        with_along = var_along * braking + both * rolling
        with_across = both * braking + var_across * rolling
        doubt = self.noise**2 + (PREDICTED * braking) ** 2
        variance = with_along * braking + with_across * rolling + doubt
        surprise = (lost - along * braking - across * rolling) / variance
        return np.stack(
            [
                along + with_along * surprise,
                across + with_across * surprise,
                var_along - with_along**2 / variance,
                var_across - with_across**2 / variance,
                both - with_along * with_across / variance,
            ],
            axis=-1,
        )
