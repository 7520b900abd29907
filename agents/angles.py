"""How far axes are apart: one that is turned by pi is the same."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

SAME = 1e-6  # [rad] axes closer than this are one


def axes_apart(one: ArrayLike, other: ArrayLike) -> NDArray[np.float64]:
    """[rad] from 0 to pi / 2 between axis angles [rad], which broadcast."""
    turned = np.exp(2j * (np.asarray(one) - np.asarray(other)))
    apart: NDArray[np.float64] = np.abs(np.angle(turned)) / 2.0
    return apart
