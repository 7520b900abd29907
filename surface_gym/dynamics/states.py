"""State vectors of the centre of mass, from the motion of the base's frame."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from surface_gym.dynamics.types import OMEGA, STATE_SIZE, THETA, VX, VY, Array, X, Y


def each(function: Callable[[float], float], values: Any) -> Any:
    """By Python's own function, of a number or of each (count,): NumPy's differ in the last digit
    from one machine to the next.
    """
    if np.ndim(values) == 0:
        return function(values)
    return np.array([function(value) for value in values.tolist()])


def states_of(centre: Array, pose: Array, velocity: Array) -> Array:
    """(count, STATE_SIZE) at rest or in steady motion.

    Args:
        centre: (count, 2) [m] centre of mass in the base's frame.
        pose: (count, 3) of the frame.
        velocity: (count, 3) of the frame.
    """
    state = np.zeros((len(pose), STATE_SIZE))
    state[:, X : THETA + 1] = pose
    state[:, VX : OMEGA + 1] = velocity
    if centre.any():
        cosine, sine = each(math.cos, pose[:, 2]), each(math.sin, pose[:, 2])
        arm_x = cosine * centre[:, 0] - sine * centre[:, 1]
        arm_y = sine * centre[:, 0] + cosine * centre[:, 1]
        state[:, X] += arm_x
        state[:, Y] += arm_y
        state[:, VX] -= velocity[:, 2] * arm_y
        state[:, VY] += velocity[:, 2] * arm_x
    return state
