"""Whether what is exported decides as the policy does.

Single precision sums in another order give scores that differ in their last digits. Where the best
two scores are that close, either choice is right: such decisions are counted by themselves. Any
other that differs is an error.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .decision import Decision, Integers, Numbers, Singles
from .graph import ANGLES, CHOICES, OBSERVATION, need
from .source import Source

TIE = 1e-6  # [-] of the largest score (at least 1): scores closer than this are a tie
MOST_TIES = 1e-3  # [-] share of decisions that may be told apart by round-off alone


@dataclass(frozen=True)
class Agreement:
    """How decisions compare, a decision being one part's choice for one observation."""

    observations: int
    parts: int  # of each decision
    ties: int  # decisions that differ where the best two scores are equal but for round-off
    close: int  # decisions where they are, whether they differ or not

    def told(self) -> str:
        """In a sentence."""
        same = "the same" if not self.ties else f"{self.ties} of them otherwise, all ties"
        return (
            f"{self.observations} observations, {self.observations * self.parts} choices: {same} "
            f"({self.close} too close to call in single precision)"
        )


def compare(
    what: str,
    decision: Decision,
    source: Source,
    observations: Singles,
    decide: Callable[[Singles], tuple[Integers, Numbers]],
) -> Agreement:
    """Compare decisions with the policy's.

    Args:
        what: decides, for the message.
        decision: that is exported.
        source: of the policy.
        observations: (count, features).
        decide: gives choices and axis angles [rad], (count, parts) each.

    Raises:
        ValueError: they differ where scores do, too often where they do not, or in an angle.
    """
    actions, _ = source.policy.predict(observations, deterministic=True)
    wanted = source.settings.action_kind.commands(actions, len(observations))
    choices, angles = decide(observations)
    differs = choices != wanted
    close = decision.in_doubt(observations, TIE)
    if (differs & ~close).any():
        first = int(np.argmax((differs & ~close).any(axis=1)))
        raise ValueError(
            f"{what} must decide as the policy of {source.name} does, got "
            f"{int((differs & ~close).any(axis=1).sum())} of {len(observations)} observations "
            f"otherwise; of the first, {observations[first].tolist()}, choices "
            f"{choices[first].tolist()} in place of {wanted[first].tolist()}"
        )
    ties = int((differs & close).sum())
    if ties > math.ceil(MOST_TIES * differs.size):
        raise ValueError(
            f"{what} must decide as the policy of {source.name} does, got {ties} of "
            f"{differs.size} choices otherwise, though all where scores are close"
        )
    if not np.array_equal(angles, np.array(decision.angles)[choices]):
        raise ValueError(f"{what} must give the angles of what it chooses, got others")
    return Agreement(len(observations), decision.parts, ties, int(close.sum()))


def onnx_decisions(model: bytes) -> Callable[[Singles], tuple[Integers, Numbers]]:
    """Decisions of an ONNX file's content, by onnxruntime on one core."""
    onnxruntime = need("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def decide(observations: Singles) -> tuple[Integers, Numbers]:
        choices, angles = session.run([CHOICES, ANGLES], {OBSERVATION: observations})
        return choices, angles

    return decide
