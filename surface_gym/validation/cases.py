"""The runs of Section 6: one box, one sorting layout, 37 tilts and one push."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from surface_gym import layouts
from surface_gym.paper import COARSE, Integration
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.simulation import simulate
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation import simulation
from surface_gym.validation.reach import under
from surface_gym.validation.recipe import RECIPE, Recipe

PARCEL = Parcel(Rectangle(0.25, 0.25), mass=5.48, com_height=0.1, inertia=5.70e-2)  # Table 5
TILTS = tuple(np.arange(5.0, 14.01, 0.25).tolist())  # [deg]
IMPLICIT = Integration("implicit", 1e-3)
EXPLICIT = COARSE  # the step that we infer Section 5 took


@dataclass(frozen=True)
class Case:
    """One start on the sorting layout of Figure 7."""

    tilt: float  # [deg]
    speed: float = 0.0  # [m/s] along x
    duration: float = 1.0  # [s]

    @property
    def name(self) -> str:
        return f"{self.tilt:g} deg" if self.speed == 0.0 else f"v0 = {self.speed:g} m/s"

    @cached_property
    def surface(self) -> Surface:
        return layouts.sorting(tilt=math.radians(self.tilt))

    @property
    def pose(self) -> tuple[float, float, float]:
        """(x, y, theta) [m, m, rad] at the start."""
        return layouts.start("S")

    @property
    def velocity(self) -> tuple[float, float, float]:
        """(vx, vy, omega) [m/s, m/s, rad/s] at the start."""
        return (self.speed, 0.0, 0.0)

    def mujoco(
        self, recipe: Recipe = RECIPE, heights: NDArray[np.float64] | None = None
    ) -> Trajectory:
        """The case in MuJoCo."""
        return simulation.simulate(
            self.surface, PARCEL, self.pose, self.velocity, self.duration, recipe, heights
        )

    def analytic(self, integration: Integration = IMPLICIT) -> Trajectory:
        """The case by the model of Section 3."""
        return simulate(
            self.surface,
            PARCEL,
            self.pose,
            self.velocity,
            self.duration,
            integration.dt,
            integration.method,
        )


PUSHED = Case(tilt=0.0, speed=0.9)
LONG = Case(tilt=5.0, duration=1.8)  # Figure 12c


@dataclass(frozen=True, eq=False)
class Run:
    """A case by MuJoCo and by the analytic model."""

    case: Case
    mujoco: Trajectory
    implicit: Trajectory  # at 1 ms
    explicit: Trajectory  # at 5 ms


def run(case: Case) -> Run:
    """A case by all three."""
    return Run(case, case.mujoco(), case.analytic(IMPLICIT), case.analytic(EXPLICIT))


def displacement(trajectory: Trajectory) -> NDArray[np.float64]:
    """(3,) [m, m, deg] from the start to the end."""
    x, y, theta = trajectory.pose[-1] - trajectory.pose[0]
    return np.array([x, y, math.degrees(theta)])


def is_sorted(case: Case, trajectory: Trajectory) -> bool:
    """Whether no rotor is left under the base at the end: it is out of the sorting zone."""
    return not (under(case.surface, PARCEL, trajectory.pose[-1]) & case.surface.rotor).any()
