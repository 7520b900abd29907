"""What a step, and the last digit of an axis, do to the end poses of Table 2."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from surface_gym import layouts
from surface_gym.paper.integration import COARSE, CONVERGED, Integration
from surface_gym.paper.sorting import displacement, run_table2
from surface_gym.paper.targets import SortingRun

# Halving the step, and another method altogether.
NEAR_THE_LIMIT = (
    (CONVERGED, Integration("explicit", CONVERGED.dt / 2.0)),
    (CONVERGED, Integration("implicit", 1e-3)),
)
# A tenth to either side: the sign function of Eq. (2) chatters, so a coarse step ends by chance
# somewhere within this.
ABOUT_COARSE = tuple(
    Integration("explicit", COARSE.dt * percent / 100.0) for percent in range(90, 111, 2)
)
# [rad] more than the 1e-15 within which an axis counts as at 90 deg.
LAST_DIGITS = (-4e-15, 0.0, 4e-15)


@dataclass(frozen=True)
class Spread:
    """How far apart several runs of the same row end, at most."""

    position: float  # [mm]
    angle: float  # [deg]


@dataclass(frozen=True)
class StepSpread(Spread):
    """How far apart several integrations end, at most."""

    integrations: tuple[Integration, ...]


Displacement = tuple[float, float, float]  # x, y, theta [m, m, deg]


def between_steps(
    runs: tuple[SortingRun, ...], integrations: tuple[Integration, ...]
) -> StepSpread:
    """Integrate the rows of Table 2 in several ways and compare where they end."""
    ends = [
        [displacement(run_table2(run, integration)) for integration in integrations] for run in runs
    ]
    return StepSpread(*_widest(ends), integrations)


def between_last_digits(runs: tuple[SortingRun, ...], integration: Integration) -> Spread:
    """Turn all axes of the layout by round-off and compare where the rows of Table 2 end.

    cos(90 deg) as float64 has it, 6e-17, is round-off of this kind. Rotors that lie across the
    motion then drag sideways with all of mu_max, one way or the other, by its sign.
    """
    return Spread(
        *_widest([[turned_end(run, turn, integration) for turn in LAST_DIGITS] for run in runs])
    )


def turned_end(run: SortingRun, turn: float, integration: Integration) -> Displacement:
    """Where a row of Table 2 ends with all axes turned by `turn` [rad]."""
    surface = layouts.sorting("S", run.side, tilt=math.radians(run.tilt))
    surface = replace(surface, axis=surface.axis + turn)
    return displacement(integration.run(surface, "S", run.speed, run.time))


def _widest(ends: Sequence[Sequence[Displacement]]) -> tuple[float, float]:
    """Largest distance [mm] and angle [deg] between ends of the same row."""
    pairs = [pair for row in ends for pair in combinations(row, 2)]
    return (
        max(1000.0 * math.dist(one[:2], other[:2]) for one, other in pairs),
        max(abs(one[2] - other[2]) for one, other in pairs),
    )
