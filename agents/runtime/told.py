"""What the device was told, and how it is found."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.state import SurfaceState


@dataclass
class Told:
    """Axes that the device was told to turn to."""

    command: int  # its number
    at: float  # [s] from which on they turn
    target: NDArray[np.float64]  # (rows, columns) [rad] of the whole surface's


@dataclass(frozen=True, eq=False)
class Resolver:
    """Turns commands of one kind into axes; see `Shadow.resolve`."""

    obey: Callable[..., None]  # the compiled function
    surfaces: SurfaceState  # the shadow's, with room for such commands


@dataclass
class Sent:
    """A command of which the device has yet to say that it took it."""

    command: int
    decided: float  # [s] when
    before: float  # [s] from the latest frame until then
    turn: float  # [s] that the axes take
