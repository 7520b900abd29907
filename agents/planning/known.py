"""The world as it is: lanes of the simulator that all begin as one start of an environment does."""

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from surface_gym.physics.types import GYRATION, RADIUS
from surface_gym.sensors import Exact
from surface_gym.settings import Settings
from surface_gym.state import OUT_OF_TIME, ParcelState

from .branching import Branching
from .grip import Grip, grip_of, is_under
from .stand import Stand
from .turning import Turning

Integers = NDArray[np.int64]
Numbers = NDArray[np.float64]

FIRST = np.zeros(1, dtype=np.int64)


class KnownModel(Branching):
    """Lanes for a search: parcel, friction, stiffness, stuck modules and axes as the environment
    has them. Sensors are exact; what they draw comes after all else that a start draws.

    Args:
        settings: of the environment, with "halves" for actions.
        lanes: their number.
    """

    def __init__(self, settings: Settings, lanes: int) -> None:
        super().__init__(replace(settings, sensors=Exact(), info=(), observe=()), lanes)
        surfaces = self._batch.surfaces
        self._turns = settings.actuators.axis_speed != math.inf
        if self._turns:
            self._moves += [surfaces.angle, surfaces.target, surfaces.direction]
        self._begun: list[NDArray[Any]] = []
        self._grip: Grip | None = None

    @property
    def outcomes(self) -> tuple[str, ...]:
        """How an episode may stand, by the numbers of `ParcelState.outcome`."""
        return self._batch.outcomes

    def begin(self, options: dict[str, Any], seed: int) -> None:
        """Put every lane where an environment's `reset` with these arguments puts its parcel."""
        batch = self._batch
        batch.parcels.outcome[:] = OUT_OF_TIME
        batch.seed(0, np_random(seed)[0])
        batch.start(FIRST, [options] if options else ())
        for array in cast(tuple[NDArray[Any], ...], (*batch.surfaces, *batch.parcels)):
            array[1:] = array[:1]
        self._begun = [array[:1].copy() for array in self._moves]
        stand = super()._stand(batch.parcels)
        self._grip = grip_of(
            batch.bodies, int(batch.parcels.site[0]), stand.plant, stand.braking, stand.rolling_loss
        )

    def rewind(self) -> None:
        """Put the first lane back to where it began, or was left."""
        for array, begun in zip(self._moves, self._begun, strict=True):
            array[:1] = begun

    def go_on(self, action: int) -> Stand:
        """Move the first lane over a period, and leave it there."""
        self.rewind()
        stand = self.advance(FIRST, np.array([action]))
        self._begun = [array[:1].copy() for array in self._moves]
        return stand

    def _stand(self, lanes: ParcelState) -> Stand:
        stand = super()._stand(lanes)
        site, sites = lanes.site[0], self._batch.bodies
        turning = self._turning(lanes) if self._turns else None
        return replace(stand, corners=sites.corners[site], grip=self._grip, turning=turning)

    def _turning(self, lanes: ParcelState) -> Turning:
        """The axes beside the parcels of some lanes."""
        site, sites, plant = lanes.site[0], self._batch.bodies, self._settings.chosen_plant
        body = sites.body[site]
        x, y, theta = lanes.truth[:, :3].T[..., np.newaxis]
        row, column = self._beside(x, y, float(body[RADIUS]))
        inside = (row >= 0) & (row < plant.rows) & (column >= 0) & (column < plant.columns)
        from_x = plant.origin[0] + plant.pitch_x * column - x
        from_y = plant.origin[1] + plant.pitch_y * row - y
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        ahead = np.cos(theta) * from_x + np.sin(theta) * from_y
        left = np.cos(theta) * from_y - np.sin(theta) * from_x
        under = inside & is_under(sites, site, ahead, left)
        share = (under & sites.obeys[site][row, column]) / np.maximum(
            1, under.sum(axis=1, keepdims=True)
        )
        lane = np.arange(len(x))[:, np.newaxis]
        angle = self._batch.surfaces.angle[lane, row, column]
        speed = self._settings.actuators.axis_speed
        arm_x = from_x + x - lanes.state[:, :1]
        arm_y = from_y + y - lanes.state[:, 1:2]
        return Turning(angle, arm_x, arm_y, share, speed, float(body[GYRATION]))

    def _beside(self, x: Numbers, y: Numbers, radius: float) -> tuple[Integers, Integers]:
        """(lanes, modules) rows and columns of a square that holds all that lie within a radius [m]
        of (x, y), each (lanes, 1) [m]; some may be none of the plant's.
        """
        plant = self._settings.chosen_plant
        away = math.ceil(radius / min(plant.pitch_x, plant.pitch_y))
        up, along = np.mgrid[-away : away + 1, -away : away + 1]
        row = np.rint((y - plant.origin[1]) / plant.pitch_y).astype(np.int64)
        column = np.rint((x - plant.origin[0]) / plant.pitch_x).astype(np.int64)
        return row + up.ravel(), column + along.ravel()
