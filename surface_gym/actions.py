"""Kinds of action: their spaces, and what they say to the batch as commands."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.batch.commands import HALVES, MODULES, QUADRANTS, WINDOW, WINDOW_SIDE

KINDS = {"modules": MODULES, "halves": HALVES, "quadrants": QUADRANTS, "window": WINDOW}


@dataclass(frozen=True)
class ActionKind:
    """How an action sets the axes of a zone's modules.

    Raises:
        ValueError: an unknown name.
    """

    name: str  # "modules", "halves", "quadrants" or "window"
    choices: int  # orientations on offer
    rows: int  # of the widest zone
    columns: int  # of the zone

    def __post_init__(self) -> None:
        checks.one_of("actions", self.name, KINDS)

    @property
    def number(self) -> int:
        """Its place in `batch.commands`."""
        return KINDS[self.name]

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

    def space(self) -> spaces.Space[Any]:
        """What a policy chooses from."""
        if self.name == "halves":
            return spaces.Discrete(self.choices**2)
        return spaces.MultiDiscrete(np.full(self.size, self.choices))

    def commands(self, actions: Any, lanes: int) -> NDArray[np.int64]:
        """Actions of all lanes as commands (lanes, size).

        Raises:
            ValueError: a wrong shape, not whole numbers, or out of range.
        """
        try:
            given = np.asarray(actions)
        except ValueError:  # parts of different lengths
            raise ValueError(f"action must be an array, got {actions!r}") from None
        shape = (lanes,) if self.name == "halves" else (lanes, self.size)
        most = self.choices**2 if self.name == "halves" else self.choices
        if given.shape != shape:
            raise ValueError(f"action must have the shape {shape[1:]} a lane, got {given.shape}")
        if given.dtype.kind not in "iu":
            raise ValueError(f"action must be whole numbers, got {given.dtype}: {actions!r}")
        if given.min() < 0 or given.max() >= most:
            raise ValueError(f"action must be between 0 and {most - 1}, got {actions!r}")
        if self.name == "halves":
            return np.stack(np.divmod(given, self.choices), axis=-1)
        return given

    def encode(self, commands: NDArray[np.int64]) -> NDArray[np.int64]:
        """Commands (lanes, size) as actions: the way back from `commands`."""
        if self.name == "halves":
            return commands[:, 0] * self.choices + commands[:, 1]
        return commands

    def flip(self, commands: NDArray[np.int64]) -> NDArray[np.int64]:
        """Commands (lanes, size) with the parts' places mirrored in y, choices as they are."""
        if self.name == "quadrants":
            return commands[:, [1, 0, 3, 2]]
        return commands.reshape(-1, *self.shape)[:, ::-1].reshape(commands.shape)
