"""A learning algorithm of your own: REINFORCE, which raises the odds of choices with high returns.

python train.py --task sort --algo examples/reinforce.py:REINFORCE
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from surface_gym.agents.learning.config import ParcelConfig, make_card
from surface_gym.agents.learning.learner import learning_rate, train_learner
from surface_gym.agents.learning.runs import Curve
from surface_gym.agents.learning.sb3 import make_training_envs
from surface_gym.agents.library import Algorithm, PolicyCard, TrainedPolicy, find_task
from surface_gym.agents.tensors import check_like, load_optimizer, load_weights
from surface_gym.config import EnvConfig


@dataclass(frozen=True, kw_only=True)
class ReinforceConfig(ParcelConfig):
    """Options of REINFORCE."""

    gamma: float = 0.97
    """Discount factor of a control period."""
    n_steps: int = 100
    """Control periods of each environment between updates, which begin with new episodes."""


def make_network(card: PolicyCard, config: EnvConfig) -> nn.Sequential:
    """Make the untrained network of an environment."""
    sizes = (len(config.features), *card.hidden)
    layers = [layer for each in pairwise(sizes) for layer in (nn.Linear(*each), nn.Tanh())]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], len(config.chosen_orientations) ** 2))


def draw(logits: torch.Tensor) -> torch.Tensor:
    """Draw choices (num_envs,) from logits (num_envs, choices)."""
    return logits.softmax(dim=1).multinomial(1)[:, 0]


class ReinforcePolicy(TrainedPolicy):
    """Takes the network's most likely choice, or draws a choice by the probabilities."""

    def __init__(self, network: nn.Module, card: PolicyCard, config: EnvConfig) -> None:
        super().__init__(card, config)
        self._network = network

    @torch.no_grad()
    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        logits = self._network(torch.from_numpy(batch))
        return (logits.argmax(dim=1) if deterministic else draw(logits)).numpy(), None


class ReinforceLearner:
    """Learns from rollouts that contain whole episodes."""

    def __init__(self, config: ReinforceConfig) -> None:
        card = make_card(config)
        torch.manual_seed(config.seed)
        self.network = make_network(card, card.env_config(find_task(config.task)))
        self.steps = 0
        self._config, self._envs = config, make_training_envs(config)
        self._optimiser = torch.optim.Adam(self.network.parameters(), config.learning_rate)

    def begin(self, seed: int) -> None:
        torch.manual_seed(seed)
        self._envs.seed(seed)

    def learn(self, curve: Curve) -> None:
        seen: list[torch.Tensor] = []
        taken: list[torch.Tensor] = []
        paid: list[Any] = []
        over: list[Any] = []
        observation = self._envs.reset()
        for _ in range(self._config.n_steps):
            seen.append(torch.from_numpy(np.array(observation)))
            with torch.no_grad():
                taken.append(draw(self.network(seen[-1])))
            observation, rewards, ended, infos = self._envs.step(taken[-1].numpy())
            paid.append(rewards)
            over.append(ended)
            curve.add_episodes(infos)
        returns, following = np.zeros_like(paid), np.zeros_like(paid[0])
        for k in reversed(range(len(paid))):
            following = paid[k] + self._config.gamma * following * ~over[k]
            returns[k] = following
        weight = torch.from_numpy((returns - returns.mean()) / (returns.std() + 1e-8)).float()
        every = self.network(torch.stack(seen)).log_softmax(dim=2)
        likely = every.gather(2, torch.stack(taken)[..., None])[..., 0]
        self._optimiser.param_groups[0]["lr"] = learning_rate(self._config, self.steps)
        self._optimiser.zero_grad()
        torch.autograd.backward(-(weight * likely).mean())
        self._optimiser.step()
        self.steps += returns.size

    def state(self) -> dict[str, Any]:
        weights, optimiser = self.network.state_dict(), self._optimiser.state_dict()
        return {"network": weights, "optimiser": optimiser, "steps": self.steps}

    def restore(self, state: dict[str, Any]) -> None:
        check_like("network", state["network"], self.network.state_dict())
        self.network.load_state_dict(state["network"])
        load_optimizer(self._optimiser, state["optimiser"])
        self.steps = state["steps"]


def train(config: ReinforceConfig, folder: Path, on_progress: Any) -> Any:
    """Train by the options, and write a policy to a folder."""
    return train_learner(config, folder, on_progress, ReinforceLearner)


def build(card: PolicyCard, weights: Any, config: EnvConfig) -> ReinforcePolicy:
    """Build a policy from its weights."""
    network = load_weights(lambda: make_network(card, config), card.hidden, weights)
    return ReinforcePolicy(network, card, config)


REINFORCE = Algorithm("REINFORCE", ReinforceConfig, train, build, actions=("halves",))
