"""Trained policies with Stable-Baselines3's networks."""

from typing import Any, cast

import torch
from gymnasium import spaces
from stable_baselines3.common import policies
from stable_baselines3.common.distributions import MultiCategoricalDistribution
from stable_baselines3.dqn.policies import DQNPolicy
from torch.distributions import Categorical

from surface_gym.config import EnvConfig

from .base import SIDE, action_mirror
from .library import PolicyCard, TrainedPolicy, Weights
from .tensors import load_weights


class EqualCategoricals(MultiCategoricalDistribution):
    """Independent choices with equal numbers of options, as one array categorical.

    Stable-Baselines3 loops over a list of distributions, which takes longer than the network for
    tens of choices.
    """

    def __init__(self, choices: int, options: int) -> None:
        super().__init__([options] * choices)
        self._shape = (choices, options)

    def proba_distribution(self, action_logits: torch.Tensor) -> "EqualCategoricals":
        """Set the logits (num_envs, choices x options), grouped by choice."""
        logits = action_logits.reshape(-1, *self._shape)
        self._each: Any = Categorical(logits=logits, validate_args=False)  # methods are untyped
        return self

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        each: torch.Tensor = self._each.log_prob(actions)
        return each.sum(dim=1)

    def entropy(self) -> torch.Tensor:
        each: torch.Tensor = self._each.entropy()
        return each.sum(dim=1)

    def sample(self) -> torch.Tensor:
        """Draw actions (num_envs, choices) by inverting the cumulative probabilities."""
        edges = self._each.probs.cumsum(dim=2)[:, :, :-1]
        uniform = torch.rand((*edges.shape[:2], 1), device=edges.device)
        return (uniform > edges).sum(dim=2)

    def mode(self) -> torch.Tensor:
        return self._each.logits.argmax(dim=2)


class EqualChoicesPolicy(policies.ActorCriticPolicy):
    """Stable-Baselines3's actor and critic, with `EqualCategoricals` for equal choices.

    It applies to MultiDiscrete action spaces. Names and shapes of parameters are unchanged.
    """

    def _build(self, lr_schedule: Any) -> None:
        space = self.action_space
        if isinstance(space, spaces.MultiDiscrete) and len(set(space.nvec.tolist())) == 1:
            self.action_dist = EqualCategoricals(len(space.nvec), int(space.nvec[0]))
        super()._build(lr_schedule)


def _no_optimizer(*_: Any, **__: Any) -> None:
    """Make no optimizer: for the first one, PyTorch imports its compiler, which takes 2 s."""


NETWORKS = {"ppo": EqualChoicesPolicy, "dqn": DQNPolicy}


def make_network(card: PolicyCard, config: EnvConfig) -> policies.BasePolicy:
    """Build the network of a card for an environment, without weights."""
    return NETWORKS[card.algo](
        config.observation_space(),
        config.action_space(),
        lambda _: 0.0,
        net_arch=list(card.hidden),
        optimizer_class=cast(Any, _no_optimizer),
    )


class Policy(TrainedPolicy):
    """A trained PPO or DQN policy."""

    def __init__(self, network: policies.BasePolicy, card: PolicyCard, config: EnvConfig) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        super().__init__(card, config)
        self._network = network
        self._network.set_training_mode(False)
        self._mirror = action_mirror(config)

    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        actions = self._network.predict(batch, deterministic=deterministic)[0]
        return (actions if self._mirror is None else self._mirror(actions, batch[:, SIDE])), None


def build_policy(card: PolicyCard, weights: Weights, config: EnvConfig) -> Policy:
    """Build a policy of PPO or DQN from its weights."""
    network = load_weights(lambda: make_network(card, config), card.hidden, weights)
    return Policy(network, card, config)
