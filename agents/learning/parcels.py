"""PPO of parcels on a slope: one network for all of them, which corrects the rule of its task.

Each parcel has rewards of its own, and a part of the others'.
"""

import copy
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from surface_gym import checks
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.merge import lines
from surface_gym.flow.sequence import shuffled
from surface_gym.flow.state import JAM, RIGHT, WRONG
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import PARCEL_TERMS, bulk
from surface_gym.parcel import assortment
from surface_gym.state import OUT_OF_TIME, RUNNING

from ..base import Booleans, Integers, Numbers, Singles
from ..library import MOST_PARCELS
from ..parcel_policy import RULES, ParcelNetwork, propose, to_halves
from ..policy import check_like, load_optimizer
from . import ppo
from .config import ParcelsConfig
from .runs import Curve, OnProgress, TrainResult

DURATION = 60.0  # [s] of an episode
SHAPES = 64  # of the lab, in each of its groups of environments
# Times its reward that a term counts in learning: time is dear, since a queue waits at the edge.
WEIGHTS = {"right": 1.0, "wrong": 2.0, "touch": 5.0, "progress": 1.0, "time": 5.0}
JAMMED = -1.0  # reward of each parcel in a jam
SHARED = 0.2  # of the rewards of all others on the surface, that a parcel gets too
CRITIC_FIRST = 10  # rollouts in which only the critic learns
MOST_KL = 0.03  # [nat] that a pass may move the policy before a rollout has taught enough
VALUE_COEF = 0.5
SMOOTH = 0.9  # [-] of the score of all rollouts before the last
# Streams, offered faster than they are taken, and other arguments of the environments.
SCENARIOS: dict[str, list[tuple[Stream, dict[str, Any]]]] = {
    "singulate": [(bulk(14_000.0), {"exits": "mouth", "alignment": math.radians(10.0)})],
    "merge": [(lines(10_000.0), {})],
    "sequence": [(shuffled(2000.0, window), {}) for window in (4, 8)],
}


def training_configs(config: ParcelsConfig) -> list[EnvConfig]:
    """List the environments to learn from: each scenario with exact sensors and in the lab."""
    found = []
    for stream, more in SCENARIOS[config.task]:
        common = {
            "task": config.task, "actions": "parcels", "control_period": config.control_period,
            "duration": DURATION,
            "max_parcels": MOST_PARCELS, **more,
        }  # fmt: skip
        found += [_lab(seed, stream, common) for seed in range(2)]
        found.append(EnvConfig(stream=stream, **common))
    return found


def _lab(seed: int, stream: Stream, arguments: dict[str, Any]) -> EnvConfig:
    shapes = tuple((each, 1.0) for each in assortment(SHAPES, seed))
    lab = PRESETS["lab"]
    return EnvConfig(
        stream=replace(stream, parcels=shapes), sensors=lab.sensors,
        randomisation=lab.randomisation, actuators=lab.actuators, **arguments,
    )  # fmt: skip


class Seen(NamedTuple):
    """What is seen of all environments, and what the rule would choose."""

    tables: Singles  # (num_envs, rows, features)
    proposed: Integers  # (num_envs, rows)


class Stepped(NamedTuple):
    """What a control period led to, of all rows (num_envs, rows)."""

    reward: Numbers
    left: Booleans  # whether the parcel that was there is no more
    jammed: Booleans  # (num_envs,)
    out_of_time: Booleans  # (num_envs,)
    last: Singles  # (out of time, rows, features) tables at the end of these


class Surfaces:
    """Environments of several configurations, side by side, that begin anew as they end."""

    def __init__(self, configs: list[EnvConfig], num_envs: int) -> None:
        self.batches = [
            StreamBatch(config, len(part))
            for config, part in zip(
                configs, np.array_split(np.arange(num_envs), len(configs)), strict=True
            )
        ]
        self.num_envs, self.rows = num_envs, self.batches[0].rows
        self.orientations = len(configs[0].chosen_orientations)
        self._rules = [RULES[config.task_name](config) for config in configs]
        self._weights = np.array([WEIGHTS[term] for term in PARCEL_TERMS])
        self._terms = self.batches[0].config.task.terms
        self._sums = np.zeros((num_envs, len(self._terms)))
        self.infos: list[dict[str, Any]] = []  # of the episodes that have ended

    def begin(self, rng: np.random.Generator) -> None:
        """Begin all episodes anew, from seeds of a generator."""
        self._rng = rng
        self._sums[:] = 0.0
        self._memories: list[Any] = [None] * len(self.batches)
        for batch in self.batches:
            self._reset(batch, np.arange(batch.num_envs))
        self._fresh = [np.ones(batch.num_envs, dtype=np.bool_) for batch in self.batches]

    def see(self) -> Seen:
        """See all, once in a control period: the rule remembers what it has seen."""
        proposed = []
        for k, (rule, batch) in enumerate(zip(self._rules, self.batches, strict=True)):
            choice, self._memories[k] = propose(
                rule, batch.observation, self._memories[k], self._fresh[k], self.orientations
            )
            proposed.append(choice)
        tables = np.concatenate([batch.observation for batch in self.batches])
        return Seen(tables, np.concatenate(proposed))

    def step(self, halves: Integers) -> Stepped:
        """Move all by a control period, by choices (num_envs, rows, 2)."""
        parts = [self._step(*each) for each in self._parts(halves)]
        self._fresh = [each.jammed | each.out_of_time for each in parts]
        return _join(parts)

    def _parts(self, halves: Integers) -> Iterator[tuple[StreamBatch, Integers, Numbers]]:
        first = 0
        for batch in self.batches:
            here = slice(first, first + batch.num_envs)
            yield batch, halves[here], self._sums[here]
            first += batch.num_envs

    def _step(self, batch: StreamBatch, halves: Integers, sums: Numbers) -> Stepped:
        streams = batch.streams
        number, there = streams.number.copy(), streams.present.copy()
        batch.step(halves.reshape(batch.num_envs, -1))
        streams = batch.streams
        terms = batch.parcels.terms.reshape(*there.shape, -1)[..., : len(self._weights)]
        reward = np.where(there, terms @ self._weights, 0.0)
        left = there & ~(streams.present & (streams.number == number))
        jammed, timed = streams.outcome == JAM, streams.outcome == OUT_OF_TIME
        reward[jammed] += np.where(there[jammed], JAMMED, 0.0)
        reward += np.where(there, SHARED * (reward.sum(axis=1, keepdims=True) - reward), 0.0)
        sums += batch.terms
        last = batch.observation[timed].copy()
        ended = np.nonzero(streams.outcome != RUNNING)[0]
        for i in ended.tolist():
            delivered = max(1, int(streams.tally[i, [RIGHT, WRONG]].sum()))
            self.infos.append(
                {
                    "is_success": float(streams.tally[i, RIGHT] / delivered),
                    "episode": {"r": float(sums[i].sum()), "l": float(streams.clock[i])},
                    "reward_terms": dict(zip(self._terms, sums[i].tolist(), strict=True)),
                }
            )
        sums[ended] = 0.0
        self._reset(batch, ended)
        return Stepped(reward, left, jammed, timed, last)

    def _reset(self, batch: StreamBatch, chosen: Integers) -> None:
        for i in chosen.tolist():
            batch.seed(i, np.random.default_rng(self._rng.integers(2**63)))
        if len(chosen):
            batch.reset(chosen)


def _join(parts: list[Stepped]) -> Stepped:
    return Stepped(*map(np.concatenate, zip(*parts, strict=True)))


class ParcelLearner:
    """Network of the parcels' policy and value, and its training."""

    def __init__(self, config: ParcelsConfig) -> None:
        self._config = config
        configs = training_configs(config)
        self._surfaces = Surfaces(configs, config.num_envs)
        features = configs[0].row_space().shape[0]
        torch.manual_seed(config.seed)
        self._learning = ParcelNetwork(features, self._surfaces.orientations, config.hidden)
        self.network = copy.deepcopy(self._learning)  # the best so far
        self._optimiser = torch.optim.Adam(self._learning.parameters(), config.learning_rate)
        self._score = self._best = -math.inf  # [1/s] rewards of an environment, smoothed
        self.steps = 0

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._surfaces.begin(self._rng)
        self._seen = self._surfaces.see()

    def learn(self, curve: Curve) -> None:
        for group in self._optimiser.param_groups:
            group["lr"] = ppo.learning_rate(self._config, self.steps)
        tables, proposed, old = self._roll_out()
        critic_only = self.steps < CRITIC_FIRST * len(tables)
        if self._score > self._best and not critic_only:
            self._best = self._score
            self.network.load_state_dict(self._learning.state_dict())
        for _ in range(self._config.n_epochs):
            order = self._rng.permutation(len(tables))
            moved = []
            for first in range(0, len(order), self._config.batch_size):
                chosen = torch.from_numpy(order[first : first + self._config.batch_size])
                moved.append(
                    self._step(tables[chosen], proposed[chosen], old[:, chosen], critic_only)
                )
            if np.mean(moved) > MOST_KL:
                break
        self.steps += len(tables)
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
        own = {
            "network": self.network.state_dict(),
            "learning": self.network.state_dict(),
            "steps": 0,
        }
        for name, values in own.items():
            check_like(name, state[name], values)
        for name in ("score", "best"):
            checks.instance(name, state[name], float, "a number")
        self._score, self._best = state["score"], state["best"]
        self.network.load_state_dict(state["network"])
        self._learning.load_state_dict(state["learning"])
        load_optimizer(self._optimiser, state["optimiser"])
        self.steps = state["steps"]

    @torch.no_grad()
    def _decide(self, seen: Seen) -> tuple[Integers, Integers, Singles, Singles]:
        """Draw choices; return halves (num_envs, rows, 2), and of all rows (num_envs x rows,)
        choice, logarithm of its probability, and value.
        """
        found = self._learning(*map(torch.from_numpy, seen))
        log_probability = found.logits.log_softmax(dim=1)
        uniform = torch.from_numpy(self._rng.random((len(found.row), 1), dtype=np.float32))
        chosen = (uniform > log_probability.exp().cumsum(dim=1)[:, :-1]).sum(dim=1)
        choice, likely, value = (
            torch.zeros(seen.proposed.size, dtype=kind)
            for kind in (torch.int64, torch.float32, torch.float32)
        )
        choice[found.row] = chosen
        likely[found.row] = log_probability.gather(1, chosen[:, None])[:, 0]
        value[found.row] = found.value
        halves = to_halves(choice.numpy().reshape(seen.proposed.shape), self._surfaces.orientations)
        return halves, choice.numpy(), likely.numpy(), value.numpy()

    @torch.no_grad()
    def _roll_out(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Collect tables (samples, rows, features), what the rule proposed (samples, rows), and of
        their rows (4, samples, rows): choice, logarithm of its probability, normalised advantage,
        and return.
        """
        surfaces = self._surfaces
        all_seen: list[Seen] = []
        chosen: list[Integers] = []
        likely: list[Singles] = []
        values: list[Singles] = []
        rewards: list[Numbers] = []
        ended: list[Booleans] = []
        following: list[Singles] = []
        for _ in range(self._config.n_steps):
            seen = self._seen
            halves, choice, log_probability, value = self._decide(seen)
            if values:
                following[-1] = np.where(ended[-1], following[-1], value)
            stepped = surfaces.step(halves)
            self._seen = surfaces.see()
            all_seen.append(seen)
            chosen.append(choice)
            likely.append(log_probability)
            values.append(value)
            rewards.append(stepped.reward.ravel())
            timed = stepped.out_of_time
            ended.append((stepped.left | (stepped.jammed | timed)[:, np.newaxis]).ravel())
            after = np.zeros(stepped.left.shape, dtype=np.float32)
            if timed.any():  # an episode that is out of time could have gone on
                last = Seen(stepped.last, seen.proposed[timed])
                after[timed] = self._decide(last)[3].reshape(last.proposed.shape)
            following.append((after * ~stepped.left).ravel())
        following[-1] = np.where(ended[-1], following[-1], self._decide(self._seen)[3])
        self._rate(np.stack(rewards))
        value = np.stack(values).astype(np.float64)
        advantage = ppo.compute_advantages(
            torch.from_numpy(np.stack(rewards)),
            torch.from_numpy(np.stack(ended)),
            torch.from_numpy(value),
            torch.from_numpy(np.stack(following).astype(np.float64)),
            self._config.gamma,
            self._config.gae_lambda,
        ).numpy()
        tables, proposed = map(np.concatenate, zip(*all_seen, strict=True))
        shape = proposed.shape
        returns, advantage = (advantage + value).reshape(shape), advantage.reshape(shape)
        there = advantage[tables[..., ta.PRESENT] > 0.5]
        advantage = (advantage - there.mean()) / (there.std() + 1e-8)
        of_rows = (np.concatenate(chosen), np.concatenate(likely), advantage, returns)
        old = np.stack([each.reshape(shape).astype(np.float32) for each in of_rows])
        return torch.from_numpy(tables), torch.from_numpy(proposed), torch.from_numpy(old)

    def _rate(self, rewards: Numbers) -> None:
        """Rate the policy by the rewards (periods, num_envs x rows) of a rollout."""
        seconds = len(rewards) * self._surfaces.num_envs * self._config.control_period
        score = float(rewards.sum()) / seconds
        before = self._score if math.isfinite(self._score) else score
        self._score = SMOOTH * before + (1.0 - SMOOTH) * score

    def _step(
        self, tables: torch.Tensor, proposed: torch.Tensor, old: torch.Tensor, critic_only: bool
    ) -> float:
        """Take a gradient step; return by how much [nat] the policy has moved."""
        found = self._learning(tables, proposed)
        choice, old_log_prob, advantage, returns = old.flatten(1)[:, found.row]
        log_probability = found.logits.log_softmax(dim=1)
        log_prob = log_probability.gather(1, choice.long()[:, None])[:, 0]
        entropy = -(log_probability.exp() * log_probability).sum(dim=1).mean()
        loss = ppo.ppo_loss(
            log_prob, old_log_prob, advantage, found.value, returns, entropy,
            self._config.ent_coef, VALUE_COEF,
        )  # fmt: skip
        self._optimiser.zero_grad()
        torch.autograd.backward(loss)
        if critic_only:
            for name, parameter in self._learning.named_parameters():
                if not name.startswith("critic"):
                    parameter.grad = None
        torch.nn.utils.clip_grad_norm_(self._learning.parameters(), ppo.MAX_GRAD_NORM)
        self._optimiser.step()
        ratio = (log_prob - old_log_prob).detach()
        return float((ratio.exp() - 1.0 - ratio).mean())


def train_parcels(
    config: ParcelsConfig, folder: Path, on_progress: OnProgress = lambda *_: None
) -> TrainResult:
    """Train one policy for all parcels; see `train_learner`."""
    curve = partial(Curve, folder, (*PARCEL_TERMS, "waiting", "jam"))
    return ppo.train_learner(config, folder, on_progress, partial(ParcelLearner, config), curve)
