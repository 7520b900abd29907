"""What a simulation gives back."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A parcel's motion, one row a step, the start first."""

    time: NDArray[np.float64]  # (T,) [s]
    pose: NDArray[np.float64]  # (T, 3) [m, m, rad] x, y, theta of the base's frame
    velocity: NDArray[np.float64]  # (T, 3) [m/s, m/s, rad/s] of that frame
    # (T,) the step that led here had no exact normal forces: fewer than three contacts, collinear,
    # or the load point outside their hull. A real parcel tips there.
    tipping: NDArray[np.bool_]
    # "duration"; "left the surface"; "nothing bears it", between the elements; "stopped", by the
    # paper's rule, explicit only
    end: str
