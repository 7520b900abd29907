"""What uneven supports do to the end pose, by MuJoCo and by the analytic model.

Heights are held against the extended law of `uneven.py`. Stiffnesses are held against
`surface_gym.simulate` itself, whose `Surface.stiffness` is how a load distribution is randomised;
beside the heights they show which spread of it stands for how many micrometres.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym.simulation import simulate
from surface_gym.surface import Surface
from surface_gym.validation import simulation
from surface_gym.validation.cases import IMPLICIT, PARCEL, PUSHED, Case
from surface_gym.validation.recipe import RECIPE
from surface_gym.validation.uneven import end_pose

Array = NDArray[np.float64]

CASES = (Case(10.0), PUSHED)


@dataclass(frozen=True)
class Unevenness:
    """How unlike each other the elements are."""

    height: float = 0.0  # [m] standard deviation
    stiffness: float = 0.0  # [-] standard deviation of its logarithm

    @property
    def name(self) -> str:
        if self.height:
            return f"height {1e6 * self.height:g} um"
        return f"log stiffness {self.stiffness:g}"


EVEN = Unevenness()
UNEVEN = (
    Unevenness(height=1e-6),
    Unevenness(height=5e-6),
    Unevenness(height=20e-6),
    Unevenness(stiffness=0.3),
    Unevenness(stiffness=0.6),
    Unevenness(stiffness=1.2),
)


@dataclass(frozen=True)
class Draw:
    """A case on a drawn surface."""

    case: Case
    unevenness: Unevenness
    seed: int

    @property
    def surface(self) -> Surface:
        """The case's, its stiffness drawn."""
        return replace(
            self.case.surface, stiffness=np.exp(self.unevenness.stiffness * self._normal(1))
        )

    @property
    def heights(self) -> Array:
        """(rows, columns) [m]."""
        return self.unevenness.height * self._normal(0)

    def _normal(self, stream: int) -> Array:
        surface = self.case.surface
        rng = np.random.default_rng((self.seed, stream))
        return rng.standard_normal((surface.rows, surface.columns))


@dataclass(frozen=True, eq=False)
class Spread:
    """End poses on drawn surfaces, from those on the even one."""

    case: Case
    unevenness: Unevenness
    mujoco: Array  # (draws, 3) [mm, mm, deg]
    analytic: Array  # (draws, 3) [mm, mm, deg] on the same surfaces


def jobs(draws: int, seed: int) -> tuple[Draw, ...]:
    """For each case the even surface, then `draws` surfaces for each unevenness."""
    return tuple(
        Draw(case, unevenness, seed + k)
        for case in CASES
        for unevenness, count in ((EVEN, 1), *((uneven, draws) for uneven in UNEVEN))
        for k in range(count)
    )


def ends(draw: Draw) -> Array:
    """(2, 3) [m, m, rad] end poses by MuJoCo and by the analytic model."""
    case, surface, heights = draw.case, draw.surface, draw.heights
    start = (case.pose, case.velocity, case.duration)
    mujoco = simulation.simulate(surface, PARCEL, *start, heights=heights).pose[-1]
    if draw.unevenness.height > 0.0:
        analytic = end_pose(surface, PARCEL, *start, heights, RECIPE.stiffness, IMPLICIT.dt)
    else:
        analytic = simulate(surface, PARCEL, *start, IMPLICIT.dt, IMPLICIT.method).pose[-1]
    return np.stack([mujoco, analytic])


def spreads(draws: Sequence[Draw], results: Sequence[Array]) -> tuple[Spread, ...]:
    """The study, given the `ends` of the draws."""
    table = np.array(results) * [1e3, 1e3, 180.0 / math.pi]

    def of(case: Case, unevenness: Unevenness) -> Array:
        return table[[draw.case == case and draw.unevenness == unevenness for draw in draws]]

    return tuple(
        Spread(case, uneven, *np.moveaxis(of(case, uneven) - of(case, EVEN), 1, 0))
        for case in CASES
        for uneven in UNEVEN
    )


def root_mean_square(shifts: Array) -> tuple[float, float]:
    """Of (draws, 3) [mm, mm, deg]: distance [mm] and angle [deg]."""
    x, y, theta = np.mean(shifts**2, axis=0)
    return math.sqrt(x + y), math.sqrt(theta)
