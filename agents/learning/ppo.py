"""PPO of the package's own learners: advantages, loss, and the loop of a run.

Schulman et al., Proximal policy optimization algorithms, 2017.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import torch

from ..policy import save_policy
from . import runs
from .config import TrainConfig, make_card

# As in Stable-Baselines3's PPO.
CLIP_RANGE = 0.2  # by which the probability ratio may differ from 1 and still earn
MAX_GRAD_NORM = 0.5


def compute_advantages(
    rewards: torch.Tensor,
    ended: torch.Tensor,
    value: torch.Tensor,
    next_value: torch.Tensor,
    gamma: float,
    gae_lambda: float,
) -> torch.Tensor:
    """Compute generalised advantage estimates; all tensors (periods, num_envs), on one device.

    Schulman et al., High-dimensional continuous control using generalised advantage estimation,
    ICLR 2016, Eq. (16).

    Args:
        value: of the observation before each period.
        next_value: of the observation after it, in the same episode; 0 after success or failure.
    """
    delta = rewards + gamma * next_value - value
    advantage = torch.zeros_like(rewards)
    following = torch.zeros_like(rewards[0])
    for period in reversed(range(len(rewards))):
        following = delta[period] + gamma * gae_lambda * following * ~ended[period]
        advantage[period] = following
    return advantage


def ppo_loss(
    log_prob: torch.Tensor,
    old_log_prob: torch.Tensor,
    advantage: torch.Tensor,
    value: torch.Tensor,
    returns: torch.Tensor,
    entropy: torch.Tensor,
    ent_coef: float,
    value_coef: float,
) -> torch.Tensor:
    """Compute PPO's loss of samples (samples,) each, with the clipped objective of Eq. (7)."""
    ratio = (log_prob - old_log_prob).exp()
    clipped = ratio.clamp(1.0 - CLIP_RANGE, 1.0 + CLIP_RANGE)
    objective = torch.min(ratio * advantage, clipped * advantage).mean()
    value_loss = (value - returns).square().mean()
    return value_coef * value_loss - objective - ent_coef * entropy


def learning_rate(config: TrainConfig, steps: int) -> float:
    """Compute the learning rate after some control periods; it falls linearly to 0."""
    return max(0.0, 1.0 - steps / config.steps) * config.learning_rate


class Transition(NamedTuple):
    """Result of a control period: arrays, or tensors on the environments' device."""

    observations: Any  # (num_envs, features) of the next start where an episode ended
    rewards: Any  # (num_envs,) float64
    terminated: Any  # (num_envs,) ended by success or failure
    ended: Any  # (num_envs,) or by the time limit
    last: Any  # (num_envs, features) at the period's end, of an episode that ended too
    infos: list[dict[str, Any]] = []  # of SurfaceVecEnv


class Learner(Protocol):
    """Learns from one rollout after another, and returns to the state of a checkpoint."""

    steps: int  # control periods learned from

    @property
    def network(self) -> torch.nn.Module:
        """Network of the policy, on the CPU."""

    def begin(self, seed: int) -> None:
        """Start all environments and random numbers anew."""

    def learn(self, curve: Any) -> None:
        """Learn from one rollout and add the episodes that ended in it to the curve."""

    def state(self) -> dict[str, Any]:
        """Return the state at a checkpoint: tensors and plain values, `steps` among them."""

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the state of a checkpoint."""


def train_learner(
    config: TrainConfig,
    folder: Path,
    on_progress: runs.OnProgress,
    make_learner: Callable[[], Learner],
    make_curve: Callable[[int, list[dict[str, float]]], runs.Curve],
) -> runs.TrainResult:
    """Train as the configuration says and leave a policy in `folder`.

    A run with a checkpoint is resumed. An interrupt saves the policy as it is.
    """
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    started = time.perf_counter()
    learner = make_learner()

    def restore(state: dict[str, Any]) -> list[dict[str, float]]:
        learner.restore(state)
        return state["recent"]

    def save() -> None:
        runs.write_state({**learner.state(), "recent": list(curve.recent)}, folder)

    recent = runs.read_state(folder, restore) if (folder / runs.CHECKPOINT).is_file() else []
    curve = make_curve(learner.steps, recent)
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
    save_policy(learner.network, make_card(config), folder)
    return runs.TrainResult(learner.steps, time.perf_counter() - started, interrupted)
