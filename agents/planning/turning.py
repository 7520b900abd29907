"""Axes that are still turning: what they will do to the parcels over them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .grip import Grip

Numbers = NDArray[np.float64]

PARTS = 8  # that the time of a quarter turn is reckoned in


@dataclass(frozen=True, eq=False)
class Turning:
    """The rotors of a zone beside some parcels, one parcel a lane."""

    angle: Numbers  # (lanes, rotors) [rad] of each axis
    arm_x: Numbers  # (lanes, rotors) [m] from a parcel's centre of mass
    arm_y: Numbers  # (lanes, rotors) [m]
    share: Numbers  # (lanes, rotors) [-] of its parcel that a rotor that obeys bears
    speed: float  # [rad/s] at which axes turn
    gyration: float  # [m^2] inertia / mass

    @property
    def quarter(self) -> float:
        """[s] that an axis takes to turn by 90 deg."""
        return 0.5 * math.pi / self.speed

    def pushes(self, braking: float) -> Numbers:
        """(lanes, 3) [m/s, m/s, rad/s] by which axes would change the velocity, along the line,
        across it and of turning, until all have turned on to 90 deg; of a parcel that runs straight
        along the line meanwhile.

        Args:
            braking: [m/s^2] of axes at 0 deg.
        """
        most = self.share * (braking / self.speed)
        side = np.sign(np.sin(2.0 * self.angle))
        along = -most * (1.0 - np.abs(np.sin(self.angle)))
        across = -most * side * np.abs(np.cos(self.angle))
        turn = (self.arm_x * across - self.arm_y * along).sum(axis=1) / self.gyration
        return np.stack([along.sum(axis=1), across.sum(axis=1), turn], axis=-1)

    def braking_way(self, x: Numbers, speed: Numbers, grip: Grip) -> Numbers:
        """(lanes,) [m] that parcels go on for if all axes turn to 0 deg from now on.

        Args:
            x: (lanes,) [m] of their centres.
            speed: (lanes,) [m/s] along the line.
            grip: of axes at 0 deg.
        """
        apart = np.abs(self.angle - math.pi * np.round(self.angle / math.pi))
        shared = self.share / np.maximum(1e-9, self.share.sum(axis=1, keepdims=True))
        step = self.quarter / PARTS
        way = np.zeros_like(speed)
        left = np.maximum(0.0, speed)
        for k in range(PARTS):
            then = np.maximum(0.0, apart - (k + 0.5) * step * self.speed)
            turned = (shared * np.cos(then)).sum(axis=1)
            taken = step * turned * grip.braking_at(x + way + 0.5 * step * left)
            after = np.maximum(0.0, left - taken)
            # A parcel that comes to rest within the part does not move for all of it.
            lasts = np.where(taken > left, left / np.maximum(taken, 1e-12), 1.0)
            way += 0.5 * (left + after) * step * lasts
            left = after
        return way + grip.braking_way(x + way, left)
