"""Each module's own place under the parcel, and how the parcel moves over it."""

from dataclasses import dataclass

import numpy as np

from surface_gym.core.actions import ActionKind

from ..sight import LineSight, PathSight
from .lane_rule import Booleans, Numbers

MIDWAY = 1e-9  # [m] nearer than this to midway between two rows or columns is midway


@dataclass(frozen=True, eq=False)
class Places:
    """Where the modules of an action are, from the parcel's centre; all (lanes, modules)."""

    x: Numbers  # [m]
    y: Numbers  # [m]
    under: Booleans  # a module lies under the parcel, taken as a square


def _places(x: Numbers, y: Numbers, theta: Numbers, half_length: Numbers) -> Places:
    """Places from those of the columns (lanes, columns) and the rows (lanes, rows)."""
    lanes, shape = len(x), (len(x), y.shape[1], x.shape[1])
    x = np.broadcast_to(x[:, np.newaxis, :], shape).reshape(lanes, -1)
    y = np.broadcast_to(y[:, :, np.newaxis], shape).reshape(lanes, -1)
    cosine, sine = np.cos(theta)[:, np.newaxis], np.sin(theta)[:, np.newaxis]
    along, across = cosine * x + sine * y, cosine * y - sine * x
    under = np.maximum(np.abs(along), np.abs(across)) <= half_length[:, np.newaxis]
    return Places(x, y, under)


def line_places(see: LineSight, kind: ActionKind) -> Places:
    """The zone's modules, in the order of "modules"."""
    pitch_x, pitch_y = see.pitch
    column = pitch_x * (np.arange(kind.columns) + 0.5)
    row = pitch_y * (np.arange(kind.rows) - (kind.rows - 1) / 2.0)
    return _places(
        column - see.into_zone[:, np.newaxis],
        row - see.offset[:, np.newaxis],
        see.theta,
        see.half_length,
    )


def window_places(see: PathSight, kind: ActionKind) -> Places:
    """The modules around the parcel, in the order of "window"."""
    rows, columns = kind.shape
    pitch_x, pitch_y = see.pitch
    return _places(
        pitch_x * (np.arange(columns) - columns // 2) - _past(see.x_in_pitch, pitch_x),
        pitch_y * (np.arange(rows) - rows // 2) - _past(see.y_in_pitch, pitch_y),
        see.theta,
        see.half_length,
    )


def _past(in_pitch: Numbers, pitch: float) -> Numbers:
    """(lanes, 1) [m] past the window's middle: midway, that is the module ahead or to the left."""
    midway = in_pitch > pitch / 2.0 - MIDWAY
    return np.where(midway, in_pitch - pitch, in_pitch)[:, np.newaxis]


@dataclass(frozen=True, eq=False)
class Motion:
    """A plane motion of the parcel; all (lanes,)."""

    vx: Numbers  # [m/s]
    vy: Numbers  # [m/s]
    omega: Numbers  # [rad/s]

    def over(self, places: Places) -> Numbers:
        """(lanes, modules, 2) [m/s] x and y, of the parcel's point above each module."""
        omega = self.omega[:, np.newaxis]
        vx = self.vx[:, np.newaxis] - omega * places.y
        vy = self.vy[:, np.newaxis] + omega * places.x
        return np.stack([vx, vy], axis=-1)
