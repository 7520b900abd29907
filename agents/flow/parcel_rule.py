"""What the controllers that decide parcel by parcel share."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.flow.features import PRESENT, WAITS
from surface_gym.flow.settings import FlowSettings

from ..rules.axes import axes_of

Booleans = NDArray[np.bool_]
Rows = NDArray[np.float32]
Halves = NDArray[np.int64]

SIDE = 14  # place of the side of a parcel's exit in its row
TIME = 12  # place of the time since it entered; negative: since its time came
PAST_START = 13  # place of how far its rear is past the exit's start
OPEN = 1  # what an action says of the gate: from the first physics step on


class ParcelRule(ABC):
    """Decides for each parcel by its row alone: the same for all, wherever they are.

    Args:
        settings: of the environment it is to act in, with "parcels" for actions.

    Raises:
        ValueError: another kind of action, or 0, 45, -45 and 90 deg are not all on offer.
    """

    def __init__(self, settings: FlowSettings) -> None:
        checks.one_of("actions", settings.actions, ("parcels",))
        if settings.action_kind.continuous:
            raise ValueError(f"orientations must be some on offer, got {settings.orientations!r}")
        self._axes = axes_of(settings)
        self._places = settings.places
        self._gated = settings.gate

    @abstractmethod
    def _halves(self, rows: Rows) -> Halves:
        """Choices (parcels, 2) for the modules ahead of each parcel's centre, and behind it.

        Args:
            rows: (parcels, features) of those on the line.
        """

    def _open(self, tables: Rows, memory: Any, fresh: Booleans) -> tuple[Halves, Any]:
        """When the gate opens (lanes,), and what to remember: by default as soon as there is room.

        Args:
            tables: (lanes, rows, features).
            memory: what was remembered; None where nothing was.
            fresh: (lanes,) an episode has just begun.
        """
        del fresh
        return np.full(len(tables), OPEN), memory

    def predict(
        self,
        observation: Rows,
        state: Any = None,
        episode_start: Booleans | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.int64], Any]:
        """Action for an observation (rows, features), or actions for (lanes, rows, features).

        See `agents.controller.Controller`.
        """
        del deterministic
        tables = observation.reshape(-1, *observation.shape[-2:])
        lanes = len(tables)
        rows = tables[:, : self._places].reshape(-1, tables.shape[-1])
        present = (rows[:, PRESENT] > 0.5) & (rows[:, WAITS] < 0.5)
        choices = np.full((len(rows), 2), self._axes.roll)
        if present.any():
            choices[present] = self._halves(rows[present])
        actions = choices.reshape(lanes, -1)
        if self._gated:
            fresh = fresh_lanes(lanes, state, episode_start)
            opens, state = self._open(tables, state, fresh)
            actions = np.concatenate([actions, opens[:, np.newaxis]], axis=1)
        return (actions[0] if observation.ndim == 2 else actions), state


def fresh_lanes(lanes: int, state: Any, episode_start: Booleans | None) -> Booleans:
    """(lanes,) whose episode has just begun, as `Controller.predict` is told."""
    if state is None:
        return np.ones(lanes, dtype=np.bool_)
    if episode_start is None:
        return np.zeros(lanes, dtype=np.bool_)
    return np.atleast_1d(np.asarray(episode_start, dtype=np.bool_))
