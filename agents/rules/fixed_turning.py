"""Orient by the best layout arranged beforehand, found by simulation."""

import math
from functools import lru_cache

import numpy as np

from surface_gym.layouts import ROLLING
from surface_gym.lines import BaseLine
from surface_gym.settings import Settings

from ..sight import line_sight, square_reach
from .axes import axes_of
from .lane_rule import Commands, FixedRule, Numbers, Observations
from .trial import run_over, sizes_of

SAME_SPEED = 0.02  # [m/s] entry speeds are rounded down to it, so that none stalls for it
STEP = 0.005  # [s] of a run


@lru_cache(maxsize=4096)
def angle_at_exit(
    half_length: float,
    speed: float,
    site_plan: BaseLine,
    zone: tuple[int, int] | None,
    rows: int,
    columns: int,
    turning: int,
) -> float:
    """[rad] to which a box has turned when its rear leaves the zone; infinite if it never does.

    Args:
        half_length: [m] of the box, a square.
        speed: [m/s] at which it enters.
        site_plan: the plant.
        zone: first and last column that obey; None for the plant's own.
        rows: of the widest zone.
        columns: of the zone.
        turning: first columns of the zone whose left half is at 45 deg.
    """
    axis = np.full((rows, columns), ROLLING)
    axis[rows // 2 :, :turning] = math.pi / 4.0
    run = run_over(axis, half_length, speed, site_plan, zone, STEP)
    theta = run.pose[:, 2]
    reach = square_reach(half_length, theta)
    # The rear enters at x = 0; the lead-in is as long as the box, in whole columns.
    lead_in = math.ceil(2.0 * half_length / site_plan.pitch_x - 1e-9) if zone is None else zone[0]
    gone = run.pose[:, 0] - reach > site_plan.pitch_x * (lead_in + columns)
    return float(theta[gone.argmax()]) if gone.any() else math.inf


class FixedTurning(FixedRule):
    """The zone's first columns at 45 deg in the half of the rows that is on the asked side, all
    others at 90 deg: as many as by the simulator leave the parcel nearest to the asked angle.

    45 deg inside and 90 outside turns farther than 0, -45 or 45 deg against one another.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("orient",), ("modules",))
        axes = axes_of(settings)
        rows, columns = self._kind.shape
        turning = np.arange(columns) < np.arange(columns + 1)[:, np.newaxis, np.newaxis]
        left = np.arange(rows)[:, np.newaxis] >= rows // 2
        # (layouts, modules) to turn left, and their mirror images.
        self._to_left = np.where(turning & left, axes.right, axes.roll).reshape(columns + 1, -1)
        self._to_right = np.where(turning & ~left, axes.left, axes.roll).reshape(columns + 1, -1)

    def _layout(self, observations: Observations) -> Commands:
        see = line_sight(self._settings, observations)
        speeds = np.maximum(SAME_SPEED, SAME_SPEED * np.floor(see.vx / SAME_SPEED))
        cases, of_lane = np.unique(
            np.stack([sizes_of(see.half_length), speeds], axis=-1), axis=0, return_inverse=True
        )
        angles = np.stack([self._angles(*case) for case in cases.tolist()])[of_lane.ravel()]
        best = np.abs(angles - np.abs(see.angle)[:, np.newaxis]).argmin(axis=1)
        left = (see.angle > 0.0)[:, np.newaxis]
        return np.where(left, self._to_left[best], self._to_right[best])

    def _angles(self, half_length: float, speed: float) -> Numbers:
        """(layouts,) [rad] that each turns a box of a size and an entry speed to."""
        plan, zone = self._settings.chosen_plant, self._settings.zone
        rows, columns = self._kind.shape
        return np.array(
            [
                angle_at_exit(half_length, speed, plan, zone, rows, columns, turning)
                for turning in range(columns + 1)
            ]
        )
