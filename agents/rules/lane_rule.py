"""What every rule shares: one observation or many, and a memory that goes through `state`."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.settings import Settings

Booleans = NDArray[np.bool_]
Commands = NDArray[np.int64]
Memory = NDArray[Any]
Numbers = NDArray[np.float64]
Observations = NDArray[np.float32]


class LaneRule(ABC):
    """A rule that decides all lanes at once.

    Args:
        settings: of the environment it is to act in.
        tasks: names of the tasks it is made for.
        actions: kinds of action it is made for; none: any.

    Raises:
        ValueError: the settings are of another task or kind of action, or offer any angle.
    """

    def __init__(
        self, settings: Settings, tasks: tuple[str, ...], actions: tuple[str, ...] = ()
    ) -> None:
        checks.one_of("task", settings.task_name, tasks)
        if actions:
            checks.one_of("actions", settings.actions, actions)
        if settings.action_kind.continuous:
            raise ValueError(f"orientations must be some on offer, got {settings.orientations!r}")
        self._settings = settings
        self._kind = settings.action_kind

    @abstractmethod
    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        """Commands (lanes, size), and what to remember (lanes, ...).

        Args:
            observations: (lanes, features).
            memory: (lanes, ...) what was remembered; None where nothing was.
            fresh: (lanes,) an episode has just begun: what was remembered is of another.
        """

    def predict(
        self,
        observation: Observations,
        state: Memory | None = None,
        episode_start: Booleans | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, Memory | None]:
        """Action for an observation (features,), or actions for (lanes, features); and the state.

        See `agents.controller.Controller`; a rule knows no chance, whatever `deterministic`.
        """
        del deterministic
        observations = np.atleast_2d(observation)
        if state is None:
            fresh = np.ones(len(observations), dtype=np.bool_)
        elif episode_start is None:
            fresh = np.zeros(len(observations), dtype=np.bool_)
        else:
            fresh = np.atleast_1d(np.asarray(episode_start, dtype=np.bool_))
        commands, memory = self._decide(observations, state, fresh)
        actions = self._kind.encode(commands)
        return (actions[0] if np.ndim(observation) == 1 else actions), memory


class UniformRule(LaneRule):
    """All modules alike, by what is seen now."""

    @abstractmethod
    def _choose(self, observations: Observations) -> NDArray[np.int64]:
        """(lanes,) the choice of every module."""

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        del memory, fresh
        choice = self._choose(observations)
        return np.repeat(choice[:, np.newaxis], self._kind.size, axis=1), None


class FixedRule(LaneRule):
    """Axes arranged once, by what is seen at the start, and kept to the end."""

    @abstractmethod
    def _layout(self, observations: Observations) -> Commands:
        """Commands (lanes, size) for episodes that have just begun."""

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        layout = np.empty((len(observations), self._kind.size), dtype=np.int64)
        if memory is not None:
            layout[~fresh] = memory[~fresh]
        if fresh.any():
            layout[fresh] = self._layout(observations[fresh])
        return layout, layout
