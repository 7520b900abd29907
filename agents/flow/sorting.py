"""An agent that has learned to sort one parcel, for each parcel of a flow."""

import numpy as np

from surface_gym.flow.features import OWN
from surface_gym.flow.settings import FlowSettings

from .. import library
from .parcel_rule import SIDE, Halves, ParcelRule, Rows


class SortEach(ParcelRule):
    """A shipped agent of Sort, as it is: a parcel's row begins with what Sort shows of one. Those
    that go straight on, which it never met, roll.

    Args:
        settings: of the environment, with "parcels" for actions.
        name: of the agent, one whose actions are halves.
        seed: of its weights.
    """

    def __init__(self, settings: FlowSettings, name: str = "sort-ppo", seed: int = 0) -> None:
        super().__init__(settings)
        self._policy = library.load(name, seed)
        self._choices = settings.action_kind.choices

    def _halves(self, rows: Rows) -> Halves:
        choices = np.full((len(rows), 2), self._axes.roll)
        aside = rows[:, SIDE] != 0.0
        if aside.any():
            actions, _ = self._policy.predict(rows[aside, :OWN])
            choices[aside] = np.stack(np.divmod(actions, self._choices), axis=-1)
        return choices
