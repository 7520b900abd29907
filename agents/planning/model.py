"""The planner's own world: lanes of the simulator that all begin where an observation says."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from agents.angles import axes_apart
from agents.planning.start import FIELD_ZONE, start_of
from surface_gym.actuators import Actuators
from surface_gym.lanes.memory import OUT_OF_TIME, Lanes
from surface_gym.parcel import Parcel
from surface_gym.plant import Field
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Exact
from surface_gym.settings import Settings

Integers = NDArray[np.int64]

# What sets lanes apart that began as one. Axes do not: an action of halves sets all that obey.
_MOVES = ("state", "truth", "sensed", "clock", "steps", "memory", "terms", "outcome", "observation")
# What else a start says, and what follows from its parcel.
_GIVEN = ("surface", "goal", "path")
_OF_PARCEL = ("axis", "rotor", "obeys", "body", "edges", "corners", "zone")


class Model:
    """Lanes for a search: the physics at nominal friction, every module obeying at once.

    Args:
        settings: of the environment the planner acts in, with "halves" for actions.
        lanes: their number.
    """

    def __init__(self, settings: Settings, lanes: int) -> None:
        on_field = isinstance(settings.chosen_task.plant, Field)
        self._settings = replace(
            settings,
            sensors=Exact(),
            randomisation=Randomisation(),
            actuators=Actuators(),
            zone=FIELD_ZONE if on_field else settings.zone,
        )
        self._kind = self._settings.action_kind
        self._batch = self._settings.make_batch(lanes)
        self._parcel: Parcel | None = None
        self._generator = np.random.default_rng(0)  # nothing is drawn from it

    @property
    def lanes(self) -> Lanes:
        """Their memory."""
        return self._batch.lanes

    @property
    def choices(self) -> int:
        """Actions there are."""
        return self._kind.choices**2

    def uniform_action(self, angle: float) -> int:
        """The action that turns all axes to the orientation on offer nearest to an angle [rad]."""
        apart = axes_apart(self._settings.orientations, angle)
        both = np.full((1, self._kind.size), apart.argmin())
        return int(self._kind.encode(both)[0])

    def begin(self, observation: NDArray[np.float32]) -> None:
        """Put every lane where an observation (features,) says."""
        start = start_of(self._settings, observation)
        self._batch.place(0, start, self._generator)
        self._batch.begin(np.zeros(1, dtype=np.int64))
        names: tuple[str, ...] = (*_MOVES, *_GIVEN)
        if start.parcel is not self._parcel:
            names = (*names, *_OF_PARCEL)
            self._parcel = start.parcel
        for name in names:
            array = getattr(self.lanes, name)
            array[1:] = array[0]

    def advance(self, parents: Integers, actions: Integers) -> Lanes:
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
        commands = lanes.command.copy()
        commands[:count] = self._kind.commands(actions, count)
        self._batch.advance(commands)
        return Lanes._make(array[:count] for array in lanes)
