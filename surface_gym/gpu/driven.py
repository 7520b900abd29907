"""What the batches on a GPU have in common, as the vector environment drives them."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from surface_gym.dynamics.types import Integers
from surface_gym.gpu.launch import Launch
from surface_gym.lanes.memory import SOUND


class DeviceLanes(ABC):
    """Lanes on a device that are started, moved and looked at; all arrays are tensors on it.

    Args:
        lanes: their number.
        device: where they are.
    """

    outcomes: tuple[str, ...]  # how an episode may stand
    options: tuple[str, ...]  # what `reset(options=...)` may fix
    author: str  # whose functions may have gone wrong
    _surfaces: Any  # as `Surfaces`, of tensors
    _episodes: Any  # what holds outcome, reward and fault of each lane, of tensors
    _move: Launch  # of what the mask says, in the order

    def __init__(self, lanes: int, device: torch.device) -> None:
        self._device = device
        # (lanes,) what a function was the first to do wrong
        self.first_fault = torch.zeros(lanes, dtype=torch.int64, device=device)
        # What kernels read of each call: (lanes,) which lane a thread is for, and who is meant.
        self._order = torch.arange(lanes, device=device)
        self._mask = torch.zeros(lanes, dtype=torch.bool, device=device)

    @property
    def command(self) -> torch.Tensor:
        """(lanes, command size) to write before a move."""
        command: torch.Tensor = self._surfaces.command
        return command

    @property
    def outcome(self) -> torch.Tensor:
        """(lanes,) how each episode stands, a place in `outcomes`."""
        outcome: torch.Tensor = self._episodes.outcome
        return outcome

    @property
    def reward(self) -> torch.Tensor:
        """(lanes,) of the last control period."""
        reward: torch.Tensor = self._episodes.reward
        return reward

    def move(self, mask: torch.Tensor) -> None:
        """Move the lanes in the mask (lanes,) over one control period, or begin those placed."""
        self._mask.copy_(mask)
        self._move()
        fault = torch.where(mask, self._episodes.fault, SOUND)
        torch.where(self.first_fault == SOUND, fault, self.first_fault, out=self.first_fault)

    @property
    @abstractmethod
    def observation(self) -> torch.Tensor:
        """(lanes, ...) what each shows."""

    @abstractmethod
    def told(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """What `info` tells, (lanes, ...) by name, and the terms of the reward; copies."""

    @abstractmethod
    def is_seeded(self, lane: int) -> bool:
        """Whether a lane has a generator."""

    @abstractmethod
    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Raise what `start` would for options of as many lanes, and draw nothing."""

    @abstractmethod
    def start(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        """Put the next start on some lanes; `move` begins it.

        Args:
            generators: that some lanes, by their number, draw their starts from anew.
            chosen: (count,) the lanes, all of which have a generator.
            options: of each of these; none at all: none has any.
        """

    @abstractmethod
    def place(self, mask: torch.Tensor) -> None:
        """Put the next start on each lane in the mask (lanes,); `move` begins it."""

    @abstractmethod
    def follow(self) -> None:
        """After every control period: see to what is to come."""

    @abstractmethod
    def close(self) -> None:
        """Let go of what is held."""
