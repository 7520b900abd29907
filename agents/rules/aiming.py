"""A rule for driven modules: the choices whose friction brings a parcel nearest to a wanted motion.

Each task asks for a velocity of the parcel. The rule predicts one period of Coulomb friction for
every choice of the modules ahead of the parcel's centre and behind it, and takes the best pair.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.modules import (
    Belt,
    ModuleKind,
    OmniModule,
    PopUp,
    SteeredRoller,
    surface_velocities,
)
from surface_gym.tasks.base import BRAKING, ROLLING_LOSS

from ..base import Integers, Numbers
from .base import BaseRule, Decision, Observations

MOST_PAIRS = 3000  # pairs of choices to predict; with more, both halves do the same
SLOPE = 0.8  # [-] share of full braking on which the wanted speed near a place is based
CREEP = 4.0  # [1/s] wanted speed per distance from a place, where it is less
AHEAD = 0.02  # [s] time until a choice acts
NEAR_ENOUGH = 0.001  # [m] distance from a place at which a parcel should rest
BRISK = 1.0  # [m/s] least speed on the way to a zone's end
TO_MIDDLE = 2.0  # [1/s] wanted lateral speed per offset
TO_PATH = 8.0  # [1/s] wanted speed across a path per distance from it
STRAIGHTENING = 6.0  # [1/s] wanted turning speed per angle
FASTEST_TURN = 1.5  # [rad/s] maximum wanted turning speed
ONWARD = 0.8  # [m/s] wanted speed of a parcel that turns
# Tuned on other starts than the reported ones.


@dataclass(frozen=True)
class Target:
    """Target motion of parcels, arrays (num_envs,); infinite speeds ask for as much as possible."""

    vx: Numbers  # [m/s]
    vy: Numbers  # [m/s]
    omega: Numbers  # [rad/s]
    turn_weight: float  # [-] weight of the turning speed at half the base's length


Make = Callable[..., ModuleKind]


def towards(distance: Numbers) -> Numbers:
    """Return the speed (num_envs,) [m/s] from which a parcel stops in a distance [m]; signed."""
    far = np.abs(distance)
    speed = np.minimum(np.sqrt(2.0 * SLOPE * BRAKING * far), CREEP * far)
    return np.sign(distance) * speed


def _turn(angle: Numbers) -> Numbers:
    return np.clip(STRAIGHTENING * angle, -FASTEST_TURN, FASTEST_TURN)


def aim_aside(seen: Any) -> Target:
    """Sort: off the line to the asked side as fast as possible."""
    still = np.zeros(len(seen.side))
    return Target(seen.vx * (seen.side != 0.0) + (seen.side == 0.0), seen.side * 10.0, still, 0.0)


def aim_at_ratio(seen: Any) -> Target:
    """Slow: at the zone's end the asked share of the entry speed; before, at least `BRISK`."""
    # From the last column on, the parcel rolls for half a pitch.
    rolled = 2.0 * ROLLING_LOSS * 0.5 * seen.pitch[0]
    asked = np.sqrt((seen.ratio * seen.entry_speed) ** 2 + rolled)
    left = np.maximum(0.0, seen.to_end - 2.0 * seen.half_length)  # of the front
    most = np.sqrt(asked**2 + 2.0 * SLOPE * BRAKING * left)
    still = np.zeros(len(asked))
    return Target(np.minimum(most, np.maximum(asked, BRISK)), still, still, 0.01)


def aim_at_place(seen: Any) -> Target:
    """Stop: at rest at the asked place."""
    still = np.zeros(len(seen.to_go))
    left = seen.to_go - AHEAD * seen.vx
    return Target(towards(left) * (np.abs(seen.to_go) > NEAR_ENOUGH), still, still, 0.01)


def aim_at_angle(seen: Any) -> Target:
    """Orient: the asked angle, in the middle of the line."""
    onward = np.full(len(seen.theta), ONWARD)
    return Target(onward, -TO_MIDDLE * seen.offset, _turn(seen.angle - seen.theta), 3.0)


def aim_along_path(seen: Any) -> Target:
    """Track: along the path at the asked speed, and back to it."""
    slope = seen.slope[:, 0]
    cosine = 1.0 / np.sqrt(1.0 + slope * slope)
    along, across = seen.asked_speed, -TO_PATH * seen.cross_error
    return Target(
        (along - slope * across) * cosine, (slope * along + across) * cosine,
        _turn(-seen.theta), 0.1,
    )  # fmt: skip


@dataclass(frozen=True)
class Aim:
    """What driven modules do in a task, and the kinds of modules that are compared there."""

    target: Callable[[Any], Target]  # from the decoded observations of the task
    kinds: dict[str, Make]  # function by name that makes the modules from an acceleration
    alike: bool = False  # whether both halves do the same


def _of_speeds(kind: Make, *speeds: float, **more: Any) -> Make:
    return partial(kind, speeds=speeds, **more)


FINE = (0.0, *(0.01 * k for k in range(1, 61)), *(0.02 * k for k in range(31, 136)))  # [m/s]
SPEEDS = tuple(round(0.1 * k, 1) for k in range(1, 16))  # [m/s] of modules along a path
HEADINGS = tuple(math.radians(15.0 * k) for k in range(-6, 7))  # [rad] the same
CREEPING = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 2.0)  # [m/s] of modules that bring it to a place
TURNING = (0.0, 0.5, 1.0)  # [m/s] of modules that turn a parcel
SIDEWAYS = (1.0, 2.0, 3.0)  # [m/s] of modules that sort it
BELTS, POP_UP, STEERED, OMNI = "belts", "pop-up", "steered rollers", "omni-wheels"
AIMS: dict[str, Aim] = {
    "sort": Aim(
        aim_aside,
        {
            POP_UP: _of_speeds(PopUp, 2.0),
            STEERED: _of_speeds(SteeredRoller, *SIDEWAYS),
            OMNI: _of_speeds(OmniModule, *SIDEWAYS),
        },
    ),
    "slow": Aim(
        aim_at_ratio,
        {BELTS: _of_speeds(Belt, *FINE, headings=(0.0,), idle_outside=True)},
        alike=True,
    ),
    "stop": Aim(
        aim_at_place,
        {
            BELTS: _of_speeds(Belt, *CREEPING),
            STEERED: _of_speeds(SteeredRoller, *CREEPING, headings=(0.0, math.pi)),
            OMNI: _of_speeds(OmniModule, *CREEPING),
        },
        alike=True,
    ),
    "track": Aim(
        aim_along_path,
        {
            STEERED: _of_speeds(SteeredRoller, *SPEEDS, headings=HEADINGS),
            OMNI: _of_speeds(OmniModule, *SPEEDS, headings=HEADINGS),
        },
        alike=True,
    ),
    "orient": Aim(
        aim_at_angle,
        {
            STEERED: _of_speeds(SteeredRoller, *TURNING),
            OMNI: _of_speeds(OmniModule, *TURNING),
        },
    ),
}


class AimRule(BaseRule):
    """Choose the pair of choices whose friction brings the parcel nearest to its wanted motion.

    Args:
        config: configuration with actions "halves" and driven modules.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, tuple(AIMS), ("halves",))
        checks.one_of("modules", config.module_kind.drives, (True,))
        self._aim = AIMS[config.task_name]
        velocity = surface_velocities(config.modes[:-1])
        pairs = list(product(range(len(velocity)), repeat=2))
        if self._aim.alike or len(pairs) > MOST_PAIRS:
            pairs = [(k, k) for k in range(len(velocity))]
        self._pairs: Integers = np.array(pairs)
        self._velocity = velocity[self._pairs]  # (pairs, 2, 2) [m/s] ahead and behind
        self._period = config.control_period

    def _decide(self, observations: Observations, *_: Any) -> Decision:
        seen = self._config.decode(observations)
        motion = np.stack([*seen.velocity, seen.omega])
        cost = self._costs(motion, self._aim.target(seen), np.asarray(seen.half_length))
        return self._pairs[cost.argmin(axis=1)], None

    def _costs(self, motion: Numbers, wanted: Target, half_length: Numbers) -> Numbers:
        """Predict the squared distances (num_envs, pairs) from the wanted motion after a period."""
        vx, vy, omega = (each[:, np.newaxis] for each in motion)
        arm = 0.5 * half_length[:, np.newaxis]
        gyration = 2.0 / 3.0 * half_length[:, np.newaxis] ** 2  # [m^2] of a square
        change_x, change_y, turn = 0.0, 0.0, 0.0
        for half, lever in enumerate((arm, -arm)):
            slip_x = self._velocity[:, half, 0] - vx
            slip_y = self._velocity[:, half, 1] - vy - lever * omega
            slip = np.maximum(np.hypot(slip_x, slip_y), 1e-9)
            # Friction removes the slip at most; each half carries half of the parcel.
            share = 0.5 * np.minimum(1.0, BRAKING * self._period / slip)
            change_x = change_x + share * slip_x
            change_y = change_y + share * slip_y
            turn = turn + lever * share * slip_y / gyration
        off = (vx + change_x - wanted.vx[:, np.newaxis]) ** 2
        off = off + (vy + change_y - wanted.vy[:, np.newaxis]) ** 2
        edge = half_length[:, np.newaxis] * (omega + turn - wanted.omega[:, np.newaxis])
        return np.asarray(off + wanted.turn_weight * edge**2)
