"""Rules that predict the motion of a period: sliding mode along a path, and turning.

The prediction is that of a square that slides on single modules, with Coulomb friction along axes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.core.actions import ActionKind
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks import base, planning, track

from ..base import Booleans, Numbers, find_axes
from .base import BaseRule, Commands, Decision, Observations

MIDWAY = 1e-9  # [m] nearer than this to midway between two rows or columns is midway


@dataclass(frozen=True, eq=False)
class ModulePositions:
    """Modules of an action, seen from the parcel's centre; all (num_envs, modules)."""

    x: Numbers  # [m]
    y: Numbers  # [m]
    under: Booleans  # a module lies under the parcel, taken as a square


def _positions(x: Numbers, y: Numbers, theta: Numbers, half_length: Numbers) -> ModulePositions:
    """Combine the positions of columns (num_envs, columns) and of rows (num_envs, rows)."""
    num_envs, shape = len(x), (len(x), y.shape[1], x.shape[1])
    x = np.broadcast_to(x[:, np.newaxis, :], shape).reshape(num_envs, -1)
    y = np.broadcast_to(y[:, :, np.newaxis], shape).reshape(num_envs, -1)
    cosine, sine = np.cos(theta)[:, np.newaxis], np.sin(theta)[:, np.newaxis]
    along, across = cosine * x + sine * y, cosine * y - sine * x
    under = np.maximum(np.abs(along), np.abs(across)) <= half_length[:, np.newaxis]
    return ModulePositions(x, y, under)


def line_positions(seen: planning.LineObservation, kind: ActionKind) -> ModulePositions:
    """Locate the zone's modules, in the order of "modules"."""
    pitch_x, pitch_y = seen.pitch
    column = pitch_x * (np.arange(kind.columns) + 0.5)
    row = pitch_y * (np.arange(kind.rows) - (kind.rows - 1) / 2.0)
    return _positions(
        column - seen.into_zone[:, np.newaxis],
        row - seen.offset[:, np.newaxis],
        seen.theta,
        seen.half_length,
    )


def window_positions(path: track.PathObservation, kind: ActionKind) -> ModulePositions:
    """Locate the modules around the parcel, in the order of "window"."""
    rows, columns = kind.shape
    pitch_x, pitch_y = path.pitch
    return _positions(
        pitch_x * (np.arange(columns) - columns // 2) - _past(path.x_in_pitch, pitch_x),
        pitch_y * (np.arange(rows) - rows // 2) - _past(path.y_in_pitch, pitch_y),
        path.theta,
        path.half_length,
    )


def _past(in_pitch: Numbers, pitch: float) -> Numbers:
    """(num_envs, 1) [m] past the window's middle: midway, that is the module ahead or left."""
    midway = in_pitch > pitch / 2.0 - MIDWAY
    return np.where(midway, in_pitch - pitch, in_pitch)[:, np.newaxis]


@dataclass(frozen=True, eq=False)
class Motion:
    """A plane motion of the parcel; all (num_envs,)."""

    vx: Numbers  # [m/s]
    vy: Numbers  # [m/s]
    omega: Numbers  # [rad/s]

    def above(self, modules: ModulePositions) -> Numbers:
        """Compute (num_envs, modules, 2) [m/s] of the parcel's point above each module."""
        omega = self.omega[:, np.newaxis]
        vx = self.vx[:, np.newaxis] - omega * modules.y
        vy = self.vy[:, np.newaxis] + omega * modules.x
        return np.stack([vx, vy], axis=-1)


class SquareModel:
    """Evenly loaded squares on modules."""

    def __init__(self, modules: ModulePositions, half_length: Numbers, tilt: Numbers) -> None:
        self._x, self._y = modules.x[:, np.newaxis], modules.y[:, np.newaxis]
        self._gyration = (2.0 / 3.0 * half_length**2)[:, np.newaxis]  # [m^2] of a square
        share = modules.under / np.maximum(1, modules.under.sum(axis=1))[:, np.newaxis]
        self._braking = base.BRAKING * share[:, np.newaxis]  # [m/s^2] of each module
        self._pull = (GRAVITY * np.sin(tilt))[:, np.newaxis]

    def predict(self, motion: Motion, angles: Numbers, period: float, steps: int) -> Motion:
        """Predict the motion a period on, in (num_envs, options).

        Args:
            angles: (options, modules) or (num_envs, options, modules) [rad] axes to predict for.
        """
        dt = period / steps
        cosine, sine = np.cos(angles), np.sin(angles)
        arm = self._x * sine - self._y * cosine  # [m] of each axis about the centre
        # Friction grows to its most over the speed that a step of it takes: it overshoots none.
        soft = base.BRAKING * dt * (1.0 + arm**2 / self._gyration[..., np.newaxis])
        vx, vy, omega = (v[:, np.newaxis] for v in (motion.vx, motion.vy, motion.omega))
        for _ in range(steps):
            slip = (
                vx[..., np.newaxis] * cosine
                + vy[..., np.newaxis] * sine
                + omega[..., np.newaxis] * arm
            )
            taken = dt * self._braking * np.clip(slip / soft, -1.0, 1.0)
            vx = vx + dt * self._pull - (taken * cosine).sum(axis=-1)
            vy = vy - (taken * sine).sum(axis=-1)
            omega = omega - (taken * arm).sum(axis=-1) / self._gyration
        return Motion(vx, vy, omega)


STEPS = 4  # that a period is predicted in
PARTS = 6  # that the modules are shared in
# A lattice that spreads any share of the modules evenly: powers of the plastic number's inverse.
SPREAD = (0.7548776662466927, 0.5698402909980532)

# All weights were found by trying, on other starts than any reported.
# Of the sliding mode, so steep that most of a distance to the surface is the error across the path
# a period on:
SLOPE = 60.0  # [1/s] of the surface: speed across the path per error across it
SPEED_WEIGHT = 24.0  # [-] of the squared speed error, against the squared distance to the surface
TURN_WEIGHT = 1.5  # [-] of the squared speed of turning, at the base's edge
STRAIGHTENING = 4.0  # [1/s] turning speed back to theta = 0 per angle off it
# Of the turning rule:
END_OF_TURN = 2.2  # [m rad/s^2] that 90 deg everywhere slows a turn by, times the half length
SPEED_WORTH = 0.11  # [rad s/m] off the asked angle that a loss of speed is as bad as
DRIFT_WORTH = 0.3  # [rad s/m] off the asked angle that a speed across the line is as bad as
CLOSE_ENOUGH = 0.015  # [rad] off the asked angle, where 0.035 is allowed: as good as on it
WORTH_IT = 0.004  # [rad] by which turning must be better than rolling
# [-] of the half length ahead of and behind the centre, from where on modules turn the parcel.
FROM = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


def mixes(parts: int) -> Commands:
    """List (mixes, 3) the parts that roll, lead to a side and brake, in every sum to the whole."""
    side, brake = np.indices((parts + 1, parts + 1)).reshape(2, -1)
    whole = side + brake <= parts
    return np.stack([parts - side - brake, side, brake], axis=-1)[whole]


def leading_options(config: EnvConfig) -> Commands:
    """List (options, modules) choices of a window's modules: mixes to either side, spread twice."""
    axes = find_axes(config)
    rows, columns = config.action_kind.shape
    row, column = np.indices((rows, columns))
    order = np.modf(SPREAD[0] * row + SPREAD[1] * column)[0]
    spreads = np.stack([order.ravel(), order[::-1].ravel()])  # and its mirror image
    rolls, leads, _ = mixes(PARTS).T / PARTS
    first = rolls[:, np.newaxis, np.newaxis] > spreads + 1e-9
    second = (rolls + leads)[:, np.newaxis, np.newaxis] > spreads + 1e-9
    options = [
        np.select([first, second], [axes.roll, side], axes.brake).reshape(-1, rows * columns)
        for side in (axes.left, axes.right)
    ]
    return np.unique(np.concatenate(options), axis=0)


class SlidingMode(BaseRule):
    """Track: sliding along s = speed across the path + SLOPE x error across it = 0.

    Every period it takes the mix of axes that should bring the parcel nearest to that surface,
    with the asked speed along the path and without turning. Every heading but 0 and 45 deg takes
    a mix, since there is no axis that rolls along it.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("track",), ("window",))
        self._options = leading_options(config)
        self._angles = np.array(config.chosen_orientations)[self._options]
        self._period = config.control_period

    def _decide(self, observations: Observations, *_: Any) -> Decision:
        path: track.PathObservation = self._config.decode(observations)
        vx, vy = path.velocity
        model = SquareModel(window_positions(path, self._kind), path.half_length, path.tilt)
        motion = Motion(vx, vy, path.omega)
        after = model.predict(motion, self._angles, self._period, STEPS)
        best = self._regret(path, vx, after).argmin(axis=1)
        return self._options[best], None

    def _regret(self, path: track.PathObservation, vx: Numbers, after: Motion) -> Numbers:
        """Sum (num_envs, options) squared speeds off the surface and the asked speed."""
        # The path's heading where the parcel will be.
        ahead = np.clip(vx * self._period / track.AHEAD[1], 0.0, 1.0)
        slope = path.slope[:, 0] + ahead * (path.slope[:, 1] - path.slope[:, 0])
        cosine = (1.0 / np.sqrt(1.0 + slope**2))[:, np.newaxis]
        sine = slope[:, np.newaxis] * cosine
        along = cosine * after.vx + sine * after.vy
        across = cosine * after.vy - sine * after.vx
        mean = 0.5 * (path.cross_speed[:, np.newaxis] + across)
        off = across + SLOPE * (path.cross_error[:, np.newaxis] + self._period * mean)
        late = along - path.asked_speed[:, np.newaxis]
        theta = path.theta[:, np.newaxis]
        turn = after.omega + STRAIGHTENING * (theta + self._period * after.omega)
        edge = path.half_length[:, np.newaxis] * turn
        return off**2 + SPEED_WEIGHT * late**2 + TURN_WEIGHT * edge**2


class TurningRule(BaseRule):
    """Orient: 45 deg one way ahead of the centre and the other way behind it turn the parcel, and
    90 deg everywhere ends that. Each period, those modules turn it that should make it come to
    rest nearest to the asked angle, speed and drift counted in.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("orient",), ("modules",))
        self._axes = find_axes(config)
        self._angles = np.array(config.chosen_orientations)
        self._period = config.control_period

    def _decide(self, observations: Observations, *_: Any) -> Decision:
        seen: planning.LineObservation = self._config.decode(observations)
        modules = line_positions(seen, self._kind)
        options = self._options(seen, modules)
        model = SquareModel(modules, seen.half_length, np.zeros_like(seen.theta))
        motion = Motion(seen.vx, seen.vy, seen.omega)
        after = model.predict(motion, self._angles[options], self._period, STEPS)
        best = self._regret(seen, after).argmin(axis=1)
        return options[np.arange(len(best)), best], None

    def _options(self, seen: planning.LineObservation, modules: ModulePositions) -> Commands:
        axes = self._axes
        x = modules.x[:, np.newaxis]
        inside = seen.wholly_in_zone[:, np.newaxis, np.newaxis]
        start = (FROM * seen.half_length[:, np.newaxis])[..., np.newaxis]
        ahead, behind = inside & (x > start), inside & (x < -start)
        options = [np.full_like(x, axes.roll, dtype=np.int64)]
        for front, rear in ((axes.left, axes.right), (axes.right, axes.left)):
            options += [
                np.select([ahead, behind], [front, rear], axes.roll),
                np.where(ahead, front, axes.roll),
                np.where(behind, rear, axes.roll),
            ]
        return np.concatenate(options, axis=1)

    def _regret(self, seen: planning.LineObservation, after: Motion) -> Numbers:
        """Compute (num_envs, options) [rad] off the asked angle at rest, or what is as bad."""
        turn = 0.5 * self._period * (seen.omega[:, np.newaxis] + after.omega)
        end = after.omega * np.abs(after.omega) * seen.half_length[:, np.newaxis]
        left = (seen.angle - seen.theta)[:, np.newaxis] - turn - end / (2.0 * END_OF_TURN)
        off = np.maximum(0.0, np.abs(left) - CLOSE_ENOUGH)
        regret = off - SPEED_WORTH * after.vx + DRIFT_WORTH * np.abs(after.vy)
        regret[:, 0] -= WORTH_IT
        return regret
