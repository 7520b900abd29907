"""One run of a learner of our own: its legs, its curve, and the policy that it leaves."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch

from ..policies.files import save_policy
from .checkpoint import FILE, read_state, write_state
from .config import TrainConfig, card_of
from .curve import Curve
from .legs import Learned, Progress, leg_at, leg_seed


class Learner(Protocol):
    """Learns from one rollout after another, and can be put back to where a leg began."""

    steps: int  # control periods learned from

    @property
    def network(self) -> torch.nn.Module:
        """What a policy is made of."""

    def begin(self, seed: int) -> None:
        """Start all lanes and all draws anew."""

    def state(self, recent: list[dict[str, float]]) -> dict[str, Any]:
        """All that a run goes on from at the beginning of a leg, with its latest episodes."""

    def restore(self, state: dict[str, Any]) -> list[dict[str, float]]:
        """Take on what `state` gave; the latest episodes."""


AnyLearner = TypeVar("AnyLearner", bound=Learner)
AnyCurve = TypeVar("AnyCurve", bound=Curve)


def run(
    config: TrainConfig,
    folder: Path,
    progress: Progress,
    make_learner: Callable[[], AnyLearner],
    make_curve: Callable[[int, list[dict[str, float]]], AnyCurve],
    learn: Callable[[AnyLearner, AnyCurve], None],
) -> Learned:
    """Learn as the configuration says and leave a policy in `folder`.

    A checkpoint found there is gone on from. An interrupt keeps what was learned so far.

    Args:
        config: of the run.
        folder: of the run.
        progress: told after each rollout.
        make_learner: makes the learner.
        make_curve: makes its curve, from the control periods done and the latest episodes.
        learn: learns from one rollout, and lets the curve take the episodes that ended in it.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration.
    """
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    started = time.perf_counter()
    learner = make_learner()
    recent = read_state(folder, learner.restore) if (folder / FILE).is_file() else []
    curve = make_curve(learner.steps, recent)
    interrupted, leg = False, -1
    try:
        while learner.steps < config.steps:
            if leg_at(config, learner.steps) != leg:
                leg = leg_at(config, learner.steps)
                write_state(learner.state(list(curve.recent)), folder)
                learner.begin(leg_seed(config, leg))
            learn(learner, curve)
            curve.write(learner.steps)
            progress(learner.steps, curve.success)
        write_state(learner.state(list(curve.recent)), folder)
    except KeyboardInterrupt:
        interrupted = True
    curve.close()
    save_policy(learner.network, card_of(config), folder)
    return Learned(learner.steps, time.perf_counter() - started, interrupted)
