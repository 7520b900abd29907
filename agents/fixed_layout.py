"""The paper's fixed layout as a controller: every axis at 45 deg from the start."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.mirror import SIDE
from surface_gym.settings import Settings


class FixedLayout:
    """Figure 6a: axes at -45 deg sort to y > 0, at +45 deg to y < 0, whatever the parcel does.

    Args:
        settings: of the environment it is to act in.

    Raises:
        ValueError: 45 or -45 deg is not among the orientations.
    """

    def __init__(self, settings: Settings) -> None:
        self._kind = settings.action_kind
        angles = np.array(settings.orientations)
        self._choice = {side: _index_of(angles, -side * math.pi / 4) for side in (1, -1)}

    def predict(
        self, observation: NDArray[np.float32], deterministic: bool = True
    ) -> tuple[Any, None]:
        """Action for an observation (features,), or actions for (lanes, features); and no state."""
        del deterministic  # it knows no other way
        observations = np.atleast_2d(observation)
        choice = np.where(observations[:, SIDE] > 0.0, self._choice[1], self._choice[-1])
        commands = np.repeat(choice[:, np.newaxis], self._kind.size, axis=1)
        actions = self._kind.encode(commands)
        return (actions[0] if observation.ndim == 1 else actions), None


def _index_of(angles: NDArray[np.float64], wanted: float) -> int:
    matches = np.nonzero(np.abs(angles - wanted) < 1e-6)[0]
    if not len(matches):
        raise ValueError(f"orientations must hold {wanted:.4f} rad, got {angles.tolist()}")
    return int(matches[0])
