"""What a face asks of the batch it drives."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym.physics.types import Array, Integers


class Acts(Protocol):
    """What turns actions into commands."""

    def commands(self, actions: Any, lanes: int) -> NDArray[Any]:
        """Actions of all lanes as commands (lanes, size), or an error."""


class Driven(Protocol):
    """Lanes that are started, moved and looked at."""

    outcomes: tuple[str, ...]  # how an episode may stand

    @property
    def options(self) -> tuple[str, ...]:
        """What `reset(options=...)` may fix."""

    @property
    def outcome(self) -> Integers:
        """(lanes,) how each episode stands, a place in `outcomes`."""

    @property
    def observation(self) -> NDArray[np.float32]:
        """(lanes, ...) what each shows."""

    @property
    def reward(self) -> Array:
        """(lanes,) of the last control period."""

    def seed(self, lane: int, generator: np.random.Generator) -> None:
        """Draw a lane's starts from a generator; one that it has already goes on."""

    def is_seeded(self, lane: int) -> bool:
        """Whether a lane has a generator."""

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Raise what `start` would for options of as many lanes, and draw nothing."""

    def start(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        """Begin an episode on the chosen lanes (count,)."""

    def advance(self, commands: NDArray[Any], anew: Integers = ...) -> None:
        """Move every lane that has not ended over one control period."""
