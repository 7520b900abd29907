"""Base classes of rules, which decide for many environments at once, by the sensors alone."""

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.tasks import Task

from .. import base as shared
from ..base import BatchController, Booleans, Controller, find_axes, is_fresh

Commands = NDArray[np.int64]
Levels = NDArray[np.int64]
Memory = NDArray[Any] | None  # what a rule remembers, by environment; None: nothing
Observations = NDArray[np.float32]
Decision = tuple[Commands, Memory]

ROLL, HALF, FULL = range(3)  # level of a column: 90 deg; 45 and -45 deg in turn; 0 deg
LEANS = np.array([0.0, math.pi / 4.0, math.pi / 2.0])  # [rad] of axes off 90 deg, by level


@dataclass(frozen=True)
class Rule:
    """A controller that does not learn, as the registry lists it."""

    name: str
    task: str  # its name
    actions: str  # the kind of action it is for
    make: Callable[[EnvConfig], Controller]
    observe: tuple[str, ...] = ()  # groups of features it makes use of, where they are shown
    searches: bool = False  # it searches a layout for each start, and is tried on fewer starts
    orientations: str | None = None  # "any": axes at any angle; None: those of the line
    # the task of the package whose observation shows it more; None: the task itself
    observed_task: Callable[[Task], Task] | None = None


class BaseRule(BatchController):
    """A rule of one parcel per environment."""

    def __init__(
        self, config: EnvConfig, tasks: tuple[str, ...], actions: tuple[str, ...] = ()
    ) -> None:
        checks.one_of("task", config.task_name, tasks)
        if actions:
            checks.one_of("actions", config.actions, actions)
        if config.action_kind.continuous:
            raise ValueError(f"orientations must be some on offer, got {config.orientations!r}")
        self._config = config
        self._kind = config.action_kind
        self._shape = (len(config.features),)

    @abstractmethod
    def _decide(self, observations: Observations, memory: Memory, fresh: Booleans) -> Decision:
        """Choose commands (num_envs, size), and what to remember (num_envs, ...).

        Args:
            memory: (num_envs, ...) what was remembered; None where nothing was.
            fresh: (num_envs,) an episode has just begun: the memory is of another.
        """

    def _predict(
        self, batch: Observations, state: Any, episode_start: Any, **_: bool
    ) -> tuple[Any, Memory]:
        fresh = is_fresh(len(batch), state, episode_start)
        commands, memory = self._decide(batch, state, fresh)
        return self._kind.encode(commands), memory


class UniformRule(BaseRule):
    """A rule that sets all modules alike, by what is seen now."""

    @abstractmethod
    def _choose(self, observations: Observations) -> Commands:
        """Choose (num_envs,) for every module."""

    def _decide(self, observations: Observations, *_: Any) -> Decision:
        choice = self._choose(observations)
        return np.repeat(choice[:, np.newaxis], self._kind.size, axis=1), None


class UniformLayout(UniformRule):
    """Any task with every axis at one angle, whatever the parcel does."""

    def __init__(self, config: EnvConfig, angle: float, tasks: tuple[str, ...] = ()) -> None:
        super().__init__(config, tasks or (config.task_name,))
        self._choice = shared.find_orientation(config, angle)

    def _choose(self, observations: Observations) -> Commands:
        return np.full(len(observations), self._choice)


class FixedRule(BaseRule):
    """A rule that arranges axes once, by what is seen at the start, and keeps them to the end."""

    @abstractmethod
    def _layout(self, observations: Observations) -> Commands:
        """Choose commands (num_envs, size) for episodes that have just begun."""

    def _decide(self, observations: Observations, memory: Memory, fresh: Booleans) -> Decision:
        layout = np.empty((len(observations), self._kind.size), dtype=np.int64)
        if memory is not None:
            layout[~fresh] = checks.alike("state", memory, layout)[~fresh]
        if fresh.any():
            layout[fresh] = self._layout(observations[fresh])
        return layout, layout


class ColumnAxes:
    """Turns the levels at which a zone's columns brake into commands of "modules"."""

    def __init__(self, config: EnvConfig) -> None:
        axes = find_axes(config)
        rows = np.arange(config.action_kind.rows)
        # In a column that brakes half, what pushes to the one side and to the other cancels out.
        in_turn = np.where(rows % 2, axes.right, axes.left)
        self._choice = np.stack(
            [np.full(len(rows), axes.roll), in_turn, np.full(len(rows), axes.brake)]
        )

    def __call__(self, levels: Levels) -> Commands:
        """Compute commands (num_envs, rows x columns) for the levels (num_envs, columns)."""
        return self._choice[levels].swapaxes(1, 2).reshape(len(levels), -1)
