"""What a step does to the end poses of Table 2."""

import math
from dataclasses import dataclass
from itertools import combinations

from surface_gym.paper.integration import CONVERGED, PAPER_STEP, Integration
from surface_gym.paper.sorting import displacement, run_table2
from surface_gym.paper.targets import SortingRun


@dataclass(frozen=True)
class Spread:
    """How far apart several integrations end, at most."""

    integrations: tuple[Integration, ...]
    position: float  # [mm]
    angle: float  # [deg]


# Halving the step, and another method altogether.
NEAR_THE_LIMIT = (
    (CONVERGED, Integration("explicit", CONVERGED.dt / 2.0)),
    (CONVERGED, Integration("implicit", 1e-3)),
)
# A tenth to either side: the sign function of Eq. (2) chatters, so a coarse step ends by chance
# somewhere within this.
ABOUT_PAPER_STEP = tuple(
    Integration("explicit", PAPER_STEP.dt * percent / 100.0) for percent in range(90, 111, 2)
)


def spread(runs: tuple[SortingRun, ...], integrations: tuple[Integration, ...]) -> Spread:
    """Integrate the rows of Table 2 in several ways and compare where they end."""
    position = angle = 0.0
    for run in runs:
        ends = [displacement(run_table2(run, integration)) for integration in integrations]
        for one, other in combinations(ends, 2):
            position = max(position, 1000.0 * math.dist(one[:2], other[:2]))
            angle = max(angle, abs(one[2] - other[2]))
    return Spread(integrations, position, angle)
