"""The planner's own world: lanes of the simulator that all begin where an observation says."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surface_gym.lines import Field
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact
from surface_gym.settings import Settings

from .branching import GIVEN, Branching
from .start import FIELD_ZONE, start_of


class Model(Branching):
    """Lanes for a search: the physics at nominal friction, every module obeying at once.

    Args:
        settings: of the environment the planner acts in, with "halves" for actions.
        lanes: their number.
    """

    def __init__(self, settings: Settings, lanes: int) -> None:
        on_field = isinstance(settings.chosen_plant, Field)
        nominal = replace(
            settings,
            sensors=Exact(),
            randomisation=Randomisation(),
            actuators=Actuators(),
            zone=FIELD_ZONE if on_field else settings.zone,
        )
        super().__init__(nominal, lanes)

    def begin(self, observation: NDArray[np.float32]) -> None:
        """Put every lane where an observation (features,) says."""
        first = np.zeros(1, dtype=np.int64)
        self._batch.place(first, start_of(self._settings, observation))
        self._batch.begin(first)
        surfaces, sites = self._batch.surfaces, self.parcels.site
        if (sites != sites[0]).any():  # another zone: what no action sets must be straight
            surfaces.axis[1:] = surfaces.axis[0]
        surfaces.conditions[1:] = surfaces.conditions[0]
        for array in (*self._moves, *(getattr(self.parcels, name) for name in GIVEN)):
            array[1:] = array[0]
