"""The training loop: a learner learns from successive rollouts, with checkpoints."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import torch

from ..library import find_task, save_policy
from . import runs
from .config import Config, TrainConfig, make_card


def learning_rate(config: TrainConfig, steps: int) -> float:
    """Compute the learning rate after `steps` control periods; it decreases linearly to 0."""
    return max(0.0, 1.0 - steps / config.steps) * config.learning_rate


class Learner(Protocol):
    """Interface of learners: learning from rollouts, and states at checkpoints."""

    steps: int  # control periods learned from

    @property
    def network(self) -> torch.nn.Module:
        """Network of the policy on the CPU."""

    def begin(self, seed: int) -> None:
        """Restart all environments and random numbers."""

    def learn(self, curve: Any) -> None:
        """Learn from one rollout, and add its ended episodes to the curve."""

    def state(self) -> dict[str, Any]:
        """Return the state at a checkpoint: tensors and plain values, including `steps`."""

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the state of a checkpoint."""


def train_learner(
    config: Config,
    folder: Path,
    on_progress: runs.OnProgress,
    make_learner: Callable[[Config], Learner],
    make_curve: Callable[..., runs.Curve] = runs.Curve,
    terms: tuple[str, ...] | None = None,
) -> runs.TrainResult:
    """Train by a configuration, and write a policy to `folder`.

    A run with a checkpoint is resumed. An interrupt saves the current policy.

    Args:
        make_learner: makes the learner of a configuration.
        make_curve: makes the learning curve, with the arguments of `Curve`.
        terms: reward terms for the curve; None: the task's.
    """
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    started = time.perf_counter()
    learner = make_learner(config)

    def restore(state: dict[str, Any]) -> list[dict[str, float]]:
        learner.restore(state)
        return state["recent"]

    def save() -> None:
        runs.write_state({**learner.state(), "recent": list(curve.recent)}, folder)

    recent = runs.read_state(folder, restore) if (folder / runs.CHECKPOINT).is_file() else []
    names = find_task(config.task).terms if terms is None else terms
    curve = make_curve(folder, names, learner.steps, recent)
    interrupted, interval = False, -1
    try:
        while learner.steps < config.steps:
            if runs.interval_at(config, learner.steps) != interval:
                interval = runs.interval_at(config, learner.steps)
                save()
                learner.begin(runs.interval_seed(config, interval))
            learner.learn(curve)
            curve.write(learner.steps)
            on_progress(learner.steps, curve.success)
        save()
    except (KeyboardInterrupt, runs.StopTraining):
        interrupted = True
    curve.close()
    save_policy(learner.network.state_dict(), make_card(config), folder)
    return runs.TrainResult(learner.steps, time.perf_counter() - started, interrupted)
