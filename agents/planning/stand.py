"""How the lanes of a search stand: what aims judge."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.lines import BaseLine
from surface_gym.state import ACROSS_FACTOR, ALONG_FACTOR, ParcelState
from surface_gym.tasks.line import BRAKING, ROLLING_LOSS

from ..sight import square_reach
from .grip import Grip
from .turning import Turning

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stand:
    """How the lanes of a search stand: some of their rows, and what is the same for all."""

    lanes: ParcelState
    half_length: float  # [m] of the base
    zone: tuple[int, int, int, int]  # first row, rows, first column, columns that obey
    plant: BaseLine
    conditions: Numbers  # (5,) factors of friction [-], gravity [m/s^2], as `Surfaces` has them
    corners: Numbers | None = None  # (corners, 2) [m] of the base; None: a square
    grip: Grip | None = None  # None: that of rotors alone
    turning: Turning | None = None  # axes on their way; None: they obey at once

    @property
    def braking(self) -> float:
        """[m/s^2] of a parcel over axes at 0 deg."""
        return BRAKING * float(self.conditions[ALONG_FACTOR])

    @property
    def rolling_loss(self) -> float:
        """[m/s^2] of a parcel over axes at 90 deg."""
        return ROLLING_LOSS * float(self.conditions[ACROSS_FACTOR])

    @property
    def vx(self) -> Numbers:
        """(lanes,) [m/s] what is left of the speed along x once all axes have turned to 90 deg."""
        vx = self.parcels.truth[:, 3]
        if self.turning is None:
            return vx
        left: Numbers = vx + self.turning.pushes(self.braking)[:, 0]
        return np.maximum(np.minimum(0.0, vx), left)

    @property
    def braking_way(self) -> Numbers:
        """(lanes,) [m] along x that parcels go on for if all axes turn to 0 deg from now on."""
        x, vx = self.parcels.truth[:, 0], self.parcels.truth[:, 3]
        if self.grip is None:
            way: Numbers = vx**2 / (2.0 * self.braking)
            return way
        if self.turning is None:
            return self.grip.braking_way(x, vx)
        return self.turning.braking_way(x, vx, self.grip)

    def reach(self, x: float, y: float) -> Numbers:
        """(lanes,) [m] how far the base reaches from its centre in a direction (x, y)."""
        theta = self.parcels.truth[:, 2]
        if self.corners is None:
            return square_reach(self.half_length, theta)
        cosine, sine = np.cos(theta), np.sin(theta)
        directions = np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1)
        farthest: Numbers = (directions @ self.corners.T).max(axis=1)
        # A disc has all its corners at its centre.
        return np.where(farthest > 0.0, farthest, self.half_length)
