"""A layout that is arranged once: everything is led to one side."""

from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.flow.settings import FlowSettings

from ..rules.axes import axes_of
from .parcel_rule import Booleans, Halves, Rows


class FixedLayout:
    """All modules that obey at 45 deg to the left, whoever comes.

    Args:
        settings: of the environment, with "modules" for actions and no gate.

    Raises:
        ValueError: another kind of action, a gate, or the orientation is not on offer.
    """

    def __init__(self, settings: FlowSettings) -> None:
        checks.one_of("actions", settings.actions, ("modules",))
        if settings.gate:
            raise ValueError("gate must be False for a layout, which decides nothing, got True")
        self._action = np.full(settings.flow_actions.size, axes_of(settings).left)

    def predict(
        self,
        observation: Rows,
        state: Any = None,
        episode_start: Booleans | None = None,
        deterministic: bool = True,
    ) -> tuple[Halves, Any]:
        """Action for an observation (rows, features), or actions for (lanes, rows, features).

        See `agents.controller.Controller`.
        """
        del episode_start, deterministic
        if observation.ndim == 2:
            return self._action.copy(), state
        return np.tile(self._action, (len(observation), 1)), state
