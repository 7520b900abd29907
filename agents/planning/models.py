"""Copies of an environment for searches, the nodes that they reach, and braking profiles.
A node is a state in a search. Elements are rotors and supports; supports hardly brake.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch, Snapshot
from surface_gym.physics.types import GYRATION, HALF_LENGTH, RADIUS
from surface_gym.state import ACROSS_FACTOR, ALONG_FACTOR, OUT_OF_TIME, BodyTable, ParcelState
from surface_gym.tasks import base, planning
from surface_gym.tasks.start import Start

from ..base import Booleans, Integers, Numbers, axes_apart

PIECE = 0.005  # [m] spacing of a braking profile along the line
ON_EDGE = 1e-9  # [m] round-off tolerance for points on an edge
PARTS = 8  # integration steps for a quarter turn


@dataclass(frozen=True, eq=False)
class BrakingProfile:
    """Deceleration by full braking along the middle of a line, for one parcel.

    Braking is weaker where supports or stuck modules carry a share of the parcel.
    """

    x: Numbers  # (places,) [m] centre of the parcel, increasing
    braking: Numbers  # (places,) [m/s^2] deceleration
    spent: Numbers  # (places,) [m^2/s^2] specific energy braked up to each place

    def braking_at(self, x: Numbers) -> Numbers:
        """Interpolate the deceleration [m/s^2] at positions (nodes,) [m]."""
        return np.interp(x, self.x, self.braking)

    def braking_distance(self, x: Numbers, speed: Numbers) -> Numbers:
        """Compute the distance [m] that full braking takes, for each position [m] and speed [m/s].

        Arguments and result have the shape (nodes,).
        """
        spent = np.interp(x, self.x, self.spent) + 0.5 * speed**2
        ends = np.interp(spent, self.spent, self.x)
        # There is no braking after the last place.
        beyond = np.maximum(0.0, spent - self.spent[-1])
        return np.maximum(0.0, ends - x) + 1e3 * beyond


def braking_profile(
    bodies: BodyTable, body: int, line: sg.lines.BaseLine, braking: float, rolling_loss: float
) -> BrakingProfile:
    """Compute the braking profile of a parcel, if all elements under the parcel bear equal loads.

    The parcel is in row `body` of the body table. `braking` [m/s^2] is the deceleration on rotors
    alone, if all axes are at 0 deg. `rolling_loss` [m/s^2] is the deceleration if all axes are at
    90 deg.
    """
    x = np.arange(line.column_edge(0), line.column_edge(line.columns), PIECE)
    row, column = np.indices((line.rows, line.columns)).reshape(2, -1)
    arm_x = line.origin[0] + line.pitch_x * column - x[:, np.newaxis]
    arm_y = line.origin[1] + line.pitch_y * row - line.line_y
    under = is_under(bodies, body, arm_x, np.broadcast_to(arm_y, arm_x.shape))
    obeying = (under & bodies.obeys[body].ravel()).sum(axis=1)
    share = obeying / np.maximum(1, under.sum(axis=1))
    # Never zero, so that `spent` increases.
    each = np.maximum(rolling_loss, share * braking)
    spent = np.concatenate([[0.0], np.cumsum(0.5 * (each[1:] + each[:-1]) * PIECE)])
    return BrakingProfile(x, each, spent)


def is_under(bodies: BodyTable, body: int, ahead: Numbers, left: Numbers) -> Booleans:
    """Return whether points (...) are under the base of the parcel in row `body` of a body table.

    `ahead` and `left` (...) [m] are x and y in the base's frame, with the centroid as its origin.
    """
    under: Booleans = np.hypot(ahead, left) <= bodies.body[body, RADIUS] + ON_EDGE
    for normal_x, normal_y, distance in bodies.edges[body]:
        under &= normal_x * ahead + normal_y * left <= distance + ON_EDGE
    return under


@dataclass(frozen=True, eq=False)
class TurningAxes:
    """The axes of the rotors near each node's parcel. Axes take time to turn."""

    angle: Numbers  # (nodes, rotors) [rad] of each axis
    arm_x: Numbers  # (nodes, rotors) [m] from a parcel's centre of mass
    arm_y: Numbers  # (nodes, rotors) [m]
    share: Numbers  # (nodes, rotors) [-] share of the parcel carried by an obeying rotor
    speed: float  # [rad/s] turning speed of axes
    gyration: float  # [m^2] inertia / mass

    @property
    def quarter_turn(self) -> float:
        """[s] time of an axis to turn by 90 deg."""
        return 0.5 * math.pi / self.speed

    def velocity_changes(self, braking: float) -> Numbers:
        """Compute changes of velocity (nodes, 3) [m/s, m/s, rad/s] while all axes turn to 90 deg.

        The parcels are assumed to run straight along the line in this time. `braking` [m/s^2] is
        the deceleration over axes at 0 deg.
        """
        most = self.share * (braking / self.speed)
        side = np.sign(np.sin(2.0 * self.angle))
        along = -most * (1.0 - np.abs(np.sin(self.angle)))
        across = -most * side * np.abs(np.cos(self.angle))
        turn = (self.arm_x * across - self.arm_y * along).sum(axis=1) / self.gyration
        return np.stack([along.sum(axis=1), across.sum(axis=1), turn], axis=-1)

    def braking_distance(self, x: Numbers, speed: Numbers, profile: BrakingProfile) -> Numbers:
        """Compute the stopping distance (nodes,) [m] if all axes turn to 0 deg now.

        The parcels are at `x` (nodes,) [m] with `speed` (nodes,) [m/s]. The profile gives the
        deceleration over axes at 0 deg.
        """
        apart = np.abs(self.angle - math.pi * np.round(self.angle / math.pi))
        shared = self.share / np.maximum(1e-9, self.share.sum(axis=1, keepdims=True))
        step = self.quarter_turn / PARTS
        way = np.zeros_like(speed)
        left = np.maximum(0.0, speed)
        for k in range(PARTS):
            then = np.maximum(0.0, apart - (k + 0.5) * step * self.speed)
            turned = (shared * np.cos(then)).sum(axis=1)
            taken = step * turned * profile.braking_at(x + way + 0.5 * step * left)
            after = np.maximum(0.0, left - taken)
            # A parcel that stops within a part does not move for all of it.
            lasts = np.where(taken > left, left / np.maximum(taken, 1e-12), 1.0)
            way += 0.5 * (left + after) * step * lasts
            left = after
        return way + profile.braking_distance(x + way, left)


@dataclass(frozen=True, eq=False)
class SearchNodes:
    """States in a search. A task computes their costs; see `surface_gym.tasks.planning.Nodes`."""

    parcels: ParcelState  # state arrays, one row per node
    half_length: float  # [m] half length of the base
    # first row, rows, first column, columns of the modules that obey
    zone: tuple[int, int, int, int]
    line: sg.lines.BaseLine
    conditions: Numbers  # (6,) factors of friction [-] and gravity [m/s^2], see `Surfaces`
    corners: Numbers | None = None  # (corners, 2) [m] corners of the base; None: a square
    profile: BrakingProfile | None = None  # None: rotors only
    turning: TurningAxes | None = None  # None: axes obey at once

    @property
    def braking(self) -> float:
        """[m/s^2] deceleration over axes at 0 deg."""
        return base.BRAKING * float(self.conditions[ALONG_FACTOR])

    @property
    def rolling_loss(self) -> float:
        """[m/s^2] deceleration over axes at 90 deg."""
        return base.ROLLING_LOSS * float(self.conditions[ACROSS_FACTOR])

    @property
    def quarter_turn(self) -> float:
        """Time [s] in which an axis turns by 90 deg. If axes turn at once, the time is 0."""
        return 0.0 if self.turning is None else self.turning.quarter_turn

    @property
    def vx(self) -> Numbers:
        """(nodes,) [m/s] speed along x when a turn of all axes to 90 deg ends."""
        vx = self.parcels.truth[:, 3]
        if self.turning is None:
            return vx
        left: Numbers = vx + self.turning.velocity_changes(self.braking)[:, 0]
        return np.maximum(np.minimum(0.0, vx), left)

    @property
    def braking_distance(self) -> Numbers:
        """(nodes,) [m] stopping distance along x if all axes turn to 0 deg now."""
        x, vx = self.parcels.truth[:, 0], self.parcels.truth[:, 3]
        if self.profile is None:
            return vx**2 / (2.0 * self.braking)
        if self.turning is None:
            return self.profile.braking_distance(x, vx)
        return self.turning.braking_distance(x, vx, self.profile)

    def reach(self, x: float, y: float) -> Numbers:
        """Return how far (nodes,) [m] the base extends from its centre in a direction (x, y)."""
        theta = self.parcels.truth[:, 2]
        if self.corners is None:
            return planning.square_reach(self.half_length, theta)
        cosine, sine = np.cos(theta), np.sin(theta)
        directions = np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1)
        farthest: Numbers = (directions @ self.corners.T).max(axis=1)
        # The corners of a disc are at its centre.
        return np.where(farthest > 0.0, farthest, self.half_length)


FIRST = np.zeros(1, dtype=np.int64)


class SearchModel:
    """Copies of an environment, for branching in a search."""

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        self.config = config
        self._kind = config.action_kind
        self._batch = Batch(config, num_envs)
        self.size, self.parcels = num_envs, self._batch.parcels
        self.choices = 0 if self._kind.continuous else self._kind.choices**2  # of actions "halves"
        self.outcomes = self._batch.outcomes  # names by number in `parcels.outcome`
        self._begun: Snapshot  # state in which a search begins

    def uniform_action(self, angle: float) -> int:
        """Return the action that turns all axes to the orientation closest to an angle [rad]."""
        apart = axes_apart(self.config.chosen_orientations, angle)
        both = np.full((1, self._kind.size), apart.argmin())
        return int(self._kind.encode(both)[0])

    def begin_at(self, start: Start) -> None:
        self._batch.place(FIRST, start)
        self._batch.begin(FIRST)
        self.spread()

    def spread(self) -> None:
        """Save the first copy's state as the search's start, and give all copies this state."""
        self._begun = self._batch.snapshot(0)
        self._batch.restore(self._begun)

    def advance(self, parents: Integers, actions: Integers) -> SearchNodes:
        """Set the first copies to the states of `parents`, apply actions, and move by a period.

        Copy k gets the state of copy `parents[k]`, and then the action `actions[k]`. The arrays
        `parents` and `actions` have the shape (count,).
        """
        count = len(parents)
        self._batch.fork(parents)
        commands = self._batch.surfaces.command.copy()
        commands[:count] = self._kind.commands(actions, count)
        self._batch.step(commands)
        return self.nodes(count)

    def nodes(self, count: int) -> SearchNodes:
        """Return the states of the first `count` copies as nodes."""
        parcels = ParcelState._make(array[:count] for array in self.parcels)
        body, bodies = int(parcels.body[0]), self._batch.bodies
        # Zones that are equal for all parcels have one row.
        first_row, rows, first, columns = bodies.zone[body % len(bodies.zone)].tolist()
        return SearchNodes(
            parcels,
            float(bodies.body[body, HALF_LENGTH]),
            (first_row, rows, first, columns),
            self.config.chosen_line,
            self._batch.surfaces.conditions[0],
        )


class NominalModel(SearchModel):
    """A model that begins at an observation, with nominal friction and axes that turn at once."""

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        nominal = replace(
            config,
            sensors=sg.sensors.Exact(),
            randomisation=sg.Randomisation(),
            actuators=sg.Actuators(),
        )
        super().__init__(nominal, num_envs)


class TrueModel(SearchModel):
    """A model with the true parcel, friction, stiffness, stuck modules and axes.

    Its sensors are exact. A seed gives the same parcel, friction and stuck modules as in an
    environment with other sensors, since a reset draws the sensors' random numbers last.
    """

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        super().__init__(replace(config, sensors=sg.sensors.Exact(), info=(), observe=()), num_envs)
        self._turns = config.actuators.axis_speed != math.inf
        self._profile: BrakingProfile | None = None

    def begin(self, options: dict[str, Any], seed: int) -> None:
        """Reset every copy to the start of the episode that the options and the seed define."""
        batch = self._batch
        batch.parcels.outcome[:] = OUT_OF_TIME
        batch.seed(0, np_random(seed)[0])
        batch.reset(FIRST, [options] if options else ())
        self.spread()
        self._find_profile()

    def _find_profile(self) -> None:
        """Compute the braking profile of the parcel with which the episode starts."""
        batch, nodes = self._batch, super().nodes(1)
        self._profile = braking_profile(
            batch.bodies, int(batch.parcels.body[0]), nodes.line, nodes.braking, nodes.rolling_loss
        )

    def rewind(self) -> None:
        """Restore the first copy to its saved state."""
        self._batch.restore(self._begun, 0)

    def step(self, action: int | Integers) -> SearchNodes:
        """Rewind, move the first copy by a control period, and save the new state for `rewind`."""
        self.rewind()
        nodes = self.advance(FIRST, np.array([action]))
        self._begun = self._batch.snapshot(0)
        return nodes

    def nodes(self, count: int) -> SearchNodes:
        nodes = super().nodes(count)
        return replace(
            nodes,
            corners=self._batch.bodies.corners[nodes.parcels.body[0]],
            profile=self._profile,
            turning=self._turning(nodes.parcels) if self._turns else None,
        )

    def _turning(self, parcels: ParcelState) -> TurningAxes:
        index, bodies, line = parcels.body[0], self._batch.bodies, self.config.chosen_line
        body = bodies.body[index]
        x, y, theta = parcels.truth[:, :3].T[..., np.newaxis]
        row, column = self._beside(x, y, float(body[RADIUS]))
        inside = (row >= 0) & (row < line.rows) & (column >= 0) & (column < line.columns)
        from_x = line.origin[0] + line.pitch_x * column - x
        from_y = line.origin[1] + line.pitch_y * row - y
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        ahead = np.cos(theta) * from_x + np.sin(theta) * from_y
        left = np.cos(theta) * from_y - np.sin(theta) * from_x
        under = inside & is_under(bodies, index, ahead, left)
        share = (under & bodies.obeys[index][row, column]) / np.maximum(
            1, under.sum(axis=1, keepdims=True)
        )
        node = np.arange(len(x))[:, np.newaxis]
        angle = self._batch.surfaces.angle[node, row, column]
        speed = self.config.actuators.axis_speed
        arm_x = from_x + x - parcels.state[:, :1]
        arm_y = from_y + y - parcels.state[:, 1:2]
        return TurningAxes(angle, arm_x, arm_y, share, speed, float(body[GYRATION]))

    def _beside(self, x: Numbers, y: Numbers, radius: float) -> tuple[Integers, Integers]:
        """Return the rows and columns (nodes, modules) of the modules around each node's point.

        A node's point is at `x`, `y` (nodes, 1) [m]. The modules form a square, which contains all
        modules within `radius` [m] of the point. The square may extend beyond the surface.
        """
        line = self.config.chosen_line
        away = math.ceil(radius / min(line.pitch_x, line.pitch_y))
        up, along = np.mgrid[-away : away + 1, -away : away + 1]
        row = np.rint((y - line.origin[1]) / line.pitch_y).astype(np.int64)
        column = np.rint((x - line.origin[0]) / line.pitch_x).astype(np.int64)
        return row + up.ravel(), column + along.ravel()
