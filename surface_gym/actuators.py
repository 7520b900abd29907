"""How an axis obeys: how fast it turns, and which modules do not."""

import math
from dataclasses import dataclass

from surface_gym import bounds, checks


@dataclass(frozen=True)
class Actuators:
    """The modules' actuators.

    Raises:
        ValueError: a speed that is not positive, a share outside [0, 1], or a stuck module that
            is not a pair of a row and a column.
    """

    axis_speed: float = math.inf  # [rad/s] at which an axis turns, through the angles between
    stuck: tuple[tuple[int, int], ...] = ()  # (row, column) of modules that ignore commands
    stuck_share: float = 0.0  # [-] probability of any other to be stuck, drawn at each start

    def __post_init__(self) -> None:
        if self.axis_speed != math.inf:
            checks.positive("axis_speed", self.axis_speed, *bounds.AXIS_SPEED)
        checks.within("stuck_share", self.stuck_share, 0.0, 1.0)
        if not isinstance(self.stuck, (tuple, list)):
            raise ValueError(f"stuck must hold (row, column) pairs, got {self.stuck!r}")
        for module in self.stuck:
            if not (isinstance(module, tuple) and len(module) == 2):
                raise ValueError(f"stuck must hold (row, column) pairs, got {module!r}")
            for place in module:
                checks.integer("stuck", place, least=0)
