"""The orientations that rules speak of, among those on offer."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..angles import SAME, axes_apart


class Offering(Protocol):
    """Settings of an environment that offers orientations."""

    @property
    def chosen_orientations(self) -> tuple[float, ...]:
        """[rad] axis angles on offer."""


def choice_of(settings: Offering, angle: float) -> int:
    """The place of an axis angle [rad] among the orientations; an axis turned by pi is the same.

    Raises:
        ValueError: it is not among them.
    """
    angles = np.array(settings.chosen_orientations)
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
        """The choice that leads to each side (...): left where positive, right where negative."""
        return np.select([side > 0.0, side < 0.0], [self.left, self.right], self.roll)


def axes_of(settings: Offering) -> Axes:
    """The four orientations of the paper's Figure 2b.

    Raises:
        ValueError: one of them is not on offer.
    """
    quarter = math.pi / 4.0
    return Axes(
        roll=choice_of(settings, 2.0 * quarter),
        brake=choice_of(settings, 0.0),
        left=choice_of(settings, -quarter),
        right=choice_of(settings, quarter),
    )
