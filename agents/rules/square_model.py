"""A model of a parcel on single modules: a square that slides, with Coulomb friction along axes."""

from dataclasses import dataclass

import numpy as np

from surface_gym.core.actions import ActionKind
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks.line import BRAKING
from surface_gym.tasks.observed import LineObservation
from surface_gym.tasks.track import PathObservation

from .base import Booleans, Numbers

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


def line_positions(seen: LineObservation, kind: ActionKind) -> ModulePositions:
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


def window_positions(path: PathObservation, kind: ActionKind) -> ModulePositions:
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

    def over(self, modules: ModulePositions) -> Numbers:
        """Compute (num_envs, modules, 2) [m/s] of the parcel's point above each module."""
        omega = self.omega[:, np.newaxis]
        vx = self.vx[:, np.newaxis] - omega * modules.y
        vy = self.vy[:, np.newaxis] + omega * modules.x
        return np.stack([vx, vy], axis=-1)


class SquareModel:
    """Evenly loaded squares on modules.

    Args:
        modules: taken to stay where they are under the parcel.
        half_length: (num_envs,) [m] of the base.
        tilt: (num_envs,) [rad] of the surface, downhill towards +x.
    """

    def __init__(self, modules: ModulePositions, half_length: Numbers, tilt: Numbers) -> None:
        self._x, self._y = modules.x[:, np.newaxis], modules.y[:, np.newaxis]
        self._gyration = (2.0 / 3.0 * half_length**2)[:, np.newaxis]  # [m^2] of a square
        share = modules.under / np.maximum(1, modules.under.sum(axis=1))[:, np.newaxis]
        self._braking = BRAKING * share[:, np.newaxis]  # [m/s^2] of each module
        self._pull = (GRAVITY * np.sin(tilt))[:, np.newaxis]

    def predict(self, motion: Motion, angles: Numbers, period: float, steps: int) -> Motion:
        """Predict the motion a period on, in (num_envs, options).

        Args:
            motion: now.
            angles: (options, modules) or (num_envs, options, modules) [rad] axes to predict for.
            period: [s] predicted.
            steps: that it is cut into.
        """
        dt = period / steps
        cosine, sine = np.cos(angles), np.sin(angles)
        arm = self._x * sine - self._y * cosine  # [m] of each axis about the centre
        # Friction grows to its most over the speed that a step of it takes: it overshoots none.
        soft = BRAKING * dt * (1.0 + arm**2 / self._gyration[..., np.newaxis])
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
