"""A controller that records: it excites the surface instead of steering parcels."""

from typing import Any

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.machine.excitation import excitation

from ..base import Singles


class ExcitationController:
    """A `Controller` of one environment: `excitation` for each parcel in turn.

    Args:
        config: an environment with a choice for each module.
    """

    def __init__(self, config: EnvConfig) -> None:
        kind = config.action_kind
        self._shape = (kind.rows, kind.columns)
        self._period = config.control_period
        self._seconds = config.task.periods * config.control_period
        self._offered = np.array(config.chosen_orientations)  # [rad]
        self._runs = -1
        self._axes = np.zeros((0, *self._shape))

    def predict(
        self,
        observation: Singles,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Return the action of the next control period; the observation has no effect."""
        del episode_start, deterministic
        if state is None:
            self._runs += 1
            self._axes = excitation(self._shape, self._seconds, run=self._runs, period=self._period)
            state = 0  # control periods since the parcel entered
        axes = self._axes[min(state, len(self._axes) - 1)].ravel()
        apart = np.abs(np.sin(axes[:, np.newaxis] - self._offered))  # axes have period pi
        choices = np.tile(apart.argmin(axis=1), (len(observation), 1))
        return choices, state + 1
