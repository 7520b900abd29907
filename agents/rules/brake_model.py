"""How much a period of braking takes: the line's physics in one dimension."""

import math

import numpy as np

from surface_gym.dynamics.types import GRAVITY
from surface_gym.settings import Settings
from surface_gym.tasks.line import BRAKING, ROLLING_LOSS

from .lane_rule import Booleans, Numbers

COM_HEIGHT = 0.1  # [m] of the centre of mass: Table 1


class BrakeModel:
    """A parcel that moves straight along the line, its weight shared by the columns under it.

    Args:
        settings: whose control period and zone are meant.
    """

    def __init__(self, settings: Settings) -> None:
        self._timing = settings.timing
        self._columns = settings.action_kind.columns
        self._pitch = settings.chosen_plant.pitch_x

    def after_a_period(
        self, place: Numbers, speed: Numbers, half_length: Numbers, share: Numbers
    ) -> tuple[Numbers, Numbers]:
        """Place [m] of the centre past the zone's first edge and speed [m/s]: (lanes, ways) each.

        Args:
            place: (lanes,) [m] now.
            speed: (lanes,) [m/s] now.
            half_length: (lanes,) [m] of the base.
            share: (lanes, ways, columns) [-] of mu_max that each column of the zone brakes with.
        """
        dt = self._timing.dt
        # Columns that are or come under the parcel, whether in the zone or not.
        longest = 2.0 * half_length.max() + max(0.0, speed.max()) * dt * self._timing.steps
        first = np.floor((place - half_length) / self._pitch).astype(np.int64)
        near = first[:, np.newaxis] + np.arange(math.ceil(longest / self._pitch) + 2)
        inside = (near >= 0) & (near < self._columns)
        column = np.clip(near, 0, self._columns - 1)[:, np.newaxis, :]
        brake = np.take_along_axis(
            share, np.broadcast_to(column, (*share.shape[:2], near.shape[1])), 2
        )
        brake = np.where(inside[:, np.newaxis, :], brake, 0.0)
        centre = self._pitch * (near + 0.5)[:, np.newaxis, :]
        reach = half_length[:, np.newaxis, np.newaxis]
        x = np.repeat(place[:, np.newaxis], share.shape[1], axis=1)
        v = np.repeat(speed[:, np.newaxis], share.shape[1], axis=1)
        loss = np.zeros_like(v)
        for _ in range(self._timing.steps):
            arm = centre - (x + 0.5 * dt * v)[:, :, np.newaxis]
            loss = _deceleration(arm, np.abs(arm) <= reach, brake, loss)
            slower = np.maximum(0.0, v - dt * loss)
            x += 0.5 * dt * (v + slower)
            v = slower
        return x, v


def _deceleration(arm: Numbers, under: Booleans, brake: Numbers, before: Numbers) -> Numbers:
    """[m/s^2] (lanes, ways), the columns' loads shared as Eq. (1) has it.

    Args:
        arm: (lanes, ways, columns) [m] of each column from the centre.
        under: (lanes, ways, columns) whether it bears.
        brake: (lanes, ways, columns) [-] of mu_max it brakes with.
        before: (lanes, ways) [m/s^2] the deceleration of the last step, which the load leans by.
    """
    count = np.maximum(1, under.sum(axis=-1))
    mean = np.where(under, arm, 0.0).sum(axis=-1) / count
    apart = np.where(under, arm - mean[..., np.newaxis], 0.0)
    spread = np.maximum((apart**2).sum(axis=-1), 1e-9)
    lean = (before * COM_HEIGHT / GRAVITY - mean) / spread
    load = np.maximum(0.0, under / count[..., np.newaxis] + apart * lean[..., np.newaxis])
    braked = (load * brake).sum(axis=-1) / np.maximum(load.sum(axis=-1), 1e-9)
    return ROLLING_LOSS + (BRAKING - ROLLING_LOSS) * braked
