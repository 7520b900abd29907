"""Training environments for agents of streams: parallel surfaces, and rewards of each parcel.

A parcel gets its own rewards, and a share of the other parcels' rewards.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, JAM, WRONG
from surface_gym.parcel import assortment
from surface_gym.state import OUT_OF_TIME

from ..base import Booleans, Integers, Numbers, Singles
from ..library import find_algorithm, find_task
from ..parcel_policy import Proposer
from .algorithms import LocalConfig, ParcelsConfig
from .shared import Config, Network, SharedLearner, SlotOutcome

DURATION = 60.0  # [s] of an episode
SHAPES = 64  # number of lab parcels per group of environments
JAMMED = -1.0  # reward of each parcel in a jam
STALLED = 15.0  # [s] without departures that count as a jam
SHARED = 0.2  # [-] share of all other parcels' rewards that a parcel gets too


def training_configs(config: ParcelsConfig | LocalConfig) -> list[EnvConfig]:
    """Return the training environments: each task with exact sensors and in the lab."""
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
    departed: Booleans  # whether the row's parcel has departed
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
        departed = there & ~(streams.present & (streams.number == number))
        timed = streams.outcome == OUT_OF_TIME
        quiet += batch.config.control_period
        quiet[departed.any(axis=1) | ~streams.present.any(axis=1)] = 0.0
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
        return SlopeStep(reward, departed, jammed, timed, last)

    def _reset(self, batch: StreamBatch, chosen: Integers) -> None:
        for i in chosen.tolist():
            batch.seed(i, np.random.default_rng(self._rng.integers(2**63)))
        if len(chosen):
            batch.reset(chosen)


def _join(parts: list[SlopeStep]) -> SlopeStep:
    return SlopeStep(*map(np.concatenate, zip(*parts, strict=True)))


class StreamLearner(SharedLearner[Network, Config]):
    """Training of stream agents; every row of every environment's table is a slot."""

    critic_first = 10

    def __init__(self, config: Config, surfaces: Surfaces, network: Network) -> None:
        super().__init__(config, network)
        self._surfaces = surfaces
        self.infos = surfaces.infos

    @property
    def _slots(self) -> int:
        return self._surfaces.num_envs * self._surfaces.rows

    def _outcome(self, period: SlopeStep, last: Numbers) -> SlotOutcome:
        """Return the outcome of a control period.

        Args:
            period: result on the surfaces.
            last: (out of time, rows) expected returns at the end of truncated episodes.
        """
        after = np.zeros(period.departed.shape)
        after[period.out_of_time] = last
        over = (period.jammed | period.out_of_time)[:, np.newaxis]
        return SlotOutcome(
            period.reward.ravel(),
            (period.departed | over).ravel(),
            np.where(period.departed, 0.0, after).ravel(),
        )
