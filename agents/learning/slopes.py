"""Learning on a slope: several surfaces, rewards per parcel, and PPO.

Each parcel gets its own rewards, and a share of the others' rewards.
"""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
import torch

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, JAM, WRONG
from surface_gym.parcel import assortment
from surface_gym.state import OUT_OF_TIME

from ..base import Booleans, Integers, Numbers, Singles
from ..library import find_algorithm, find_task
from ..parcel_policy import Proposer
from ..tensors import check_like, load_optimizer
from . import ppo
from .algorithms import LocalConfig, ParcelsConfig
from .learner import learning_rate
from .runs import Curve

DURATION = 60.0  # [s] of an episode
SHAPES = 64  # shapes of the lab in each group of environments
JAMMED = -1.0  # reward of every parcel in a jam
STALLED = 15.0  # [s] time without departures that counts as a jam
SHARED = 0.2  # share of the rewards of all others on the surface
CRITIC_FIRST = 10  # initial rollouts in which only the critic learns
VALUE_COEF = 0.5
SMOOTH = 0.97  # [-] weight of earlier rollouts in the score


def training_configs(config: ParcelsConfig | LocalConfig) -> list[EnvConfig]:
    """List the training environments: each task with exact sensors and in the lab."""
    found = []
    for task in find_task(config.task).training_tasks():
        common = {
            "actions": config.actions, "control_period": config.control_period,
            "duration": DURATION, **find_algorithm(config.algo).env_kwargs,
        }  # fmt: skip
        stream = EnvConfig(task=task).stream_task.stream
        for seed in range(2):
            shapes = tuple((each, 1.0) for each in assortment(SHAPES, seed))
            shaped = replace(stream, parcels=shapes)
            found.append(EnvConfig(task=task, stream=shaped, preset="lab", **common))
        found.append(EnvConfig(task=task, **common))
    return found


class SlopeObservations(NamedTuple):
    """Observations of all environments, and the rule's choices."""

    tables: Singles  # (num_envs, rows, features)
    proposed: Integers  # (num_envs, rows)


class SlopeStep(NamedTuple):
    """Result of a control period for all rows (num_envs, rows)."""

    reward: Numbers
    left: Booleans  # whether the row's parcel has departed
    # (num_envs,) detected by the environment, or by a long time without departures
    jammed: Booleans
    out_of_time: Booleans  # (num_envs,)
    last: Singles  # (out of time, rows, features) final tables of truncated environments


class Surfaces:
    """Environments of several configurations, which restart when they end."""

    def __init__(self, configs: list[EnvConfig], num_envs: int) -> None:
        self.batches = [
            StreamBatch(config, len(part))
            for config, part in zip(
                configs, np.array_split(np.arange(num_envs), len(configs)), strict=True
            )
        ]
        self.num_envs, self.rows = num_envs, self.batches[0].rows
        self.orientations = len(configs[0].chosen_orientations)
        self._rules = [Proposer(config) for config in configs]
        task = configs[0].stream_task
        weights = [task.learning_weights.get(term, 1.0) for term in task.parcel_terms]
        self._weights = np.array(weights)
        self._terms = task.terms
        self._sums = np.zeros((num_envs, len(self._terms)))
        # [s] since the last departure, or since the surface was empty
        self._quiet = np.zeros(num_envs)
        self.infos: list[dict[str, Any]] = []  # infos of ended episodes

    def begin(self, rng: np.random.Generator) -> None:
        """Restart all episodes with seeds from a generator."""
        self._rng = rng
        self._sums[:] = self._quiet[:] = 0.0
        self._memories: list[Any] = [None] * len(self.batches)
        for batch in self.batches:
            self._reset(batch, np.arange(batch.num_envs))
        self._fresh = [np.ones(batch.num_envs, dtype=np.bool_) for batch in self.batches]

    def see(self) -> SlopeObservations:
        """Observe all environments, once per control period since the rule has a memory."""
        proposed = []
        for k, (rule, batch) in enumerate(zip(self._rules, self.batches, strict=True)):
            choice, self._memories[k] = rule.propose(
                batch.observation, self._memories[k], self._fresh[k]
            )
            proposed.append(choice)
        tables = np.concatenate([batch.observation for batch in self.batches])
        return SlopeObservations(tables, np.concatenate(proposed))

    def step(self, halves: Integers) -> SlopeStep:
        """Step all by a control period with choices (num_envs, ...) of halves or modules."""
        parts = [self._step(*each) for each in self._parts(halves)]
        self._fresh = [each.jammed | each.out_of_time for each in parts]
        return _join(parts)

    def _parts(self, halves: Integers) -> Iterator[tuple[StreamBatch, Integers, Numbers, Numbers]]:
        first = 0
        for batch in self.batches:
            here = slice(first, first + batch.num_envs)
            yield batch, halves[here], self._sums[here], self._quiet[here]
            first += batch.num_envs

    def _step(
        self, batch: StreamBatch, halves: Integers, sums: Numbers, quiet: Numbers
    ) -> SlopeStep:
        streams = batch.streams
        number, there = streams.number.copy(), streams.present.copy()
        batch.step(halves.reshape(batch.num_envs, -1))
        streams = batch.streams
        terms = batch.parcels.terms.reshape(*there.shape, -1)[..., : len(self._weights)]
        reward = np.where(there, terms @ self._weights, 0.0)
        left = there & ~(streams.present & (streams.number == number))
        timed = streams.outcome == OUT_OF_TIME
        quiet += batch.config.control_period
        quiet[left.any(axis=1) | ~streams.present.any(axis=1)] = 0.0
        jammed = (streams.outcome == JAM) | ((quiet > STALLED) & ~timed)
        reward[jammed] += np.where(there[jammed], JAMMED, 0.0)
        reward += np.where(there, SHARED * (reward.sum(axis=1, keepdims=True) - reward), 0.0)
        sums += batch.terms
        last = batch.observation[timed].copy()
        ended = np.nonzero(jammed | timed)[0]
        for i in ended.tolist():
            delivered = max(1, int(streams.tally[i, [CORRECT, WRONG]].sum()))
            self.infos.append(
                {
                    "is_success": float(streams.tally[i, CORRECT] / delivered),
                    "episode": {"r": float(sums[i].sum()), "l": float(streams.clock[i])},
                    "reward_terms": dict(zip(self._terms, sums[i].tolist(), strict=True)),
                }
            )
        sums[ended] = quiet[ended] = 0.0
        self._reset(batch, ended)
        return SlopeStep(reward, left, jammed, timed, last)

    def _reset(self, batch: StreamBatch, chosen: Integers) -> None:
        for i in chosen.tolist():
            batch.seed(i, np.random.default_rng(self._rng.integers(2**63)))
        if len(chosen):
            batch.reset(chosen)


def _join(parts: list[SlopeStep]) -> SlopeStep:
    return SlopeStep(*map(np.concatenate, zip(*parts, strict=True)))


class RolloutData(NamedTuple):
    """Data of a rollout for all rows (num_envs x rows,) in each control period."""

    value: list[Any]
    reward: list[Numbers]
    ended: list[Booleans]
    following: list[Any]  # value after the period


Network = TypeVar("Network", bound=torch.nn.Module)


class SlopeLearner(ABC, Generic[Network]):
    """Training of a policy on slopes and of the parcels' values by PPO."""

    most_kl: ClassVar[float]  # [nat] change of the policy after which no further pass follows
    _rng: np.random.Generator

    def __init__(
        self, config: ParcelsConfig | LocalConfig, surfaces: "Surfaces", network: Network
    ) -> None:
        self._config = config
        self._surfaces = surfaces
        self._learning = network
        self.network = copy.deepcopy(network)  # best network so far
        self._optimiser = torch.optim.Adam(network.parameters(), config.learning_rate)
        self._score = self._best = -math.inf  # [1/s] smoothed rewards of an environment
        self.steps = 0

    def learn(self, curve: Curve) -> None:
        for group in self._optimiser.param_groups:
            group["lr"] = learning_rate(self._config, self.steps)
        samples = self._roll_out()
        rollout = self._config.n_steps * self._config.num_envs
        critic_only = self.steps < CRITIC_FIRST * rollout
        if self._score > self._best and not critic_only:
            self._best = self._score
            self.network.load_state_dict(self._learning.state_dict())
        for _ in range(self._config.n_epochs):
            moved = [
                self._step([each[chosen] for each in samples], critic_only)
                for chosen in shuffle(self._rng, len(samples[0]), self._config.batch_size)
            ]
            if np.mean(moved) > self.most_kl:
                break
        self.steps += rollout
        curve.add_episodes(self._surfaces.infos)
        self._surfaces.infos.clear()

    def state(self) -> dict[str, Any]:
        return {
            "network": self.network.state_dict(),
            "learning": self._learning.state_dict(),
            "score": self._score,
            "best": self._best,
            "optimiser": self._optimiser.state_dict(),
            "steps": self.steps,
        }

    def restore(self, state: dict[str, Any]) -> None:
        weights = self.network.state_dict()
        own = {"network": weights, "learning": weights, "steps": 0}
        for name, values in own.items():
            check_like(name, state[name], values)
        for name in ("score", "best"):
            checks.instance(name, state[name], float, "a number")
        self._score, self._best = state["score"], state["best"]
        self.network.load_state_dict(state["network"])
        self._learning.load_state_dict(state["learning"])
        load_optimizer(self._optimiser, state["optimiser"])
        self.steps = state["steps"]

    @abstractmethod
    def begin(self, seed: int) -> None:
        """Begin to learn, with random numbers from a seed."""

    @abstractmethod
    def _roll_out(self) -> list[torch.Tensor]:
        """Collect samples, one row per sample in all tensors."""

    @abstractmethod
    def _step(self, samples: list[torch.Tensor], critic_only: bool) -> float:
        """Do a gradient step; return the change [nat] of the policy."""

    def _compute_returns(self, kept: RolloutData) -> tuple[Numbers, Numbers]:
        """Compute advantages and returns (periods, num_envs x rows), and rate the policy."""
        rewards, value = np.stack(kept.reward), np.stack(kept.value).astype(np.float64)
        self._rate(rewards)
        advantage = ppo.compute_advantages(
            torch.from_numpy(rewards),
            torch.from_numpy(np.stack(kept.ended)),
            torch.from_numpy(value),
            torch.from_numpy(np.stack(kept.following).astype(np.float64)),
            self._config.gamma,
            self._config.gae_lambda,
        ).numpy()
        return advantage, advantage + value

    def _rate(self, rewards: Numbers) -> None:
        """Rate the policy by the rewards (periods, num_envs x rows) of a rollout."""
        seconds = len(rewards) * self._surfaces.num_envs * self._config.control_period
        score = float(rewards.sum()) / seconds
        before = self._score if math.isfinite(self._score) else score
        self._score = SMOOTH * before + (1.0 - SMOOTH) * score

    def _improve(
        self,
        log_probability: torch.Tensor,
        value: torch.Tensor,
        old: tuple[torch.Tensor, ...],
        critic_only: bool,
    ) -> float:
        """Do a step of PPO; return the change [nat] of the policy.

        Args:
            log_probability: (samples, choices).
            value: (samples,) expected returns.
            old: choice, log probability, normalised advantage and return of the samples.
            critic_only: whether the actor does not change.
        """
        choice, old_log_prob, advantage, returns = old
        log_prob = log_probability.gather(1, choice.long()[:, None])[:, 0]
        entropy = -(log_probability.exp() * log_probability).sum(dim=1).mean()
        loss = ppo.ppo_loss(
            log_prob, old_log_prob, advantage, value, returns, entropy,
            self._config.ent_coef, VALUE_COEF,
        )  # fmt: skip
        self._descend(loss, critic_only)
        ratio = (log_prob - old_log_prob).detach()
        return float((ratio.exp() - 1.0 - ratio).mean())

    def _descend(self, loss: torch.Tensor, critic_only: bool) -> None:
        """Do a gradient step on a loss, initially without the actor's gradient."""
        self._optimiser.zero_grad()
        torch.autograd.backward(loss)
        if critic_only:
            for name, parameter in self._learning.named_parameters():
                if not name.startswith("critic"):
                    parameter.grad = None
        torch.nn.utils.clip_grad_norm_(self._learning.parameters(), ppo.MAX_GRAD_NORM)
        self._optimiser.step()


def shuffle(rng: np.random.Generator, count: int, size: int) -> Iterator[torch.Tensor]:
    """Yield batches of indices of all samples in random order."""
    order = rng.permutation(count)
    for first in range(0, count, size):
        yield torch.from_numpy(order[first : first + size])
