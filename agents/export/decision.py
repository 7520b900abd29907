"""What every kind of decision that is exported can do."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .graph import Graph
from .network import Network

Singles = NDArray[np.float32]
Numbers = NDArray[np.float64]
Integers = NDArray[np.int64]


class Decision(Protocol):
    """From an observation to a choice for each part of an action."""

    @property
    def features(self) -> int:
        """Numbers of an observation."""

    @property
    def parts(self) -> int:
        """Numbers of a decision."""

    @property
    def angles(self) -> tuple[float, ...]:
        """[rad] of the orientations on offer."""

    @property
    def network(self) -> Network:
        """What gives the scores."""

    def in_doubt(self, observations: Singles, tie: float) -> NDArray[np.bool_]:
        """(lanes, parts) whether single precision may decide either way for observations (lanes,
        features): the best two scores are no more than a share `tie` of the largest apart, or a
        threshold is met but for round-off.
        """

    def add_to(self, graph: Graph) -> str:
        """Lay it into a graph; gives the name of the choices (lanes, parts)."""

    def in_c(self, prefix: str) -> tuple[str, str]:
        """Tables, and statements that fill `choices` from `observation`, in C.

        Args:
            prefix: of every name that is not within a function.
        """


def close_scores(scores: Numbers, tie: float) -> NDArray[np.bool_]:
    """(..., ) whether the best two of scores (..., options) are too close to tell apart."""
    best = np.sort(scores, axis=-1)
    scale = np.maximum(1.0, np.abs(scores).max(axis=-1))
    close: NDArray[np.bool_] = best[..., -1] - best[..., -2] <= tie * scale
    return close
