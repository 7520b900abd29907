"""Section 6.2: up to which tilt a box on axes at 45 deg stops by itself; and how a held one creeps.

The study says that the motion does not stop by itself where (sqrt(2) / 2) mu_min < sin(gamma).
Axes at +45 deg everywhere, a box of weight W = m g cos(gamma) on them, gravity m g sin(gamma) along
x. Each rotor resists in two directions: along its axis with mu_max N at most, across it with
mu_min N. Half of gravity's effect lies along the axes and half across, m g sin(gamma) / sqrt(2)
each way.

- Along the axes friction holds it: mu_max is large, so F_par = m g sin(gamma) / sqrt(2), no more.
- Across them the box rolls, and stops if mu_min W >= m g sin(gamma) / sqrt(2):

      tan(gamma) <= sqrt(2) mu_min.

The study's threshold sets the rolling friction's part along x, mu_min W / sqrt(2), against all of
gravity, as if F_par had no part along x. But F_par is what holds the box against sliding downhill
along the axes, and its part along x, m g sin(gamma) / 2, carries half of gravity: the other half is
left for the rolling friction. What the study's threshold does tell is where F_par = 0 solves the
rule of Figure 5b, sum F_x = 0: below it that rule would need axes that push.

In alternate rows at +45 and -45 deg no direction rolls on both kinds. Straight ahead every rotor
resists with (mu_max + mu_min) N / sqrt(2), so that the box stops up to

      tan(gamma) = (mu_max + mu_min) / sqrt(2).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym import layouts
from surface_gym.paper.integration import Integration
from surface_gym.paper.tables import Track, untracked
from surface_gym.physics.friction import ROUNDING
from surface_gym.simulation import simulate
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory

METHODS = (Integration("implicit", 5e-3), Integration("explicit", 1e-3))
PUSH = 0.05  # [m/s] along x at the start
LONGEST = 60.0  # [s]
STEEPEST = 30.0  # [deg]
RESOLUTION = 0.005  # [deg] of a threshold
ELEMENTS = 80  # of the field's sides
START = (1.0, 7.0, 0.0)  # [m, m, rad]
# [m/s] The explicit method leaves a box that it holds some mm/s, to and fro.
STANDING = 0.02


@dataclass(frozen=True)
class SelfStop:
    """Up to which tilt a pushed box stops by itself."""

    layout: str
    integration: Integration
    measured: float  # [deg]
    expected: float  # [deg] by the balance above
    study: float | None  # [deg] as Section 6.2 says; None: it does not speak of this layout


def uniform(tilt: float) -> Surface:
    """Axes at +45 deg on a wide field tilted by `tilt` [rad]."""
    return _field(np.full((ELEMENTS, ELEMENTS), 0.25 * math.pi), tilt)


def alternate(tilt: float) -> Surface:
    """Axes at +45 and -45 deg in alternate rows of a wide field tilted by `tilt` [rad]."""
    rows = np.where(np.arange(ELEMENTS) % 2, 0.25 * math.pi, -0.25 * math.pi)
    return _field(np.tile(rows[:, np.newaxis], ELEMENTS), tilt)


def _field(axis: NDArray[np.float64], tilt: float) -> Surface:
    return Surface(axis, np.ones(axis.shape, dtype=bool), tilt=tilt)


def self_stopping(track: Track = untracked) -> tuple[SelfStop, ...]:
    """Both fields by both methods."""
    rolling = uniform(0.0)
    study = math.degrees(math.asin(math.sqrt(0.5) * rolling.mu_min))
    one = math.degrees(math.atan(math.sqrt(2.0) * rolling.mu_min))
    both = math.degrees(math.atan(math.sqrt(0.5) * (rolling.mu_max + rolling.mu_min)))
    cases = tuple(
        (name, field, integration, expected, printed)
        for name, field, expected, printed in (
            ("+45° everywhere", uniform, one, study),
            ("±45° in alternate rows", alternate, both, None),
        )
        for integration in METHODS
    )
    return tuple(
        SelfStop(name, integration, steepest_stop(field, integration), expected, printed)
        for name, field, integration, expected, printed in track(cases, "Self-stopping")
    )


def steepest_stop(field: Callable[[float], Surface], integration: Integration) -> float:
    """[deg] the tilt at which a pushed box just stops by itself, by bisection."""
    low, high = 0.0, STEEPEST
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        if stops(field(math.radians(middle)), integration):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def stops(surface: Surface, integration: Integration) -> bool:
    """Whether the S-box, pushed, stands in the last quarter of the time."""
    run = _push(surface, integration)
    speed = np.hypot(run.velocity[:, 0], run.velocity[:, 1])
    return run.end != "left the surface" and bool(speed[-len(speed) // 4 :].mean() < STANDING)


def _push(surface: Surface, integration: Integration) -> Trajectory:
    return simulate(
        surface,
        layouts.box("S"),
        START,
        (PUSH, 0.0, 0.0),
        LONGEST,
        integration.dt,
        integration.method,
    )


def creep_speed(tilt: float, friction: float) -> float:
    """[m/s] of a parcel that friction holds in the direction of the slope.

    Friction is rounded below a contact speed of 1e-5 m/s, in proportion to the speed; a held parcel
    creeps at the speed at which it balances gravity.

    Args:
        tilt: [rad].
        friction: [-] coefficient down the slope, above tan(tilt).
    """
    return ROUNDING * math.tan(tilt) / friction
