"""What the vector environment on a GPU asks of the batch it drives."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch

from surface_gym.dynamics.types import Integers


class DeviceDriven(Protocol):
    """Lanes on a device that are started, moved and looked at; all arrays are tensors on it."""

    outcomes: tuple[str, ...]  # how an episode may stand
    options: tuple[str, ...]  # what `reset(options=...)` may fix
    author: str  # whose functions may have gone wrong
    first_fault: torch.Tensor  # (lanes,) what a function was the first to do wrong

    @property
    def command(self) -> torch.Tensor:
        """(lanes, command size) to write before a move."""

    @property
    def outcome(self) -> torch.Tensor:
        """(lanes,) how each episode stands, a place in `outcomes`."""

    @property
    def observation(self) -> torch.Tensor:
        """(lanes, ...) what each shows."""

    @property
    def reward(self) -> torch.Tensor:
        """(lanes,) of the last control period."""

    def told(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """What `info` tells, (lanes, ...) by name, and the terms of the reward; copies."""

    def is_seeded(self, lane: int) -> bool:
        """Whether a lane has a generator."""

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Raise what `prepare` would for options of as many lanes, and draw nothing."""

    def prepare(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        """Get ready for the lanes that `place` will be called for next.

        Args:
            generators: that some lanes, by their number, draw their starts from anew.
            chosen: (count,) lanes about to begin, all of which have a generator.
            options: of each of these; none at all: none has any.
        """

    def place(self, mask: torch.Tensor) -> None:
        """Put the next start on each lane in the mask (lanes,); `move` begins it."""

    def move(self, mask: torch.Tensor) -> None:
        """Move the lanes in the mask (lanes,) over one control period, or begin those placed."""

    def follow(self) -> None:
        """After every control period: see to what is to come."""

    def close(self) -> None:
        """Let go of what is held."""
