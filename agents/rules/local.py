"""Rules by which each module decides for itself: thresholds, and a PID controller each.

Both are ideas of Bianchi, Brosed Dueso and Yagüe-Fabra, "Closed-Loop Control Strategies for a
Modular Under-Actuated Smart Surface: From Threshold-Based Logic to Decentralized PID Regulation",
Applied Sciences 15(14), 7628, 2025. They tried thresholds on a real surface, for sorting and
orienting, and simulated a PID for each module on two paths. What is here is written anew, with
values of our own.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.tasks import base, planning, track

from ..base import Booleans, Numbers, find_axes
from .base import BaseRule, Commands, Decision, Memory, Observations
from .steering import ModulePositions, Motion, line_positions, window_positions

# Found by trying, on other starts than any reported.
ASIDE = 5.0  # [m/s] to the side where Sort wants the parcel off: more than there ever is
CENTRING = 2.0  # [1/s] speed back to the line's middle per offset from it
STRAIGHTENING = 4.0  # [1/s] turning speed back to theta = 0 per angle off it
CROSSING = 16.0  # [1/s] speed back to a path per error across it
TURNING = 16.0  # [1/s] turning speed per angle left, near the asked angle
# [m rad/s^2] that a turn is planned to be slowed by, times the half length: less than half of what
# 90 deg everywhere does, so that a period too late is not too late.
END_OF_TURN = 1.0
CLOSE_ENOUGH = 0.025  # [rad] off the asked angle, where 0.035 is allowed: nothing left to turn
MOST_SUMMED = 0.1  # [m] of each component of the error: beyond, a PID winds up no more


@dataclass(frozen=True)
class LocalTask:
    """The part of a task that local rules need."""

    actions: str  # kind of action
    positions: Callable[[Any, Any], ModulePositions]
    motion: Callable[[Any], Motion]  # that the parcel has
    wanted: Callable[[Any], Motion]  # that it should have
    # [m/s] too little speed to one side, where a module leads; too much along x, where it brakes
    thresholds: tuple[float, float]
    gains: tuple[float, float, float]  # [-], [1/s], [s] of a PID


def _line_motion(seen: planning.LineObservation) -> Motion:
    return Motion(seen.vx, seen.vy, seen.omega)


def _path_motion(path: track.PathObservation) -> Motion:
    return Motion(*path.velocity, path.omega)


def _off_the_line(seen: planning.LineObservation) -> Motion:
    """Want a parcel straight on until it is wholly in the zone, then off to the asked side."""
    side = np.where(seen.wholly_in_zone, seen.side, 0.0)
    vy = np.where(side != 0.0, ASIDE * side, -CENTRING * seen.offset)
    return Motion(seen.vx, vy, -STRAIGHTENING * seen.theta)


def _turned(seen: planning.LineObservation) -> Motion:
    """Want a parcel straight on until it is wholly in the zone, then turning to the asked angle.

    Nothing is asked across: modules at 90 deg keep the parcel from drifting anyway.
    """
    left = seen.angle - seen.theta
    size = np.where(np.abs(left) > CLOSE_ENOUGH, np.abs(left), 0.0)
    fastest = np.sqrt(2.0 * END_OF_TURN / seen.half_length * size)
    omega = np.sign(left) * np.minimum(TURNING * size, fastest)
    return Motion(seen.vx, seen.vy, np.where(seen.wholly_in_zone, omega, 0.0))


def _along_path(path: track.PathObservation) -> Motion:
    """Want a parcel along the path at the asked speed, back to the path, and not turned."""
    # The slope 0.1 m ahead, which the parcel reaches while its velocity is being turned.
    cosine = 1.0 / np.sqrt(1.0 + path.slope[:, 1] ** 2)
    sine = path.slope[:, 1] * cosine
    across = -CROSSING * path.cross_error
    vx = path.asked_speed * cosine - across * sine
    vy = path.asked_speed * sine + across * cosine
    return Motion(vx, vy, -STRAIGHTENING * path.theta)


# Thresholds and gains were found by trying, on other starts than any reported. Sort asks for more
# speed than there is: any thresholds do. Orient ends turning: nothing may wind up.
LOCAL_TASKS = {
    "sort": LocalTask(
        "modules", line_positions, _line_motion, _off_the_line,
        (0.05, 0.05), (1.0, 1.0, 0.01),
    ),
    "orient": LocalTask(
        "modules", line_positions, _line_motion, _turned,
        (0.03, 0.2), (4.0, 0.0, 0.01),
    ),
    "track": LocalTask(
        "window", window_positions, _path_motion, _along_path,
        (0.12, 0.02), (1.0, 4.0, 0.01),
    ),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Above:
    """The parcel's point above each module, or where it would be if the parcel were larger."""

    velocity: Numbers  # (num_envs, modules, 2) [m/s] x and y
    error: Numbers  # (num_envs, modules, 2) [m/s] the velocity that it should have, less that
    under: Booleans  # (num_envs, modules) there is such a point


class LocalRule(BaseRule):
    """Every module, by the same rule and without its neighbours, from the error above it alone.

    Made for Sort and Orient with "modules", and for Track with "window".
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, tuple(LOCAL_TASKS))
        self._task = LOCAL_TASKS[config.task_name]
        checks.one_of("actions", config.actions, (self._task.actions,))
        self._axes = find_axes(config)

    @abstractmethod
    def _turn(self, above: Above, memory: Memory, fresh: Booleans) -> Decision:
        """Choose for each module (num_envs, modules), and what to remember (num_envs, ...)."""

    def _decide(self, observations: Observations, memory: Memory, fresh: Booleans) -> Decision:
        seen, task = self._config.decode(observations), self._task
        modules = task.positions(seen, self._kind)
        velocity = task.motion(seen).above(modules)
        above = Above(velocity, task.wanted(seen).above(modules) - velocity, modules.under)
        return self._turn(above, memory, fresh)


class ThresholdRule(LocalRule):
    """-45 or 45 deg where the parcel should go more to the one or the other side, else 0 deg where
    it is too fast, else 90 deg. After Bianchi et al. (2025), as cited above.
    """

    def _turn(self, above: Above, *_: Any) -> Decision:
        along, across = above.error[..., 0], above.error[..., 1]
        (aside, ahead), axes = self._task.thresholds, self._axes
        return np.select(
            [across > aside, across < -aside, along < -ahead],
            [axes.left, axes.right, axes.brake],
            axes.roll,
        ), None


class PidRule(LocalRule):
    """Each module's PID says by how much the velocity above it should change; it takes the
    orientation whose friction, in a period, comes nearest to that. A PID for each module is the
    idea of Bianchi et al. (2025), as cited above.

    A module with nothing above it yet is ready for the parcel as it would be there, but sums
    nothing up. The summed and the last error are remembered: (num_envs, 2, modules, 2).
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config)
        angles = np.array(config.chosen_orientations)
        self._direction = np.stack([np.cos(angles), np.sin(angles)], axis=-1)  # (choices, 2)
        self._period = config.control_period

    def _turn(self, above: Above, memory: Memory, fresh: Booleans) -> Decision:
        error = above.error
        none = np.zeros((len(error), 2, *error.shape[1:]))
        memory = none if memory is None else checks.alike("state", memory, none)
        began = fresh[:, np.newaxis, np.newaxis]
        summed = np.where(began, 0.0, memory[:, 0]) + self._period * error
        summed = np.clip(summed, -MOST_SUMMED, MOST_SUMMED)
        summed = np.where(above.under[..., np.newaxis], summed, 0.0)
        last = np.where(began, error, memory[:, 1])
        proportional, integral, derivative = self._task.gains
        change = derivative * (error - last) / self._period
        wanted = proportional * error + integral * summed + change
        miss = wanted[:, :, np.newaxis] - self._changes(above.velocity)
        choice: Commands = (miss**2).sum(axis=-1).argmin(axis=-1)
        return choice, np.stack([summed, error], axis=1)

    def _changes(self, velocity: Numbers) -> Numbers:
        """Compute by how much (num_envs, modules, choices, 2) [m/s] each orientation would change a
        velocity. Friction brakes along the axis, and at most to rest.
        """
        most = base.BRAKING * self._period
        along = np.clip(velocity @ self._direction.T, -most, most)
        return -along[..., np.newaxis] * self._direction
