"""Kinds of action: their spaces, and what they say to the batch as commands."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.actions.commands import (
    WINDOW_SIDE,
    part_of_halves,
    part_of_modules,
    part_of_quadrants,
    part_of_window,
)

# Kinds of action by name: which part of it a module follows.
KINDS: dict[str, Callable[..., Any]] = {
    "modules": part_of_modules,
    "halves": part_of_halves,
    "quadrants": part_of_quadrants,
    "window": part_of_window,
}
ANY = "any"  # in place of orientations on offer: every angle
RIGHT_ANGLE = np.float32(math.pi / 2.0)  # [rad] an axis turned further is one turned less


@dataclass(frozen=True)
class ActionKind:
    """How an action sets the axes of a zone's modules.

    Raises:
        ValueError: an unknown name.
    """

    name: str  # "modules", "halves", "quadrants" or "window"
    choices: int  # orientations on offer; 0: any angle
    rows: int  # of the widest zone
    columns: int  # of the zone

    def __post_init__(self) -> None:
        checks.one_of("actions", self.name, KINDS)

    @property
    def part_of(self) -> Callable[..., Any]:
        """The compiled function that says which part of an action a module follows."""
        return KINDS[self.name]

    @property
    def continuous(self) -> bool:
        """Whether each part is an angle, in place of a choice."""
        return self.choices == 0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, from y < 0 to y > 0, and columns of the parts that a command sets."""
        return {
            "modules": (self.rows, self.columns),
            "halves": (1, 2),
            "quadrants": (2, 2),
            "window": (WINDOW_SIDE, WINDOW_SIDE),
        }[self.name]

    @property
    def size(self) -> int:
        """Numbers in a command."""
        return self.shape[0] * self.shape[1]

    @property
    def window_size(self) -> int:
        """Numbers that the kind adds to the observation: the window's occupancy."""
        return self.size if self.name == "window" else 0

    @property
    def _single(self) -> bool:
        """An action is one number: the choices of both halves."""
        return self.name == "halves" and not self.continuous

    def space(self) -> spaces.Space[Any]:
        """What a policy chooses from."""
        if self.continuous:
            return spaces.Box(-RIGHT_ANGLE, RIGHT_ANGLE, (self.size,))
        if self._single:
            return spaces.Discrete(self.choices**2)
        return spaces.MultiDiscrete(np.full(self.size, self.choices))

    def commands(self, actions: Any, lanes: int) -> NDArray[Any]:
        """Actions of all lanes as commands (lanes, size): choices, or angles [rad].

        Raises:
            ValueError: a wrong shape, not whole numbers or angles, or out of range.
        """
        try:
            given = np.asarray(actions)
        except ValueError:  # parts of different lengths
            raise ValueError(f"action must be an array, got {actions!r}") from None
        shape = (lanes,) if self._single else (lanes, self.size)
        if given.shape != shape:
            raise ValueError(f"action must have the shape {shape[1:]} a lane, got {given.shape}")
        if self.continuous:
            return _angles(given, actions)
        most = self.choices**2 if self._single else self.choices
        if given.dtype.kind not in "iu":
            raise ValueError(f"action must be whole numbers, got {given.dtype}: {actions!r}")
        chosen = given.astype(np.int64)
        if chosen.view(np.uint64).max() >= most:  # as which negative ones are the largest
            raise ValueError(f"action must be between 0 and {most - 1}, got {actions!r}")
        if self._single:
            halves = np.empty((lanes, 2), dtype=np.int64)
            np.divmod(chosen, self.choices, out=(halves[:, 0], halves[:, 1]))
            return halves
        return chosen

    def encode(self, commands: NDArray[Any]) -> NDArray[Any]:
        """Commands (lanes, size) as actions: the way back from `commands`."""
        if self._single:
            encoded: NDArray[Any] = commands[:, 0] * self.choices + commands[:, 1]
            return encoded
        return commands

    def flip(self, commands: NDArray[Any]) -> NDArray[Any]:
        """Commands (lanes, size) with the parts' places mirrored in y, choices as they are."""
        if self.name == "quadrants":
            return commands[:, [1, 0, 3, 2]]
        return commands.reshape(-1, *self.shape)[:, ::-1].reshape(commands.shape)


def _angles(given: NDArray[Any], actions: Any) -> NDArray[np.float64]:
    if given.dtype.kind not in "iuf":
        raise ValueError(f"action must be angles, got {given.dtype}: {actions!r}")
    angles = given.astype(np.float64)
    if not (np.abs(angles) <= RIGHT_ANGLE).all():
        raise ValueError(f"action must be between -pi/2 and pi/2, got {actions!r}")
    return angles
