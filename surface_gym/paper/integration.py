"""The methods and steps by which everything is reproduced."""

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

    def __str__(self) -> str:
        return f"{self.method}, {1000 * self.dt:g} ms"

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


# The paper prints no step. That it was about 5 ms is our inference, from what its tables agree
# with and from its run times; `steps.py` measures how little the tables tell.
COARSE = Integration("explicit", 5e-3)
# The same equations in the limit; `convergence.py` measures how near it is.
CONVERGED = Integration("explicit", 5e-5)
# The method of the environments, which does not chatter: what tips a box in it is no chatter.
SMOOTH = Integration("implicit", 1e-3)
INTEGRATIONS = (COARSE, CONVERGED, SMOOTH)


def tipping_share(trajectory: Trajectory, end: int | None = None) -> float | None:
    """[-] of the steps up to a row, or to the last, the share in which the parcel would tip.

    Eq. (1) has no solution there; the simulation takes the forces that bear the weight and come
    nearest to its moments. None where there is no step.
    """
    steps = trajectory.tipping[1:] if end is None else trajectory.tipping[1 : end + 1]
    return float(steps.mean()) if len(steps) else None
