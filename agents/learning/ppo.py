"""PPO: advantages and loss.

Schulman et al., Proximal policy optimization algorithms, 2017.
"""

from typing import Any, NamedTuple

import torch

# As in Stable-Baselines3's PPO.
CLIP_RANGE = 0.2  # maximum rewarded difference of the probability ratio from 1
MAX_GRAD_NORM = 0.5


def compute_advantages(
    rewards: torch.Tensor,
    ended: torch.Tensor,
    value: torch.Tensor,
    next_value: torch.Tensor,
    gamma: float,
    gae_lambda: float,
) -> torch.Tensor:
    """Compute generalised advantage estimates of tensors (periods, num_envs) on one device.

    Schulman et al., High-dimensional continuous control using generalised advantage estimation,
    ICLR 2016, Eq. (16).

    Args:
        value: value of the observation before each period.
        next_value: value of the observation after it, in the same episode; 0 after success or
            failure.
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
    """Compute PPO's loss of samples (samples,) with the clipped objective of Eq. (7)."""
    ratio = (log_prob - old_log_prob).exp()
    clipped = ratio.clamp(1.0 - CLIP_RANGE, 1.0 + CLIP_RANGE)
    objective = torch.min(ratio * advantage, clipped * advantage).mean()
    value_loss = (value - returns).square().mean()
    return value_coef * value_loss - objective - ent_coef * entropy


class Transition(NamedTuple):
    """Result of a control period: arrays, or tensors on the environments' device."""

    observations: Any  # (num_envs, features) observations; the next start's after an end
    rewards: Any  # (num_envs,) float64
    terminated: Any  # (num_envs,) whether ended by success or failure
    ended: Any  # (num_envs,) whether ended, also by the time limit
    last: Any  # (num_envs, features) observations at the period's end, also of ended episodes
    infos: list[dict[str, Any]] = []  # infos of SurfaceVecEnv
