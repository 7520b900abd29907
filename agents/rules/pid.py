"""A PID controller in each module."""

from dataclasses import dataclass

import numpy as np

from surface_gym.settings import Settings
from surface_gym.tasks.line import BRAKING

from .lane_rule import Booleans, Commands, Memory, Numbers
from .local_rule import Above, LocalRule


@dataclass(frozen=True)
class Gains:
    """By how much the velocity above a module should change, for its error."""

    proportional: float  # [-]
    integral: float  # [1/s]
    derivative: float  # [s]


# Found by trying, on other starts than any reported. Orient ends turning: nothing may wind up.
GAINS = {
    "sort": Gains(proportional=1.0, integral=1.0, derivative=0.01),
    "orient": Gains(proportional=4.0, integral=0.0, derivative=0.01),
    "track": Gains(proportional=1.0, integral=4.0, derivative=0.01),
}
MOST_SUMMED = 0.1  # [m] of each component of the error: beyond, it winds up no more


class PidRule(LocalRule):
    """Each module's PID says by how much the velocity above it should change; it takes the
    orientation whose friction, in a period, comes nearest to that.

    A module with nothing above it yet is ready for the parcel as it would be there, but sums
    nothing up. The summed and the last error go through `state`: (lanes, 2, modules, 2).
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._gains = GAINS[self._task]
        angles = np.array(settings.chosen_orientations)
        self._direction = np.stack([np.cos(angles), np.sin(angles)], axis=-1)  # (choices, 2)
        self._period = settings.control_period

    def _turn(
        self, above: Above, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        error = above.error
        if memory is None:
            memory = np.zeros((len(error), 2, *error.shape[1:]))
        began = fresh[:, np.newaxis, np.newaxis]
        summed = np.where(began, 0.0, memory[:, 0]) + self._period * error
        summed = np.clip(summed, -MOST_SUMMED, MOST_SUMMED)
        summed = np.where(above.under[..., np.newaxis], summed, 0.0)
        last = np.where(began, error, memory[:, 1])
        gains = self._gains
        wanted = (
            gains.proportional * error
            + gains.integral * summed
            + gains.derivative * (error - last) / self._period
        )
        miss = wanted[:, :, np.newaxis] - self._changes(above.velocity)
        choice: Commands = (miss**2).sum(axis=-1).argmin(axis=-1)
        return choice, np.stack([summed, error], axis=1)

    def _changes(self, velocity: Numbers) -> Numbers:
        """(lanes, modules, choices, 2) [m/s] by which each orientation would change a velocity.

        Friction brakes along the axis, and at most to rest.
        """
        most = BRAKING * self._period
        along = np.clip(velocity @ self._direction.T, -most, most)
        return -along[..., np.newaxis] * self._direction
