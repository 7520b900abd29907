"""Lanes of the simulator that all begin alike, each over axes that stay as they were arranged."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from surface_gym.core.batch import Batch
from surface_gym.physics.types import HALF_LENGTH
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact
from surface_gym.settings import Settings
from surface_gym.state import OUT_OF_TIME, RUNNING, ParcelState
from surface_gym.tasks.base import Start

from .stand import Stand

Integers = NDArray[np.int64]


class LayoutModel:
    """Lanes for a search of layouts: the physics at nominal friction, every module obeying at once.

    Args:
        settings: of the environment that the layout is for.
        lanes: their number.
    """

    def __init__(self, settings: Settings, lanes: int) -> None:
        self.settings = replace(
            settings, sensors=Exact(), randomisation=Randomisation(), actuators=Actuators()
        )
        self._batch = Batch(self.settings, lanes)
        self._begun: tuple[NDArray[np.generic], ...] = ()

    @property
    def size(self) -> int:
        """How many lanes there are."""
        return len(self._batch.outcome)

    @property
    def lanes(self) -> ParcelState:
        """Their memory."""
        return self._batch.parcels

    @property
    def axis(self) -> NDArray[np.int32]:
        """(lanes, rows, columns) the place of each axis among the orientations, to read and write;
        actions set those of the zone.
        """
        axis: NDArray[np.int32] = self._batch.surfaces.axis
        return axis

    @property
    def commands(self) -> NDArray[np.int64]:
        """(lanes, command size) what the zone's modules are told, to read and write."""
        return self._batch.surfaces.command

    def begin(self, start: Start) -> None:
        """Put every lane at a start, all axes at 90 deg."""
        first = np.zeros(1, dtype=np.int64)
        self._batch.place(first, start)
        self._batch.begin(first)
        surfaces = self._batch.surfaces
        surfaces.axis[:] = len(self.settings.chosen_orientations)  # the conveyor's
        surfaces.conditions[1:] = surfaces.conditions[0]
        self._begun = tuple(array[:1].copy() for array in self.parcels)
        self.rewind(self.size)

    def rewind(self, count: int) -> None:
        """Put the first lanes back to the start; nobody waits for the others."""
        arrays = cast(tuple[NDArray[Any], ...], self.parcels)
        for array, begun in zip(arrays, self._begun, strict=True):
            array[:] = begun
        self.parcels.outcome[count:] = OUT_OF_TIME

    def branch(self, parents: Integers) -> Stand:
        """Make the first lanes copies of their parents (count,), axes and all; nobody waits for the
        others.
        """
        count = len(parents)
        for array in (*self.parcels, self.axis, self.commands):
            array[:count] = array[parents]
        self.parcels.outcome[count:] = OUT_OF_TIME
        return self.stand(count)

    def advance(self) -> bool:
        """Move every lane that runs over a period; whether one still does."""
        self._batch.advance(self.commands)
        return bool((self.parcels.outcome == RUNNING).any())

    def stand(self, count: int) -> Stand:
        """How the first lanes stand; a view."""
        lanes, sites = self.parcels, self._batch.bodies
        site = int(lanes.site[0])
        # Zones that do not differ from parcel to parcel have one row.
        first_row, rows, first, columns = sites.zone[site % len(sites.zone)].tolist()
        return Stand(
            ParcelState._make(array[:count] for array in lanes),
            float(sites.body[site, HALF_LENGTH]),
            (first_row, rows, first, columns),
            self.settings.chosen_plant,
            self._batch.surfaces.conditions[0],
        )

    def run(self, layouts: Integers) -> Stand:
        """Let a parcel run from the start to the episode's end over each of some layouts.

        Args:
            layouts: (count, rows, columns) the place of each axis of the widest zone among the
                orientations; at most as many as there are lanes.
        """
        count = len(layouts)
        self.rewind(count)
        self.commands[:count] = layouts.reshape(count, -1)
        for _ in range(self.settings.chosen_task.periods):
            if not self.advance():
                break
        return self.stand(count)
