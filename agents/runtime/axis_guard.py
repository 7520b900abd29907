"""The last look at axis commands before they are sent: those that are not allowed are refused."""

import math

import numpy as np
from numpy.typing import NDArray

from .device import Angles

RIGHT_ANGLE = 0.5 * math.pi + 1e-9  # [rad] an axis turned further is one turned less


class AxisGuard:
    """Says which commands may be sent. None is mended: one that is refused is not sent at all.

    Args:
        shape: (rows, columns) of the widest zone.
        on_offer: [rad] axis angles on offer; None: any from -pi/2 to pi/2.
    """

    def __init__(self, shape: tuple[int, int], on_offer: tuple[float, ...] | None) -> None:
        self._shape = shape
        self._on_offer = None if on_offer is None else np.array(on_offer)

    def fault(self, angles: Angles) -> str:
        """What is wrong with angles (rows, columns) [rad]; empty: they may be sent."""
        if angles.shape != self._shape:
            return f"axes must have the shape {self._shape}, got {angles.shape}"
        if not np.isfinite(angles).all():
            return "axes must be finite"
        if (np.abs(angles) > RIGHT_ANGLE).any():
            return f"axes must be between -pi/2 and pi/2, got {np.abs(angles).max():g} in them"
        if self._on_offer is not None:
            apart = np.abs(angles[..., np.newaxis] - self._on_offer).min(axis=-1)
            if apart.max() > 1e-9:
                worst = angles.ravel()[int(apart.argmax())]
                return f"axes must be some of those on offer, got {worst:g}"
        return ""


def within_right_angles(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same axes by angles [rad] from -pi/2 to pi/2: one turned by pi is the same."""
    turned = angles - math.pi * np.floor(angles / math.pi + 0.5)
    same: NDArray[np.float64] = np.where(np.abs(angles) <= 0.5 * math.pi, angles, turned)
    return same
