"""The training loop with checkpoints, and PPO's advantages and loss (Schulman et al., 2017).

Schulman et al., Proximal policy optimization algorithms, 2017.
"""

import inspect
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import torch

from ..library import find_task, save_policy
from . import runs
from .config import Config, TrainConfig, make_card

# As in Stable-Baselines3's PPO.
CLIP_RANGE = 0.2  # maximum rewarded difference of the probability ratio from 1
MAX_GRAD_NORM = 0.5
ADAM_EPS = 1e-5


class PlainAdam(torch.optim.Adam):
    """Adam without its wrappers for PyTorch's compiler; importing the compiler takes a second."""

    add_param_group = inspect.unwrap(torch.optim.Optimizer.add_param_group)
    zero_grad = inspect.unwrap(torch.optim.Optimizer.zero_grad)
    step = torch.no_grad()(inspect.unwrap(torch.optim.Adam.step))


def learning_rate(config: TrainConfig, steps: int) -> float:
    """Compute the learning rate after `steps` control periods; it decreases linearly to 0."""
    return max(0.0, 1.0 - steps / config.steps) * config.learning_rate


class Learner(Protocol):
    """Interface of learners: they learn from rollouts, and save their state at checkpoints."""

    # Optional attributes: `terms`, reward terms of the curve in place of the task's, and
    # `row_every`, control periods between rows of the curve in place of one row per rollout.

    @property
    def steps(self) -> int:
        """Number of control periods used for learning until now."""

    @property
    def network(self) -> torch.nn.Module:
        """Network of the policy on the CPU."""

    def begin(self, seed: int) -> None:
        """Restart all environments, and seed all random numbers."""

    def learn(self, curve: Any) -> None:
        """Learn from one rollout, and add the rollout's finished episodes to `curve`."""

    def state(self) -> dict[str, Any]:
        """Return the state at a checkpoint: tensors and plain values, including `steps`."""

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the state of a checkpoint."""


def train_learner(
    config: Config,
    folder: Path,
    on_progress: runs.OnProgress,
    make_learner: Callable[[Config], Learner],
) -> runs.TrainResult:
    """Train the learner that `make_learner` makes, and write its policy to `folder`.

    `on_progress` is called with the finished control periods and the latest success rate.
    If the folder has a checkpoint, training is resumed. An interrupt saves the current policy.
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
    terms = getattr(learner, "terms", None) or find_task(config.task).terms
    curve = runs.Curve(folder, terms, learner.steps, recent)
    interrupted, interval, row_every = False, -1, getattr(learner, "row_every", 1)
    try:
        while learner.steps < config.steps:
            if runs.interval_at(config, learner.steps) != interval:
                interval = runs.interval_at(config, learner.steps)
                save()
                learner.begin(runs.interval_seed(config, interval))
            row = learner.steps // row_every
            learner.learn(curve)
            if learner.steps // row_every > row:
                curve.write(learner.steps)
                on_progress(learner.steps, curve.success)
        save()
    except (KeyboardInterrupt, runs.StopTraining):
        interrupted = True
    curve.close()
    save_policy(learner.network.state_dict(), make_card(config), folder)
    return runs.TrainResult(learner.steps, time.perf_counter() - started, interrupted)


def compute_advantages(
    rewards: torch.Tensor,
    ended: torch.Tensor,
    value: torch.Tensor,
    next_value: torch.Tensor,
    gamma: float,
    gae_lambda: float,
) -> torch.Tensor:
    """Compute generalised advantage estimates. All tensors (periods, num_envs) are on one device.

    Schulman et al., High-dimensional continuous control using generalised advantage estimation,
    ICLR 2016, Eq. (16).

    Args:
        ended: whether a period was the last period of an episode.
        value: value of the observation before each period.
        next_value: value of the observation after each period, in the same episode. After success
            or failure, this value is 0.
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
    """Compute PPO's loss with the clipped objective, Eq. (7) of the paper on PPO.

    All tensors have the shape (samples,), except `entropy`, the mean entropy. The current policy
    gives `log_prob` and `value`; the policy that chose the actions gave `old_log_prob`.
    """
    ratio = (log_prob - old_log_prob).exp()
    clipped = ratio.clamp(1.0 - CLIP_RANGE, 1.0 + CLIP_RANGE)
    objective = torch.min(ratio * advantage, clipped * advantage).mean()
    value_loss = (value - returns).square().mean()
    return value_coef * value_loss - objective - ent_coef * entropy
