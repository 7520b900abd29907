"""Common parts of controllers: their interface, choices of modules, and mirrored actions.
A choice is the index of an orientation that modules can take, or of a mode of driven modules.

Sort mirrors its observation so that the goal is at y > 0. The task's last feature is the goal side.
`ActionMirror` reads this side, and mirrors actions back to the world.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.tasks.sort import COLUMN

SAME = 1e-6  # [rad] axes that differ by less are equal

Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]
Numbers = NDArray[np.float64]
Singles = NDArray[np.float32]


class Controller(Protocol):
    """Interface of controllers, as in Stable-Baselines3's models."""

    def predict(
        self,
        observation: Singles,
        state: Any = None,
        episode_start: Booleans | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Choose an action for an observation, or actions for a batch of observations.

        Args:
            observation: one observation (features,), or a batch (num_envs, features).
            state: state from the last call. Use None at first and for controllers without memory.
            episode_start: (num_envs,) whether an episode has just begun; None means that all
                episodes continue. If `state` is None, the controller ignores `episode_start`.
            deterministic: if False, stochastic policies draw actions. Other policies ignore
                `deterministic`.
        """


class BatchController(ABC):
    """A `Controller` that decides for a batch; a single observation is a batch of one."""

    _shape: tuple[Any, ...]  # of an observation; None: any length

    def predict(
        self,
        observation: Singles,
        state: Any = None,
        episode_start: Booleans | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Choose an action for one observation, or actions for a batch; see `Controller`."""
        seen = checks.observation(observation, self._shape)
        is_one = seen.ndim == len(self._shape)
        batch = seen[np.newaxis] if is_one else seen
        actions, state = self._predict(batch, state, episode_start, deterministic=deterministic)
        return (actions[0] if is_one else actions), state

    @abstractmethod
    def _predict(
        self, batch: Any, state: Any, episode_start: Any, *, deterministic: bool
    ) -> tuple[Any, Any]:
        """Choose actions for observations `batch` (num_envs, ...); return actions and state."""


def is_fresh(num_envs: int, state: Any, episode_start: Any) -> Booleans:
    """Return a mask (num_envs,) of the episodes that just began, from arguments of `predict`."""
    if state is None:
        return np.ones(num_envs, dtype=np.bool_)
    if episode_start is None:
        return np.zeros(num_envs, dtype=np.bool_)
    fresh = np.atleast_1d(np.asarray(episode_start, dtype=np.bool_))
    if fresh.shape != (num_envs,):
        raise ValueError(f"episode_start must have the shape ({num_envs},), got {fresh.shape}")
    return fresh


def axes_apart(one: ArrayLike, other: ArrayLike) -> Numbers:
    """Return angles (...) of 0 to pi / 2 [rad] between the axes `one` and `other` [rad]."""
    turned = np.exp(2j * (np.asarray(one) - np.asarray(other)))
    return np.abs(np.angle(turned)) / 2.0


def with_zone(line: sg.lines.Line, columns: int) -> sg.lines.Line:
    """Return the line with a zone of `columns` columns; the rest of the line keeps its length."""
    longer = columns - line.zone_columns
    return replace(line, columns=line.columns + longer, zone_columns=columns)


def time_for(line: sg.lines.Line, columns: int) -> float:
    """Return the factor [-] by which a time limit grows if the zone gets `columns` columns."""
    return max(1.0, columns / line.zone_columns)


def find_orientation(config: EnvConfig, angle: float) -> int:
    """Return the choice with the orientation `angle` [rad].

    Angles that differ by pi are the same orientation. If no choice has this orientation, raise a
    ValueError.
    """
    angles = np.array(config.chosen_orientations)
    apart = axes_apart(angles, angle)
    if apart.min() > SAME:
        raise ValueError(
            f"orientations must hold {math.degrees(angle):g} deg, "
            f"got {np.degrees(angles).tolist()} deg"
        )
    return int(apart.argmin())


def find_rest(config: EnvConfig) -> int:
    """Return the choice closest to 90 deg. Modules without a parcel take this choice."""
    return int(np.abs(np.sin(config.chosen_orientations)).argmax())


def find_conveyor(config: EnvConfig) -> int:
    """Return the choice that conveys parcels along the line.

    Driven modules without a command also take this choice. If no choice conveys, raise a
    ValueError.
    """
    if not config.module_kind.drives:
        return find_orientation(config, 0.5 * math.pi)
    *choices, conveyor = config.modes.tolist()
    if conveyor not in choices:
        raise ValueError(f"modules must have a choice that conveys, got {config.modules!r}")
    return choices.index(conveyor)


@dataclass(frozen=True)
class Axes:
    """Choices of four orientations, named by their effects on a parcel that moves along x."""

    roll: int  # 90 deg: the parcel rolls
    brake: int  # 0 deg: the parcel is braked
    left: int  # -45 deg: the parcel moves towards y > 0
    right: int  # 45 deg: the parcel moves towards y < 0

    def towards(self, side: Numbers) -> Integers:
        """Return choices (...): `left` for sides > 0, `right` for sides < 0, and `roll` for 0."""
        return np.select([side > 0.0, side < 0.0], [self.left, self.right], self.roll)

    def mirrored(self, layout: Integers) -> Integers:
        """Reverse the rows of a layout of choices (rows, columns), and swap left and right."""
        flipped = layout[::-1]
        return np.select(
            [flipped == self.left, flipped == self.right], [self.right, self.left], flipped
        )


def find_axes(config: EnvConfig) -> Axes:
    """Return the choices for 90, 0, -45 and 45 deg, the orientations in the paper's Figure 2b."""
    quarter = math.pi / 4.0
    return Axes(
        roll=find_orientation(config, 2.0 * quarter),
        brake=find_orientation(config, 0.0),
        left=find_orientation(config, -quarter),
        right=find_orientation(config, quarter),
    )


SIDE = COLUMN.side.place  # of the asked side in the observation


class ActionMirror:
    """Mirrors actions for goals at y < 0, since policies act as if the goal were at y > 0.

    Raises:
        ValueError: a choice of the environment has no mirror image.
    """

    def __init__(self, config: EnvConfig) -> None:
        self._kind = config.action_kind
        self._image = None if self._kind.continuous else config.images

    def __call__(self, actions: NDArray[Any], side: Singles) -> NDArray[Any]:
        """Return actions (num_envs, ...), mirrored where the goal side (num_envs,) is negative."""
        commands = self._kind.commands(actions, len(side))
        flipped = self._kind.flip(commands)
        image = self._kind.encode(-flipped if self._image is None else self._image[flipped])
        # Side 0, straight ahead, is not mirrored.
        unchanged = (side >= 0.0).reshape(-1, *[1] * (np.ndim(actions) - 1))
        return np.where(unchanged, actions, image)


def action_mirror(config: EnvConfig) -> ActionMirror | None:
    """Return the `ActionMirror` of an environment, or None if the task is not mirrored."""
    if not config.task.mirrored:
        return None
    return ActionMirror(config)
