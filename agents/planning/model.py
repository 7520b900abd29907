"""The planner's own world: lanes of the simulator that all begin where an observation says."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym.actuators import Actuators
from surface_gym.batch.batch import Batch
from surface_gym.dynamics.types import HALF_LENGTH
from surface_gym.lanes.memory import OUT_OF_TIME, Lanes
from surface_gym.plants import Field, Plant
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Exact
from surface_gym.settings import Settings

from ..angles import axes_apart
from .start import FIELD_ZONE, start_of

Integers = NDArray[np.int64]

# What sets lanes apart that began as one. Axes do not: an action of halves sets all that obey.
_MOVES = (
    "state", "truth", "sensed", "clock", "steps", "memory", "figures", "terms", "outcome",
    "observation",
)  # fmt: skip
# What else a start says.
_GIVEN = ("goal", "path", "site")


@dataclass(frozen=True, eq=False)
class Stand:
    """How the lanes of a search stand: some of their rows, and what is the same for all."""

    lanes: Lanes
    half_length: float  # [m] of the base
    zone: tuple[int, int, int, int]  # first row, rows, first column, columns that obey
    plant: Plant


class Model:
    """Lanes for a search: the physics at nominal friction, every module obeying at once.

    Args:
        settings: of the environment the planner acts in, with "halves" for actions.
        lanes: their number.
    """

    def __init__(self, settings: Settings, lanes: int) -> None:
        on_field = isinstance(settings.chosen_plant, Field)
        self._settings = replace(
            settings,
            sensors=Exact(),
            randomisation=Randomisation(),
            actuators=Actuators(),
            zone=FIELD_ZONE if on_field else settings.zone,
        )
        self._kind = self._settings.action_kind
        self._batch = Batch(self._settings, lanes)

    @property
    def lanes(self) -> Lanes:
        """Their memory."""
        return self._batch.lanes

    def _stand(self, lanes: Lanes) -> Stand:
        site, sites = lanes.site[0], self._batch.sites
        first_row, rows, first_column, columns = sites.zone[site].tolist()
        return Stand(
            lanes,
            float(sites.body[site, HALF_LENGTH]),
            (first_row, rows, first_column, columns),
            self._settings.chosen_plant,
        )

    @property
    def choices(self) -> int:
        """Actions there are."""
        return self._kind.choices**2

    def uniform_action(self, angle: float) -> int:
        """The action that turns all axes to the orientation on offer nearest to an angle [rad]."""
        apart = axes_apart(self._settings.chosen_orientations, angle)
        both = np.full((1, self._kind.size), apart.argmin())
        return int(self._kind.encode(both)[0])

    def begin(self, observation: NDArray[np.float32]) -> None:
        """Put every lane where an observation (features,) says."""
        first = np.zeros(1, dtype=np.int64)
        self._batch.place(first, start_of(self._settings, observation))
        self._batch.begin(first)
        surfaces, sites = self._batch.surfaces, self.lanes.site
        if (sites != sites[0]).any():  # another zone: what no action sets must be straight
            surfaces.axis[1:] = surfaces.axis[0]
        surfaces.conditions[1:] = surfaces.conditions[0]
        for name in (*_MOVES, *_GIVEN):
            array = getattr(self.lanes, name)
            array[1:] = array[0]

    def advance(self, parents: Integers, actions: Integers) -> Stand:
        """Make the first lanes copies of their parents (count,), move them over a period and show
        them.

        Args:
            parents: lanes to go on from, at most as many as there are lanes.
            actions: (count,) of each.
        """
        lanes, count = self.lanes, len(parents)
        for name in _MOVES:
            array = getattr(lanes, name)
            array[:count] = array[parents]
        lanes.outcome[count:] = OUT_OF_TIME  # nobody waits for them
        commands = self._batch.surfaces.command.copy()
        commands[:count] = self._kind.commands(actions, count)
        self._batch.advance(commands)
        return self._stand(Lanes._make(array[:count] for array in lanes))
