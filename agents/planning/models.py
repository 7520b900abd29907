"""Models that planners search: copies of an environment that begin as one and then branch."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch, Snapshot
from surface_gym.physics.types import GYRATION, HALF_LENGTH, RADIUS
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact
from surface_gym.state import OUT_OF_TIME, ParcelState
from surface_gym.tasks.start import Start

from ..base import axes_apart
from .nodes import BrakingProfile, SearchNodes, TurningAxes, braking_profile, is_under

Integers = NDArray[np.int64]
Numbers = NDArray[np.float64]

FIRST = np.zeros(1, dtype=np.int64)


class SearchModel:
    """Copies of an environment that a search branches.

    Args:
        config: of the environment as it is simulated.
        num_envs: copies.
    """

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        self.config = config
        self._kind = config.action_kind
        self._batch = Batch(config, num_envs)
        self._begun: Snapshot | None = None

    @property
    def size(self) -> int:
        """Copies there are."""
        return len(self._batch.outcome)

    @property
    def parcels(self) -> ParcelState:
        """Their state arrays."""
        return self._batch.parcels

    @property
    def choices(self) -> int:
        """Actions there are, for a model with "halves"."""
        return self._kind.choices**2

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Names of outcomes, by the numbers of `parcels.outcome`."""
        return self._batch.outcomes

    def uniform_action(self, angle: float) -> int:
        """Encode the action that turns all axes to the orientation on offer nearest to an angle."""
        apart = axes_apart(self.config.chosen_orientations, angle)
        both = np.full((1, self._kind.size), apart.argmin())
        return int(self._kind.encode(both)[0])

    def begin_at(self, start: Start) -> None:
        """Put every copy at a start."""
        self._batch.place(FIRST, start)
        self._batch.begin(FIRST)
        self.spread()

    def spread(self) -> None:
        """Put every copy where the first one is, and remember that place."""
        self._begun = self._batch.snapshot(0)
        self._batch.restore(self._begun)

    def advance(self, parents: Integers, actions: Integers) -> SearchNodes:
        """Branch, and move over a control period.

        Args:
            parents: (count,) copies to go on from, at most as many as there are.
            actions: (count,) of each.
        """
        count = len(parents)
        self._batch.fork(parents)
        commands = self._batch.surfaces.command.copy()
        commands[:count] = self._kind.commands(actions, count)
        self._batch.step(commands)
        return self.nodes(count)

    def nodes(self, count: int) -> SearchNodes:
        """View the first copies as nodes."""
        parcels = ParcelState._make(array[:count] for array in self.parcels)
        body, bodies = int(parcels.body[0]), self._batch.bodies
        # Zones that do not differ from parcel to parcel have one row.
        first_row, rows, first, columns = bodies.zone[body % len(bodies.zone)].tolist()
        return SearchNodes(
            parcels,
            float(bodies.body[body, HALF_LENGTH]),
            (first_row, rows, first, columns),
            self.config.chosen_line,
            self._batch.surfaces.conditions[0],
        )


class NominalModel(SearchModel):
    """A model of what an observation says: nominal friction, every module obeying at once.

    Args:
        config: of the environment that a planner acts in.
        num_envs: copies.
    """

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        nominal = replace(
            config, sensors=Exact(), randomisation=Randomisation(), actuators=Actuators()
        )
        super().__init__(nominal, num_envs)


class TrueModel(SearchModel):
    """A model of an environment as it is: parcel, friction, stiffness, stuck modules and axes.
    Sensors are exact; what they draw comes after all else that a start draws.

    Args:
        config: of the environment, with "halves" for actions.
        num_envs: copies.
    """

    def __init__(self, config: EnvConfig, num_envs: int) -> None:
        super().__init__(replace(config, sensors=Exact(), info=(), observe=()), num_envs)
        self._turns = config.actuators.axis_speed != math.inf
        self._profile: BrakingProfile | None = None

    def begin(self, options: dict[str, Any], seed: int) -> None:
        """Put every copy where an environment's `reset` with these arguments puts its parcel."""
        batch = self._batch
        batch.parcels.outcome[:] = OUT_OF_TIME
        batch.seed(0, np_random(seed)[0])
        batch.reset(FIRST, [options] if options else ())
        self.spread()
        nodes = super().nodes(1)
        self._profile = braking_profile(
            batch.bodies, int(batch.parcels.body[0]), nodes.line, nodes.braking, nodes.rolling_loss
        )

    def rewind(self) -> None:
        """Put the first copy back to where it began, or was left."""
        self._batch.restore(self._begun, 0)

    def step(self, action: int) -> SearchNodes:
        """Move the first copy over a control period, and leave it there."""
        self.rewind()
        nodes = self.advance(FIRST, np.array([action]))
        self._begun = self._batch.snapshot(0)
        return nodes

    def nodes(self, count: int) -> SearchNodes:
        """View the first copies as nodes."""
        nodes = super().nodes(count)
        return replace(
            nodes,
            corners=self._batch.bodies.corners[nodes.parcels.body[0]],
            profile=self._profile,
            turning=self._turning(nodes.parcels) if self._turns else None,
        )

    def _turning(self, parcels: ParcelState) -> TurningAxes:
        """Collect the axes beside some parcels."""
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
        """List rows and columns (nodes, modules) of a square that holds all modules within a radius
        [m] of (x, y), each (nodes, 1) [m]; some may lie beyond the surface.
        """
        line = self.config.chosen_line
        away = math.ceil(radius / min(line.pitch_x, line.pitch_y))
        up, along = np.mgrid[-away : away + 1, -away : away + 1]
        row = np.rint((y - line.origin[1]) / line.pitch_y).astype(np.int64)
        column = np.rint((x - line.origin[0]) / line.pitch_x).astype(np.int64)
        return row + up.ravel(), column + along.ravel()
