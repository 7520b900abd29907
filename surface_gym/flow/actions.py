"""The actions of a stream: choices for modules or parcels, and when the gate opens."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym.core.actions import ActionKind

HALVES = 2  # parts of a parcel's command: the modules ahead of its centre, and those behind


@dataclass(frozen=True)
class StreamActions(ActionKind):
    """A choice for each part, module or half of a parcel, and with a gate one number more."""

    # ways to open the gate: 0 keeps it shut for the control period, k opens it for one parcel from
    # the k-th physics step on; no ways: there is no gate
    gates: int = 0

    @property
    def parts(self) -> ActionKind:
        """The actions without the gate."""
        return ActionKind(self.name, self.choices, self.rows, self.columns)

    @property
    def size(self) -> int:
        """Numbers in a command."""
        return self.parts.size + (1 if self.gates else 0)

    def space(self) -> spaces.Space[Any]:
        """The space of a surface's actions."""
        if not self.gates:
            return self.parts.space()
        return spaces.MultiDiscrete([self.choices] * self.parts.size + [self.gates])

    def commands(self, actions: Any, parcels: int) -> NDArray[Any]:
        """Turn the actions of so many surfaces into commands (surfaces, size).

        Raises:
            ValueError: a wrong shape, not whole numbers or angles, or out of range.
        """
        if not self.gates:
            return self.parts.commands(actions, parcels)
        try:
            given = np.asarray(actions)
        except ValueError:  # parts of different lengths
            raise ValueError(f"action must be an array, got {actions!r}") from None
        if given.shape != (parcels, self.size):
            raise ValueError(
                f"action must have the shape {(self.size,)} in each environment, got {given.shape}"
            )
        gate = given[:, -1]
        choices = self.parts.commands(given[:, :-1], parcels)
        if ((gate < 0) | (gate >= self.gates)).any():
            raise ValueError(
                f"action must say between 0 and {self.gates - 1} of the gate, got {gate.tolist()}"
            )
        return np.concatenate([choices, gate[:, np.newaxis]], axis=1)
