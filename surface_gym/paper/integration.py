"""The two time steps at which everything is reproduced."""

from dataclasses import dataclass
from typing import Literal

from surface_gym import layouts
from surface_gym.simulation import simulate
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory


@dataclass(frozen=True)
class Integration:
    """A method and its step."""

    method: Literal["implicit", "explicit"]
    dt: float  # [s]

    def run(self, surface: Surface, size: str, speed: float, duration: float) -> Trajectory:
        """Start the "S" or "B" box where the paper does, at `speed` [m/s] along x."""
        return simulate(
            surface,
            layouts.box(size),
            layouts.start(size),
            (speed, 0.0, 0.0),
            duration,
            self.dt,
            self.method,
        )


# The paper prints no step. Of the round ones, 5 ms gives its tables, step error included.
PAPER_STEP = Integration("explicit", 5e-3)
# The same equations in the limit; `convergence.py` measures how near it is.
CONVERGED = Integration("explicit", 5e-5)
