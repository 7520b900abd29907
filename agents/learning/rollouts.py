"""What rollouts of all lanes are worth."""

import torch


def advantages(
    rewards: torch.Tensor,
    ended: torch.Tensor,
    value: torch.Tensor,
    after: torch.Tensor,
    gamma: float,
    gae_lambda: float,
) -> torch.Tensor:
    """Generalised advantage estimates; all tensors (periods, lanes), on one device.

    Schulman et al., High-dimensional continuous control using generalised advantage estimation,
    ICLR 2016, Eq. (16).

    Args:
        rewards: of each period.
        ended: an episode's last period.
        value: of what was seen before each period.
        after: of what was seen after it, of the same episode; 0 where success or failure ended it.
        gamma: discount a period.
        gae_lambda: weight of the next period's surprise.
    """
    surprise = rewards + gamma * after - value
    estimate = torch.zeros_like(rewards)
    following = torch.zeros_like(rewards[0])
    for period in reversed(range(len(rewards))):
        following = surprise[period] + gamma * gae_lambda * following * ~ended[period]
        estimate[period] = following
    return estimate
