"""Base classes of rules that decide for many environments at once, from observations only.
A column's braking level is rolling (90 deg), half braking (45 and -45 deg alternately) or full
braking (0 deg). A kernel is the compiled function of a rule.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.registry import Registry
from surface_gym.tasks import Task

from ..base import BatchController, Booleans, Controller, find_axes, find_orientation, is_fresh

Commands = NDArray[np.int64]
Levels = NDArray[np.int64]
Memory = Any  # memory of a rule by environment; None: no memory
Observations = NDArray[np.float32]
Decision = tuple[Commands, Memory]

ROLL, HALF, FULL = range(3)  # level of a column: 90 deg; 45 and -45 deg in turn; 0 deg
LEANS = np.array([0.0, math.pi / 4.0, math.pi / 2.0])  # [rad] of axes off 90 deg, by level


@dataclass(frozen=True)
class Rule:
    """A registered controller without learning, for one task."""

    name: str
    task: str  # name of the task
    actions: str  # kind of action
    make: Callable[[EnvConfig], Controller]
    observe: tuple[str, ...] = ()  # optional groups of features that it uses
    # whether it searches a layout for each start, so it is tested on fewer starts
    searches: bool = False
    orientations: str | None = None  # "any": axes at any angle; None: the line's orientations
    # the task with a richer observation that the rule needs; None: the task itself
    observed_task: Callable[[Task], Task] | None = None
    is_prior: bool = False  # whether PPO per parcel learns to correct it

    @property
    def is_apart(self) -> bool:
        """Whether the rule needs special orientations or a special observation."""
        return self.orientations is not None or self.observed_task is not None


# Modules with rules, in the order of the tables.
MODULES = tuple(
    f"surface_gym.agents.rules.{name}"
    for name in (
        "base",
        "sorting",
        "layouts",
        "local",
        "steering",
        "parking",
        "braking",
        "departures",
        "patterns",
    )
)
# Keys are task and name, e.g. "sort: event rule".
RULES: Registry[Rule] = Registry("rule", *MODULES)
Maker = TypeVar("Maker", bound=Callable[..., Any])


def rule(name: str, *tasks: str, actions: str, **more: Any) -> Callable[[Maker], Maker]:
    """Register a class or a function that makes a rule from a configuration.

    The comparison of methods uses all registered rules. The playground uses the compiled rules.
    `name` is unique among the rules of a task. `tasks` are the names of the rule's tasks. `more`
    are other fields of `Rule`.
    """

    def register(make: Maker) -> Maker:
        for task in tasks:
            key, made = f"{task}: {name}", Rule(name, task, actions, make, **more)
            again = RULES.holds(key, lambda known: _name_of(known.make) == _name_of(make))
            RULES.register(key, made, replace=again)
        return make

    return register


def _name_of(make: Callable[..., Any]) -> str | None:
    """Return the name of `make`, which a reload of the file keeps. Without a name, return None."""
    return getattr(make, "__qualname__", None)


def _check_choices(config: EnvConfig) -> None:
    if config.action_kind.continuous:
        raise ValueError(f"orientations must be some on offer, got {config.orientations!r}")


class BaseRule(BatchController):
    """Base class of rules for one parcel per environment."""

    def __init__(
        self, config: EnvConfig, tasks: tuple[str, ...], actions: tuple[str, ...] = ()
    ) -> None:
        checks.one_of("task", config.task_name, tasks)
        if actions:
            checks.one_of("actions", config.actions, actions)
        _check_choices(config)
        self._config = config
        self._kind = config.action_kind
        self._shape = (len(config.features),)

    @abstractmethod
    def _decide(self, observations: Observations, memory: Memory, fresh: Booleans) -> Decision:
        """Choose commands (num_envs, size), and return the new memory (num_envs, ...).

        `memory` (num_envs, ...) is the memory that the last call returned, or None in the first
        call. If `fresh` (num_envs,) is true, an episode has just begun, and the environment's row
        of `memory` is invalid.
        """

    def _predict(
        self, batch: Observations, state: Any, episode_start: Any, **_: bool
    ) -> tuple[Any, Memory]:
        fresh = is_fresh(len(batch), state, episode_start)
        commands, memory = self._decide(batch, state, fresh)
        return self._kind.encode(commands), memory


class CompiledController(ABC):
    """A controller whose decision is a compiled function, called by Python and the playground.

    For one parcel, the function reads `observations` and writes `commands`. For a stream, the
    function reads `tables` and writes `halves`, which holds indices into `choices`.
    """

    kernel: Any  # the compiled function

    @abstractmethod
    def begin(self) -> tuple[Any, ...]:
        """Return the kernel's arguments at the start of an episode, for one environment."""


class CompiledRule(BaseRule, CompiledController):
    """A rule of one parcel with a compiled decision."""

    def __init__(
        self, config: EnvConfig, tasks: tuple[str, ...], actions: tuple[str, ...] = ()
    ) -> None:
        super().__init__(config, tasks, actions)
        axes = find_axes(config)
        self._axes = np.array([axes.roll, axes.brake, axes.left, axes.right])

    def make_memory(self, num_envs: int) -> tuple[NDArray[Any], ...]:
        """Return the memory at the start of episodes, a named tuple of arrays (num_envs, ...)."""
        del num_envs
        return ()

    @abstractmethod
    def arguments(
        self, observations: Observations, memory: Any, commands: Commands
    ) -> tuple[Any, ...]:
        """Return the kernel's arguments.

        The kernel writes `commands` (num_envs, size of an action), and updates the arrays of
        `memory` that `make_memory` made.
        """

    def begin(self) -> tuple[Any, ...]:
        commands = np.zeros((1, self._kind.size), dtype=np.int64)
        observations = np.zeros((1, *self._shape), dtype=np.float32)
        return self.arguments(observations, self.make_memory(1), commands)

    def _decide(self, observations: Observations, memory: Memory, fresh: Booleans) -> Decision:
        num_envs = len(observations)
        begun = self.make_memory(num_envs)
        if memory is not None:
            for new, old in zip(begun, checks.alike("state", memory, begun), strict=True):
                new[~fresh] = old[~fresh]
        commands = np.empty((num_envs, self._kind.size), dtype=np.int64)
        self.kernel(*self.arguments(observations, begun, commands))
        return commands, begun or None


class BaseStreamRule(BatchController):
    """Base class of rules for streams."""

    acts_by: ClassVar[str] = "parcels"  # its kind of action

    def __init__(self, config: EnvConfig) -> None:
        checks.one_of("actions", config.actions, (self.acts_by,))
        _check_choices(config)
        self.choices = self._list_choices(config)  # by the number that the rule chooses

    def _list_choices(self, config: EnvConfig) -> Commands:
        """List the choices that the rule uses. An action of the rule is an index into this list."""
        axes = find_axes(config)
        return np.array([axes.roll, axes.brake, axes.left, axes.right])


class UniformLayout(BaseRule):
    """A rule for any task, which keeps every axis at one fixed angle."""

    def __init__(self, config: EnvConfig, angle: float, tasks: tuple[str, ...] = ()) -> None:
        super().__init__(config, tasks or (config.task_name,))
        self._choice = find_orientation(config, angle)

    def _decide(self, observations: Observations, *_: Any) -> Decision:
        return np.full((len(observations), self._kind.size), self._choice), None


# Every axis of a field at 90 deg: a parcel rolls straight downhill. A layout along the path is
# impossible, since observations show only the next 0.35 m of the path.
ROLLING = rule("fixed layout", "track", actions="window")(
    partial(UniformLayout, angle=math.pi / 2.0, tasks=("track",))
)


class FixedRule(BaseRule):
    """A rule that sets axes once from the first observation, and keeps them to the end."""

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
    """Converts the braking levels of a zone's columns to commands for all modules."""

    def __init__(self, config: EnvConfig) -> None:
        axes = find_axes(config)
        rows = np.arange(config.action_kind.rows)
        # In a half braking column, the pushes to the two sides cancel.
        in_turn = np.where(rows % 2, axes.right, axes.left)
        self._choice = np.stack(
            [np.full(len(rows), axes.roll), in_turn, np.full(len(rows), axes.brake)]
        )

    def __call__(self, levels: Levels) -> Commands:
        """Compute commands (num_envs, rows x columns) for the levels (num_envs, columns)."""
        return self._choice[levels].swapaxes(1, 2).reshape(len(levels), -1)
