"""Shared-policy PPO: one network decides for all agents (parcels or modules).

An environment has agent slots with one reward each. A sample is one decision: a module's choice, or
the choices for a whole table of parcels. It may earn the rewards of several slots.
"""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
import torch

from surface_gym import checks

from ..base import Booleans, Integers, Numbers
from ..tensors import check_like, load_optimizer
from . import ppo
from .algorithms import RolloutConfig
from .learner import learning_rate
from .runs import Curve

SMOOTH = 0.97  # [-] weight of earlier rollouts in the smoothed score


class Decision(NamedTuple):
    """Choices of all environments in a control period."""

    actions: Integers
    value: Numbers  # (slots,) expected return of every agent slot
    samples: tuple[torch.Tensor, ...]  # (samples, ...) inputs of the network
    slot: Integers  # (samples, ...) agent slot whose return counts for a choice
    present: torch.Tensor  # (samples, ...) whether an agent is in the slot
    log_prob: torch.Tensor  # (samples, ...) log probability of the choice


class SlotOutcome(NamedTuple):
    """Outcome of a control period for every agent slot (slots,)."""

    reward: Numbers
    ended: Booleans  # whether the agent or its episode has ended
    after: Numbers  # expected return of a truncated agent; else 0


class Evaluation(NamedTuple):
    """The current network's evaluation of the choices of present agents."""

    log_prob: torch.Tensor  # (choices,)
    value: torch.Tensor  # (choices,)
    entropy: torch.Tensor  # () mean


Network = TypeVar("Network", bound=torch.nn.Module)
Config = TypeVar("Config", bound=RolloutConfig)


class SharedLearner(ABC, Generic[Network, Config]):
    """Training by PPO of one network, actor and critic, that all agents share.

    Args:
        config: configuration of the run.
        network: network to train; parameter names of its critic begin with "critic".
    """

    value_coef: ClassVar[float] = 0.5  # weight of the critic's loss
    adam_eps: ClassVar[float] = 1e-8
    most_kl: ClassVar[float] = math.inf  # [nat] KL divergence that ends the passes over a rollout
    critic_first: ClassVar[int] = 0  # rollouts in which only the critic learns
    _rng: np.random.Generator

    def __init__(self, config: Config, network: Network) -> None:
        self._config = config
        self._learning = network
        self._best_network = copy.deepcopy(network)
        self._optimiser = torch.optim.Adam(
            network.parameters(), config.learning_rate, eps=self.adam_eps
        )
        self._score = self._best = -math.inf  # [1/s] smoothed reward rate of an environment
        self.infos: list[dict[str, Any]] = []  # infos of ended episodes
        self.steps = 0

    @property
    def network(self) -> torch.nn.Module:
        """Network of the policy: the best so far."""
        return self._best_network

    def learn(self, curve: Curve) -> None:
        config = self._config
        for group in self._optimiser.param_groups:
            group["lr"] = learning_rate(config, self.steps)
        batch = self.roll_out()
        rollout = config.n_steps * config.num_envs
        critic_only = self.steps < self.critic_first * rollout
        if self._score > self._best and not critic_only:
            self._best = self._score
            self._best_network.load_state_dict(self._learning.state_dict())
        for _ in range(config.n_epochs):
            moved = [
                self.step([each[chosen] for each in batch], critic_only)
                for chosen in shuffle(self._rng, len(batch[0]), config.batch_size)
            ]
            if np.mean(moved) > self.most_kl:
                break
        self.steps += rollout
        curve.add_episodes(self.infos)
        self.infos.clear()

    def state(self) -> dict[str, Any]:
        return {
            "network": self._best_network.state_dict(),
            "learning": self._learning.state_dict(),
            "score": self._score,
            "best": self._best,
            "optimiser": self._optimiser.state_dict(),
            "steps": self.steps,
        }

    def restore(self, state: dict[str, Any]) -> None:
        weights = self._learning.state_dict()
        own = {"network": weights, "learning": weights, "steps": 0}
        for name, values in own.items():
            check_like(name, state[name], values)
        for name in ("score", "best"):
            checks.instance(name, state[name], float, "a number")
        self._score, self._best = state["score"], state["best"]
        self._best_network.load_state_dict(state["network"])
        self._learning.load_state_dict(state["learning"])
        load_optimizer(self._optimiser, state["optimiser"])
        self.steps = state["steps"]

    @abstractmethod
    def begin(self, seed: int) -> None:
        """Begin training; the seed sets all random numbers."""

    @abstractmethod
    def _decide(self) -> Decision:
        """Decide for all environments, given their current observations."""

    @abstractmethod
    def _move(self, actions: Integers) -> SlotOutcome:
        """Step all environments by a control period, and observe them."""

    @abstractmethod
    def _value(self) -> Numbers:
        """Return the expected returns (slots,) of all agents."""

    @abstractmethod
    def _evaluate(self, samples: list[torch.Tensor]) -> Evaluation:
        """Evaluate the choices of samples with the current network."""

    @torch.no_grad()
    def roll_out(self) -> list[torch.Tensor]:
        """Collect samples as tensors with one row each.

        Returns:
            Inputs of `_evaluate`, presence of agents, log probabilities of their choices,
                normalised advantages, and returns.
        """
        decisions: list[Decision] = []
        outcomes: list[SlotOutcome] = []
        for _ in range(self._config.n_steps):
            decisions.append(self._decide())
            outcomes.append(self._move(decisions[-1].actions))
        value = np.stack([each.value for each in decisions]).astype(np.float64)
        ended = np.stack([each.ended for each in outcomes])
        rewards = np.stack([each.reward for each in outcomes])
        after = np.stack([each.after for each in outcomes]).astype(np.float64)
        following = np.concatenate([value[1:], self._value()[np.newaxis]])
        self._rate(rewards)
        advantages = ppo.compute_advantages(
            torch.from_numpy(rewards),
            torch.from_numpy(ended),
            torch.from_numpy(value),
            torch.from_numpy(np.where(ended, after, following)),
            self._config.gamma,
            self._config.gae_lambda,
        ).numpy()
        advantage, returns = (
            np.concatenate([row[each.slot] for row, each in zip(table, decisions, strict=True)])
            for table in (advantages, advantages + value)
        )
        present = torch.cat([each.present for each in decisions])
        of_agents = advantage[present.numpy()]
        advantage = (advantage - of_agents.mean()) / (of_agents.std() + 1e-8)
        return [
            *map(torch.cat, zip(*(each.samples for each in decisions), strict=True)),
            present,
            torch.cat([each.log_prob for each in decisions]),
            *(torch.from_numpy(each.astype(np.float32)) for each in (advantage, returns)),
        ]

    def _rate(self, rewards: Numbers) -> None:
        """Rate the policy by a rollout's rewards (periods, slots)."""
        seconds = len(rewards) * self._config.num_envs * self._config.control_period
        score = float(rewards.sum()) / seconds
        before = self._score if math.isfinite(self._score) else score
        self._score = SMOOTH * before + (1.0 - SMOOTH) * score

    def step(self, batch: list[torch.Tensor], critic_only: bool) -> float:
        """Take a gradient step; return the KL divergence [nat] from the policy of the rollout
        before it.
        """
        *samples, present, old_log_prob, advantage, returns = batch
        found = self._evaluate(samples)
        old_log_prob, advantage, returns = (
            each[present] for each in (old_log_prob, advantage, returns)
        )
        loss = ppo.ppo_loss(
            found.log_prob, old_log_prob, advantage, found.value, returns, found.entropy,
            self._config.ent_coef, self.value_coef,
        )  # fmt: skip
        self._optimiser.zero_grad()
        torch.autograd.backward(loss)
        if critic_only:
            for name, parameter in self._learning.named_parameters():
                if not name.startswith("critic"):
                    parameter.grad = None
        torch.nn.utils.clip_grad_norm_(self._learning.parameters(), ppo.MAX_GRAD_NORM)
        self._optimiser.step()
        ratio = (found.log_prob - old_log_prob).detach()
        return float((ratio.exp() - 1.0 - ratio).mean())


def gather(log_probability: torch.Tensor, choice: torch.Tensor) -> torch.Tensor:
    """Return log probabilities of choices (samples,), from log probabilities (samples, choices)."""
    return log_probability.gather(1, choice.long()[:, None])[:, 0]


def mean_entropy(log_probability: torch.Tensor) -> torch.Tensor:
    """Compute the mean entropy [nat] from log probabilities (samples, choices)."""
    return -(log_probability.exp() * log_probability).sum(dim=1).mean()


def shuffle(rng: np.random.Generator, count: int, size: int) -> Iterator[torch.Tensor]:
    """Yield the indices of all samples in random order, in batches of `size`."""
    order = rng.permutation(count)
    for first in range(0, count, size):
        yield torch.from_numpy(order[first : first + size])
