"""Lanes of the simulator that all begin alike and go apart by what they are told."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.core.batch import Batch
from surface_gym.physics.types import HALF_LENGTH
from surface_gym.settings import Settings
from surface_gym.state import OUT_OF_TIME, ParcelState

from ..angles import axes_apart
from .stand import Stand

Integers = NDArray[np.int64]

# What sets lanes apart that began as one. Axes that obey at once do not: an action of halves sets
# all of them.
_MOVES = (
    "state", "truth", "sensed", "clock", "period", "steps", "on_rotors", "on_surface", "memory",
    "figures", "terms", "outcome", "observation",
)  # fmt: skip
# What else a start says.
GIVEN = ("goal", "path", "site")


class Branching:
    """Lanes for a search.

    Args:
        settings: of the environment that is searched, with "halves" for actions.
        lanes: their number.
    """

    def __init__(self, settings: Settings, lanes: int) -> None:
        self._settings = settings
        self._kind = settings.action_kind
        self._batch = Batch(settings, lanes)
        self._moves: list[NDArray[Any]] = [getattr(self.parcels, name) for name in _MOVES]

    @property
    def lanes(self) -> ParcelState:
        """Their memory."""
        return self._batch.parcels

    @property
    def choices(self) -> int:
        """Actions there are."""
        return self._kind.choices**2

    def uniform_action(self, angle: float) -> int:
        """The action that turns all axes to the orientation on offer nearest to an angle [rad]."""
        apart = axes_apart(self._settings.chosen_orientations, angle)
        both = np.full((1, self._kind.size), apart.argmin())
        return int(self._kind.encode(both)[0])

    def advance(self, parents: Integers, actions: Integers) -> Stand:
        """Make the first lanes copies of their parents (count,), move them over a period and show
        them.

        Args:
            parents: lanes to go on from, at most as many as there are lanes.
            actions: (count,) of each.
        """
        lanes, count = self.parcels, len(parents)
        for array in self._moves:
            array[:count] = array[parents]
        lanes.outcome[count:] = OUT_OF_TIME  # nobody waits for them
        commands = self._batch.surfaces.command.copy()
        commands[:count] = self._kind.commands(actions, count)
        self._batch.advance(commands)
        return self._stand(ParcelState._make(array[:count] for array in lanes))

    def _stand(self, lanes: ParcelState) -> Stand:
        site, sites = lanes.site[0], self._batch.bodies
        first_row, rows, first_column, columns = sites.zone[site].tolist()
        return Stand(
            lanes,
            float(sites.body[site, HALF_LENGTH]),
            (first_row, rows, first_column, columns),
            self._settings.chosen_plant,
            self._batch.surfaces.conditions[0],
        )
