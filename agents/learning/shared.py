"""Shared-policy PPO: one network decides for all agents (parcels or modules).

An environment has agent slots. A slot is the place of one agent, and gets one reward. A sample of
PPO is one decision: a module's choice, or the choices for all parcels of an environment's table. In
a table, each parcel has a slot.

`ModuleLearner` trains the modules of Sort. The module `slopes` has the learners for slopes.
"""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
import torch

from surface_gym import checks
from surface_gym.config import EnvConfig

from ..base import Booleans, Integers, Numbers, Singles
from ..module_policy import SortModuleView, ValueNetwork, make_actor
from ..tensors import GROUPS, check_like, draw_choices, draw_groups, load_optimizer, log_likelihood
from .algorithms import ModulesConfig, RolloutConfig
from .config import make_card
from .learner import ADAM_EPS, MAX_GRAD_NORM, PlainAdam, compute_advantages, learning_rate, ppo_loss
from .runs import Curve
from .sb3 import make_training_envs

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
    """Numbers that the current network computes for choices of agents."""

    log_prob: torch.Tensor  # (choices,)
    value: torch.Tensor  # (choices,)
    entropy: torch.Tensor  # () mean


Network = TypeVar("Network", bound=torch.nn.Module)
Config = TypeVar("Config", bound=RolloutConfig)


class SharedLearner(ABC, Generic[Network, Config]):
    """Base class of learners that train one actor and critic for all agents, by PPO.

    Args:
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
        self._optimiser = PlainAdam(network.parameters(), config.learning_rate, eps=self.adam_eps)
        self._score = self._best = -math.inf  # [1/s] smoothed reward rate of an environment
        self.infos: list[dict[str, Any]] = []  # infos of ended episodes
        self.steps = 0

    @property
    def network(self) -> torch.nn.Module:
        """The network with the highest score until now."""
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
        """Restart all environments; the seed sets all random numbers."""

    @abstractmethod
    def _decide(self) -> Decision:
        """Decide for all environments, given their current observations."""

    @abstractmethod
    def _move(self, actions: Integers) -> SlotOutcome:
        """Step all environments by a control period, and observe the result."""

    @abstractmethod
    def _value(self) -> Numbers:
        """Return the expected returns (slots,) of all agents."""

    @abstractmethod
    def _evaluate(self, samples: list[torch.Tensor]) -> Evaluation:
        """Let the current network evaluate the choices in `samples`."""

    @torch.no_grad()
    def roll_out(self) -> list[torch.Tensor]:
        """Run a rollout, and return its samples as tensors with one row for each sample.

        Returns:
            Inputs of `_evaluate`, presence of agents, log probabilities of the agents' choices,
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
        advantages = compute_advantages(
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
        """Update the policy's smoothed score with the rewards (periods, slots) of a rollout."""
        seconds = len(rewards) * self._config.num_envs * self._config.control_period
        score = float(rewards.sum()) / seconds
        before = self._score if math.isfinite(self._score) else score
        self._score = SMOOTH * before + (1.0 - SMOOTH) * score

    def step(self, batch: list[torch.Tensor], critic_only: bool) -> float:
        """Take a gradient step on samples of `roll_out`. If `critic_only`, the actor is unchanged.

        Returns:
            KL divergence [nat] from the rollout's policy to the policy just before this step.
        """
        *samples, present, old_log_prob, advantage, returns = batch
        found = self._evaluate(samples)
        old_log_prob, advantage, returns = (
            each[present] for each in (old_log_prob, advantage, returns)
        )
        loss = ppo_loss(
            found.log_prob, old_log_prob, advantage, found.value, returns, found.entropy,
            self._config.ent_coef, self.value_coef,
        )  # fmt: skip
        self._optimiser.zero_grad()
        torch.autograd.backward(loss)
        if critic_only:
            for name, parameter in self._learning.named_parameters():
                if not name.startswith("critic"):
                    parameter.grad = None
        torch.nn.utils.clip_grad_norm_(self._learning.parameters(), MAX_GRAD_NORM)
        self._optimiser.step()
        ratio = (found.log_prob - old_log_prob).detach()
        return float((ratio.exp() - 1.0 - ratio).mean())


def gather(log_probability: torch.Tensor, choice: torch.Tensor) -> torch.Tensor:
    """Select each choice's log probability (samples,) from all log probabilities (samples, n)."""
    return log_probability.gather(1, choice.long()[:, None])[:, 0]


def mean_entropy(log_probability: torch.Tensor) -> torch.Tensor:
    """Compute the mean entropy [nat] from log probabilities (samples, choices)."""
    return -(log_probability.exp() * log_probability).sum(dim=1).mean()


def shuffle(rng: np.random.Generator, count: int, size: int) -> Iterator[torch.Tensor]:
    """Yield the indices of all samples in random order, in batches of `size`."""
    order = rng.permutation(count)
    for first in range(0, count, size):
        yield torch.from_numpy(order[first : first + size])


class ModulesNetwork(torch.nn.Module):
    """Actor of the modules, and critic of their environment."""

    def __init__(self, env_config: EnvConfig, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self.actor = make_actor(env_config, hidden)
        self.critic = ValueNetwork(hidden, env_config.observed_groups)


class ModuleLearner(SharedLearner[ModulesNetwork, ModulesConfig]):
    """Training of the modules' policy, and of a network for the value of an environment's state.

    An agent slot is a whole environment, because its modules share one reward. A sample consists of
    the choices of all modules under the parcel.
    """

    value_coef = 1.0  # the networks share no weights
    adam_eps = ADAM_EPS

    def __init__(self, config: ModulesConfig) -> None:
        self._envs = make_training_envs(config)
        env_config = make_card(config).env_config()
        self._view = SortModuleView(env_config)
        torch.manual_seed(config.seed)
        super().__init__(config, ModulesNetwork(env_config, config.hidden))
        self._seen: Singles = np.empty((0, 0), dtype=np.float32)
        # Place, group and choice of the modules of all samples.
        self._modules: list[torch.Tensor] = []

    @property
    def network(self) -> torch.nn.Module:
        """The actor of the current network, not of the network with the best score."""
        return self._learning.actor

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._envs.seed(seed)
        self._seen = np.asarray(self._envs.reset())

    def roll_out(self) -> list[torch.Tensor]:
        self._parts: list[tuple[torch.Tensor, ...]] = []
        batch = super().roll_out()
        self._modules = [torch.cat(each) for each in zip(*self._parts, strict=True)]
        return batch

    def _decide(self) -> Decision:
        num_envs = len(self._seen)
        seen = self._view(self._seen)
        shared, env, place = map(torch.from_numpy, (seen.shared, seen.env, seen.place))
        log_probability = self._learning.actor.log_probability(shared, env, place)
        probability = self._config.split_probability
        groups = draw_groups(seen.env, seen.place, num_envs, probability, self._rng)
        group = torch.from_numpy(groups)
        uniform = torch.from_numpy(self._rng.random(GROUPS * num_envs, dtype=np.float32))
        choice = draw_choices(log_probability, group, uniform)
        count = torch.bincount(env, minlength=num_envs)
        first = sum(len(choice) for _, _, choice in self._parts) + count.cumsum(0) - count
        self._parts.append((place, group - GROUPS * env, choice))
        return Decision(
            self._view.actions(self._seen, seen, choice.numpy()),
            self._value(),
            (torch.from_numpy(self._seen), shared, first, count),
            np.arange(num_envs),
            torch.ones(num_envs, dtype=torch.bool),
            log_likelihood(log_probability, choice, group, GROUPS * num_envs),
        )

    def _move(self, actions: Integers) -> SlotOutcome:
        observations, rewards, ended, infos = self._envs.step(actions)
        self._seen = np.asarray(observations)
        self.infos += infos
        after = np.zeros(len(ended))
        timed = [i for i in np.nonzero(ended)[0] if infos[i]["TimeLimit.truncated"]]
        if timed:  # truncated episodes have a value
            after[timed] = self._compute_values(
                np.stack([infos[i]["terminal_observation"] for i in timed])
            )
        return SlotOutcome(rewards.astype(np.float64), ended, after)

    def _value(self) -> Numbers:
        return self._compute_values(self._seen)

    def _compute_values(self, observations: Singles) -> Any:
        return self._learning.critic(torch.from_numpy(observations)).numpy()

    def _evaluate(self, samples: list[torch.Tensor]) -> Evaluation:
        observations, shared, first, count = samples
        sample = torch.arange(len(count)).repeat_interleave(count)
        skipped = count.cumsum(0) - count
        index = torch.arange(int(count.sum())) + (first - skipped).repeat_interleave(count)
        place, group, choice = (each[index] for each in self._modules)
        log_probability = self._learning.actor.log_probability(shared, sample, place)
        log_prob = log_likelihood(
            log_probability, choice, GROUPS * sample + group, GROUPS * len(count)
        )
        value = self._learning.critic(observations)
        return Evaluation(log_prob, value, mean_entropy(log_probability))
