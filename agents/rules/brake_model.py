"""A model of a parcel on single modules: a square that slides, with Coulomb friction along axes."""

import math
from dataclasses import dataclass

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.core.actions import ActionKind
from surface_gym.lines import Line
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks.line import BRAKING, ROLLING_LOSS
from surface_gym.tasks.planning import LineObservation
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
        self._braking = BRAKING * share[:, np.newaxis]  # [m/s^2] of each module
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


MOST_AFTER = 24  # steps that axes are followed for after a period
COM_HEIGHT = 0.1  # [m] of the centre of mass: Table 1
SUPPORT_LOSS = 0.005 * GRAVITY  # [m/s^2] mu_support g of Table 1
ON_EDGE = 1e-6  # [m] an element so near the outline bears: observations are single precision
RECTANGLE = 0.999  # [-] of its rectangle that a base fills at least which is one
# Exponents of the ovals |x / a|^p + |y / b|^p = 1 that others are taken for; how much they fill.
POWERS = np.geomspace(1.2, 60.0, 200)
FILLS = np.array([math.gamma(1.0 + 1.0 / p) ** 2 / math.gamma(1.0 + 2.0 / p) for p in POWERS])


@dataclass(frozen=True, eq=False)
class ContactSpan:
    """Rows of elements under a parcel, rotors or supports, each as far as the base covers it."""

    place: Numbers  # (num_envs,) [m] x of the base's centroid past the zone's first edge
    middle: Numbers  # (num_envs,) [m] from the centroid to the middle of the base's length
    load: Numbers  # (num_envs,) [m] from the centroid to the load, along x
    half_length: Numbers  # (num_envs,) [m]
    row_reach: Numbers  # (num_envs, rows) [m] covered of a row to either side of `middle`; -1: none
    rotor: Booleans  # (num_envs, rows) the row is of rotors

    @property
    def rotor_share(self) -> Numbers:
        """(num_envs,) [-] of the elements under the parcel that are rotors, on average."""
        covered = np.maximum(0.0, self.row_reach)
        return (covered * self.rotor).sum(axis=1) / np.maximum(covered.sum(axis=1), ON_EDGE)


def contact_span(config: EnvConfig, seen: LineObservation) -> ContactSpan:
    """Estimate the contact span of parcels on a line; a base that is no rectangle is taken for an
    oval that fills as much.
    """
    line = config.chosen_line
    end = line.pitch_x * config.action_kind.columns
    rear = end - seen.rear_to_go
    # The size shown is the way from the rear to the centroid, straight on.
    place = rear + seen.reach
    half_length = np.maximum(0.5 * (seen.front_in_zone - rear), 0.5 * line.pitch_x)
    rows = config.action_kind.rows + 2
    y = line.pitch_y * (np.arange(rows) - (rows - 1) / 2.0) - seen.offset[:, np.newaxis]
    aside = np.abs(y) / (seen.half_width[:, np.newaxis] + ON_EDGE)
    power = np.interp(seen.fill, FILLS, POWERS)[:, np.newaxis]
    part = np.maximum(0.0, 1.0 - np.minimum(aside, 1.0) ** power) ** (1.0 / power)
    part = np.where(seen.fill[:, np.newaxis] > RECTANGLE, 1.0, part)
    row_reach = np.where(aside <= 1.0, part * half_length[:, np.newaxis] + ON_EDGE, -1.0)
    # Of a line, as many rows are of rotors as lie under the width.
    half_rows = np.full(len(y), config.action_kind.rows // 2)
    if isinstance(line, Line):
        under = np.floor((seen.half_width + ON_EDGE) / line.pitch_y).astype(np.int64)
        half_rows = np.clip(under, 1, half_rows)
    from_middle = np.abs(np.arange(rows) - (rows - 1) / 2.0)
    return ContactSpan(
        place=place,
        middle=0.5 * (rear + seen.front_in_zone) - place,
        load=seen.load_ahead,
        half_length=half_length,
        row_reach=row_reach,
        rotor=from_middle < half_rows[:, np.newaxis],
    )


@dataclass(frozen=True, eq=False)
class Braked:
    """State after a period and what its axes bring after it, and what took the speed in it; all
    (num_envs, options).
    """

    place: Numbers  # [m] of the centroid past the zone's first edge, once all axes have turned
    speed: Numbers  # [m/s] then
    braking: Numbers  # [m/s] that friction along the axes takes where it is nominal
    rolling: Numbers  # [m/s] that friction across them and on supports takes where it is nominal


@dataclass(frozen=True, eq=False)
class Frictions:
    """Friction as estimated, in parts of the nominal; (num_envs,) each."""

    braking: Numbers  # [-] along axes
    rolling: Numbers  # [-] across them, and on supports
    doubt: Numbers  # [-] standard deviation of `rolling`


class BrakeModel:
    """Predicts braking: the parcel's weight is shared by what is under it.

    Args:
        then: [rad] off 90 deg, to which all axes turn after the period: half braking at most.
    """

    def __init__(self, config: EnvConfig, then: float) -> None:
        self._then = then
        self._timing = config.timing
        self._columns = config.action_kind.columns
        self._pitch = config.chosen_line.pitch_x
        self._turn = config.actuators.axis_speed * config.timing.dt  # [rad] a step
        self._tail = 0  # steps in which axes turn after the period
        if self._turn != math.inf:
            self._tail = min(MOST_AFTER, math.ceil(0.25 * math.pi / self._turn))

    def predict(
        self,
        span: ContactSpan,
        speed: Numbers,
        frictions: Frictions,
        lean: Numbers,
        target: Numbers,
    ) -> Braked:
        """Predict the state a control period on.

        Args:
            speed: (num_envs,) [m/s] now.
            lean: (num_envs, columns) [rad] of each column's axes off 90 deg now.
            target: (num_envs, options, columns) [rad] to which they turn.
        """
        dt, steps = self._timing.dt, self._timing.steps
        place, half_length = span.place, span.half_length
        longest = 2.0 * half_length.max() + max(0.0, speed.max()) * dt * (steps + self._tail)
        first = np.floor((place + span.middle - half_length) / self._pitch).astype(np.int64)
        near = first[:, np.newaxis] + np.arange(math.ceil(longest / self._pitch) + 2)
        inside = (near >= 0) & (near < self._columns)
        column = np.clip(near, 0, self._columns - 1)
        start = np.where(inside, np.take_along_axis(lean, column, 1), 0.0)[:, np.newaxis, :]
        wide = np.broadcast_to(column[:, np.newaxis, :], (*target.shape[:2], near.shape[1]))
        to_turn = np.where(inside[:, np.newaxis], np.take_along_axis(target, wide, 2), 0.0) - start
        centre = self._pitch * (near + 0.5)[:, np.newaxis, :]
        middle, load = span.middle[:, np.newaxis], span.load[:, np.newaxis, np.newaxis]
        along, across = (part[:, np.newaxis] for part in (frictions.braking, frictions.rolling))
        x = np.repeat(place[:, np.newaxis], target.shape[1], axis=1)
        v = np.repeat(speed[:, np.newaxis], target.shape[1], axis=1)
        braking, rolling, loss = np.zeros_like(v), np.zeros_like(v), np.zeros_like(v)
        leant = start + to_turn
        turned = 0.0
        sine, cosine = np.sin(leant), np.cos(leant)
        for step in range(steps + self._tail):
            if step == steps:
                start, turned = leant, 0.0
                to_turn = np.where(inside[:, np.newaxis], self._then, 0.0) - start
            if self._tail:
                turned += self._turn
                leant = start + np.clip(to_turn, -turned, turned)
                sine, cosine = np.sin(leant), np.cos(leant)
            arm = centre - (x + 0.5 * dt * v)[:, :, np.newaxis]
            elements, rotors = _count_under(span, arm - middle[..., np.newaxis])
            per_rotor = _share_load(arm - load, elements, loss)
            per_element = per_rotor * elements
            per_rotor = per_rotor * rotors
            brake = BRAKING * (per_rotor * sine).sum(axis=-1)
            roll = ROLLING_LOSS * (per_rotor * cosine).sum(axis=-1)
            roll += SUPPORT_LOSS * (per_element - per_rotor).sum(axis=-1)
            loss = along * brake + across * roll
            slower = np.maximum(0.0, v - dt * loss)
            x += 0.5 * dt * (v + slower)
            v = slower
            if step < steps:
                braking += dt * brake
                rolling += dt * roll
        return Braked(x, v, braking, rolling)

    def lean_after(self, lean: Numbers, target: Numbers) -> Numbers:
        """Predict (num_envs, columns) [rad] off 90 deg a period on, turning to `target`."""
        most = self._turn * self._timing.steps
        return lean + np.clip(target - lean, -most, most)


def _count_under(span: ContactSpan, arm: Numbers) -> tuple[Numbers, Numbers]:
    """Count (num_envs, options, columns) the elements and the rotors of each column that bear."""
    far = np.abs(arm)
    elements, rotors = np.zeros_like(arm), np.zeros_like(arm)
    reach, rotor = span.row_reach, span.rotor
    for row in range(reach.shape[1]):
        covered = far <= reach[:, row, np.newaxis, np.newaxis]
        elements += covered
        rotors += covered & rotor[:, row, np.newaxis, np.newaxis]
    return elements, rotors


def _share_load(arm: Numbers, elements: Numbers, before: Numbers) -> Numbers:
    """Share the weight among the elements of each column (num_envs, options, columns) [-], as
    Eq. (1) does, cut off at nothing.

    Args:
        arm: (num_envs, options, columns) [m] of each column from the load.
        elements: (num_envs, options, columns) of each column that bear.
        before: (num_envs, options) [m/s^2] the deceleration of the last step, by which the load
            leans.
    """
    count = np.maximum(1.0, elements.sum(axis=-1))
    mean = (elements * arm).sum(axis=-1) / count
    apart = arm - mean[..., np.newaxis]
    spread = np.maximum((elements * apart**2).sum(axis=-1), 1e-9)
    slope = (before * COM_HEIGHT / GRAVITY - mean) / spread
    load = np.maximum(0.0, 1.0 / count[..., np.newaxis] + apart * slope[..., np.newaxis])
    load = np.where(elements > 0.0, load, 0.0)
    weight = np.maximum((load * elements).sum(axis=-1), 1e-9)
    shared: Numbers = load / weight[..., np.newaxis]
    return shared
