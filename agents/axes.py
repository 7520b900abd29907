"""Orientations that rules and planners choose from, among those on offer."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .base import SAME, axes_apart


class Offer(Protocol):
    """A configuration that offers orientations."""

    @property
    def chosen_orientations(self) -> tuple[float, ...]:
        """[rad] axis angles on offer."""


def find_orientation(config: Offer, angle: float) -> int:
    """Find the index of an axis angle [rad] on offer; an axis turned by pi is the same.

    Raises:
        ValueError: it is not on offer.
    """
    angles = np.array(config.chosen_orientations)
    apart = axes_apart(angles, angle)
    if apart.min() > SAME:
        raise ValueError(
            f"orientations must hold {math.degrees(angle):g} deg, "
            f"got {np.degrees(angles).tolist()} deg"
        )
    return int(apart.argmin())


@dataclass(frozen=True)
class Axes:
    """Choices by what they do to a parcel that moves along the line."""

    roll: int  # 90 deg: it rolls on
    brake: int  # 0 deg: it is braked
    left: int  # -45 deg: it is led towards y > 0
    right: int  # 45 deg: it is led towards y < 0

    def towards(self, side: NDArray[np.float64]) -> NDArray[np.int64]:
        """Choose what leads to each side (...): left where positive, right where negative."""
        return np.select([side > 0.0, side < 0.0], [self.left, self.right], self.roll)

    def mirrored(self, layout: NDArray[np.int64]) -> NDArray[np.int64]:
        """Mirror choices (rows, columns) in the middle row."""
        flipped = layout[::-1]
        return np.select(
            [flipped == self.left, flipped == self.right], [self.right, self.left], flipped
        )


def find_axes(config: Offer) -> Axes:
    """Find the four orientations of the paper's Figure 2b.

    Raises:
        ValueError: one of them is not on offer.
    """
    quarter = math.pi / 4.0
    return Axes(
        roll=find_orientation(config, 2.0 * quarter),
        brake=find_orientation(config, 0.0),
        left=find_orientation(config, -quarter),
        right=find_orientation(config, quarter),
    )
