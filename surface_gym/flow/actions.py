"""The actions of a flow: choices for modules or parcels, and when the gate opens."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym.core.actions import ActionKind


@dataclass(frozen=True)
class FlowActions:
    """An action says a choice for each part of its kind, and with a gate one number more."""

    kind: ActionKind  # its parts are modules, or the halves of each place's parcel
    # how many ways to open the gate: 0 keeps it shut for the control period, k opens it for one
    # parcel from the k-th physics step on; no ways: there is no gate
    gates: int

    @property
    def size(self) -> int:
        """Numbers in a command."""
        return self.kind.size + (1 if self.gates else 0)

    def space(self) -> spaces.Space[Any]:
        """What a policy chooses from."""
        if not self.gates:
            return self.kind.space()
        return spaces.MultiDiscrete([self.kind.choices] * self.kind.size + [self.gates])

    def commands(self, actions: Any, lanes: int) -> NDArray[Any]:
        """Actions of all lanes as commands (lanes, size).

        Raises:
            ValueError: a wrong shape, not whole numbers or angles, or out of range.
        """
        if not self.gates:
            return self.kind.commands(actions, lanes)
        try:
            given = np.asarray(actions)
        except ValueError:  # parts of different lengths
            raise ValueError(f"action must be an array, got {actions!r}") from None
        if given.shape != (lanes, self.size):
            raise ValueError(f"action must have the shape {(self.size,)} a lane, got {given.shape}")
        gate = given[:, -1]
        choices = self.kind.commands(given[:, :-1], lanes)
        if ((gate < 0) | (gate >= self.gates)).any():
            raise ValueError(
                f"action must say between 0 and {self.gates - 1} of the gate, got {gate.tolist()}"
            )
        return np.concatenate([choices, gate[:, np.newaxis]], axis=1)
