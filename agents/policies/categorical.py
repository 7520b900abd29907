"""Many choices among equally many options: one categorical over an array, not one a choice.

Stable-Baselines3 keeps a list of distributions and loops over it; with tens of choices that costs
more than the network.
"""

from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import MultiCategoricalDistribution
from stable_baselines3.common.policies import ActorCriticPolicy
from torch.distributions import Categorical


class EqualCategoricals(MultiCategoricalDistribution):
    """Independent choices, each among the same number of options.

    Args:
        choices: their number.
        options: of each choice.
    """

    def __init__(self, choices: int, options: int) -> None:
        super().__init__([options] * choices)
        self._shape = (choices, options)

    def proba_distribution(self, action_logits: torch.Tensor) -> "EqualCategoricals":
        """Take logits (lanes, choices x options), each choice's side by side."""
        logits = action_logits.reshape(-1, *self._shape)
        self._each = Categorical(logits=logits, validate_args=False)
        return self

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        """(lanes,) of actions (lanes, choices)."""
        each: torch.Tensor = self._each.log_prob(actions)  # type: ignore[no-untyped-call]
        return each.sum(dim=1)

    def entropy(self) -> torch.Tensor:
        """(lanes,) of all choices together."""
        each: torch.Tensor = self._each.entropy()  # type: ignore[no-untyped-call]
        return each.sum(dim=1)

    def sample(self) -> torch.Tensor:
        """Actions (lanes, choices), each by where a uniform falls among the probabilities' sums."""
        edges = self._each.probs.cumsum(dim=2)[:, :, :-1]
        uniform = torch.rand((*edges.shape[:2], 1), device=edges.device)
        return (uniform > edges).sum(dim=2)

    def mode(self) -> torch.Tensor:
        """The likeliest actions (lanes, choices)."""
        return self._each.logits.argmax(dim=2)


class EqualChoicesPolicy(ActorCriticPolicy):
    """Stable-Baselines3's actor and critic, with `EqualCategoricals` where the action space is a
    MultiDiscrete of equal choices. Parameters are named and shaped as there.
    """

    def _build(self, lr_schedule: Any) -> None:
        space = self.action_space
        if isinstance(space, spaces.MultiDiscrete) and len(set(space.nvec.tolist())) == 1:
            self.action_dist = EqualCategoricals(len(space.nvec), int(space.nvec[0]))
        super()._build(lr_schedule)
