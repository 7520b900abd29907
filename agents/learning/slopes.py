"""Shared-policy PPO on slopes, per parcel and per module with local observations.

A parcel gets its own rewards, and a share of the other parcels' rewards.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch

from surface_gym.config import EnvConfig
from surface_gym.flow.base import HALVES
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.module_view import ModuleView
from surface_gym.flow.state import CORRECT, JAM, WRONG
from surface_gym.parcel import assortment
from surface_gym.state import OUT_OF_TIME

from ..base import Booleans, Integers, Numbers, Singles, find_rest
from ..library import find_algorithm, find_task
from ..slope_policy import (
    CENTRE,
    HOLD,
    LocalInputs,
    LocalNetwork,
    ParcelNetwork,
    Proposer,
    fill,
    make_network,
    see_modules,
    to_halves,
)
from ..tensors import GROUPS, draw_choices, draw_groups
from .algorithms import LocalConfig, ParcelsConfig
from .learner import PlainAdam
from .shared import (
    Config,
    Decision,
    Evaluation,
    Network,
    SharedLearner,
    SlotOutcome,
    gather,
    mean_entropy,
    shuffle,
)

DURATION = 60.0  # [s] of an episode
SHAPES = 64  # number of lab parcels per group of environments
JAMMED = -1.0  # reward of each parcel in a jam
STALLED = 15.0  # [s] without departures that count as a jam
SHARED = 0.2  # [-] share of all other parcels' rewards that a parcel gets too
# Rounds of imitation (DAgger): control periods, share of environments in which the network acts
# while the rule labels, and passes over all collected samples.
ROUNDS = ((600, 0.0, 6), *(((500, 0.9, 4),) * 5), (500, 0.9, 12))
LEARNED = 0.25  # [-] share of a rollout's modules that PPO uses: modules of a parcel are alike
KEPT = 0.15  # [-] share of modules kept for imitation, every other control period
BATCH = 6000  # modules of a step of imitation
RATE = 2e-3  # learning rate of imitation; it falls to 0 in the last round


def training_configs(config: ParcelsConfig | LocalConfig) -> list[EnvConfig]:
    """Return three configurations per training task: two in the lab, one with exact sensors."""
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
    """Result of a control period. Arrays (num_envs, rows) have one value per row of a table."""

    reward: Numbers
    departed: Booleans  # whether the row's parcel has departed
    # (num_envs,) detected by the environment, or by a long time without departures
    jammed: Booleans
    out_of_time: Booleans  # (num_envs,)
    last: Singles  # (truncated environments, rows, features) final tables


class Surfaces:
    """Environments of several configurations. After an episode, a new episode begins at once."""

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
        """Restart all episodes, with seeds drawn from a generator."""
        self._rng = rng
        self._sums[:] = self._quiet[:] = 0.0
        self._memories: list[Any] = [None] * len(self.batches)
        for batch in self.batches:
            self._reset(batch, np.arange(batch.num_envs))
        self._fresh = [np.ones(batch.num_envs, dtype=np.bool_) for batch in self.batches]

    def see(self) -> SlopeObservations:
        """Observe all environments. Call once per period: a call updates the rules' memory."""
        proposed = []
        for k, (rule, batch) in enumerate(zip(self._rules, self.batches, strict=True)):
            choice, self._memories[k] = rule.propose(
                batch.observation, self._memories[k], self._fresh[k]
            )
            proposed.append(choice)
        tables = np.concatenate([batch.observation for batch in self.batches])
        return SlopeObservations(tables, np.concatenate(proposed))

    def step(self, halves: Integers) -> SlopeStep:
        """Step all environments by choices `halves`, (num_envs, rows, 2) or (num_envs, modules)."""
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
    """Training of agents in streams; each row of each environment's table is an agent slot."""

    critic_first = 10

    def __init__(self, config: Config, surfaces: Surfaces, network: Network) -> None:
        super().__init__(config, network)
        self._surfaces = surfaces
        self.infos = surfaces.infos

    @property
    def _slots(self) -> int:
        return self._surfaces.num_envs * self._surfaces.rows

    def _outcome(self, period: SlopeStep, last: Numbers) -> SlotOutcome:
        """Return the outcome of a control period for all slots.

        Args:
            period: result of the control period for all rows.
            last: (truncated environments, rows) expected returns at the end of truncated episodes.
        """
        after = np.zeros(period.departed.shape)
        after[period.out_of_time] = last
        over = (period.jammed | period.out_of_time)[:, np.newaxis]
        return SlotOutcome(
            period.reward.ravel(),
            (period.departed | over).ravel(),
            np.where(period.departed, 0.0, after).ravel(),
        )


class ParcelLearner(StreamLearner[ParcelNetwork, ParcelsConfig]):
    """Training of a `ParcelNetwork`, which has the actor and the critic of all parcels.

    A training sample is the whole table of an environment, with a row for each parcel.
    """

    most_kl = 0.03

    def __init__(self, config: ParcelsConfig) -> None:
        configs = training_configs(config)
        surfaces = Surfaces(configs, config.num_envs)
        torch.manual_seed(config.seed)
        super().__init__(config, surfaces, make_network(configs[0], config.hidden))

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._surfaces.begin(self._rng)
        self._seen = self._surfaces.see()

    def _decide(self) -> Decision:
        tables, proposed = map(torch.from_numpy, self._seen)
        found = self._learning(tables, proposed)
        log_probability = found.logits.log_softmax(dim=1)
        uniform = torch.from_numpy(self._rng.random((len(found.row), 1), dtype=np.float32))
        chosen = (uniform > log_probability.exp().cumsum(dim=1)[:, :-1]).sum(dim=1)
        choice = torch.zeros(proposed.numel(), dtype=torch.int64)
        likely, value = torch.zeros(proposed.numel()), torch.zeros(proposed.numel())
        choice[found.row] = chosen
        likely[found.row] = gather(log_probability, chosen)
        value[found.row] = found.value
        choice = choice.reshape(proposed.shape)
        return Decision(
            to_halves(choice.numpy(), self._surfaces.orientations),
            value.numpy(),
            (tables, proposed, choice),
            np.arange(proposed.numel()).reshape(proposed.shape),
            self._learning.find_present(tables),
            likely.reshape(proposed.shape),
        )

    def _move(self, actions: Integers) -> SlotOutcome:
        period = self._surfaces.step(actions)
        timed = period.out_of_time
        last = self._compute_values(SlopeObservations(period.last, self._seen.proposed[timed]))
        self._seen = self._surfaces.see()
        return self._outcome(period, last.reshape(-1, self._surfaces.rows))

    def _value(self) -> Numbers:
        return self._compute_values(self._seen)

    def _compute_values(self, seen: SlopeObservations) -> Numbers:
        """Return the expected returns (num_envs x rows,) of parcels. An empty row's value is 0."""
        value = np.zeros(seen.proposed.size)
        if value.size:
            found = self._learning(*map(torch.from_numpy, seen))
            value[found.row.numpy()] = found.value.numpy()
        return value

    def _evaluate(self, samples: list[torch.Tensor]) -> Evaluation:
        tables, proposed, choice = samples
        found = self._learning(tables, proposed)
        log_probability = found.logits.log_softmax(dim=1)
        log_prob = gather(log_probability, choice.flatten()[found.row])
        return Evaluation(log_prob, found.value, mean_entropy(log_probability))


class LocalLearner(StreamLearner[LocalNetwork, LocalConfig]):
    """Training of one network that gives the modules' policy and the parcels' values.

    A module has local observations and messages of its neighbours. Training begins with imitation
    of the task's rule. A module gets the reward of the parcel above it. Only a random
    part of the modules gives samples. The modules under a parcel share one random number, so
    similar modules make the same choice, and PPO can credit this joint action.
    """

    most_kl = 0.01

    def __init__(self, config: LocalConfig) -> None:
        configs = training_configs(config)
        surfaces = Surfaces(configs, config.num_envs)
        self._view = ModuleView(configs[0])
        self._rest = find_rest(configs[0])
        torch.manual_seed(config.seed)
        super().__init__(config, surfaces, LocalNetwork(surfaces.orientations, config.hidden))

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._number = self._rng.random(self._slots, dtype=np.float32)
        if self.steps == 0:
            self._imitate()
        self._surfaces.begin(self._rng)
        self._seen = self._see()

    def _see(self) -> LocalInputs:
        return see_modules(self._view, self._surfaces.see().tables)

    def _imitate(self) -> None:
        """Imitate the rule (DAgger): at first the rule acts, later mostly the network acts."""
        optimiser = PlainAdam(self._learning.actor.parameters(), RATE)
        shown: list[tuple[torch.Tensor, ...]] = []
        for number, (periods, own, passes) in enumerate(ROUNDS, start=1):
            shown += self._watch_rule(periods, own)
            passed, of_modules, asked = map(torch.cat, zip(*shown, strict=True))
            for done in range(passes):
                if number == len(ROUNDS):
                    optimiser.param_groups[0]["lr"] = RATE * (1.0 - done / passes)
                for chosen in shuffle(self._rng, len(asked), BATCH):
                    found = self._learning(passed[chosen], of_modules[chosen])
                    loss = torch.nn.functional.nll_loss(found, asked[chosen])
                    optimiser.zero_grad()
                    torch.autograd.backward(loss)
                    optimiser.step()
        self._surfaces.infos.clear()

    def _watch_rule(self, periods: int, own: float) -> list[tuple[torch.Tensor, ...]]:
        """Collect observations of some modules, labelled with the rule's choices.

        Args:
            periods: number of control periods. Every second period gives observations.
            own: [-] share of environments in which the network acts. The rule acts in the others.
        """
        surfaces, rng = self._surfaces, self._rng
        surfaces.begin(rng)
        found: list[tuple[torch.Tensor, ...]] = []
        acts = rng.random(surfaces.num_envs) < own
        for period in range(periods):
            tables, proposed = surfaces.see()
            seen = see_modules(self._view, tables)
            halves = to_halves(proposed, surfaces.orientations).reshape(-1, HALVES)
            behind = (seen.own[:, CENTRE] < 0.0).numpy().astype(np.int64)
            choice = halves[seen.row[seen.parcel.numpy()], behind]
            if period % 2 == 0:
                kept = torch.from_numpy(np.flatnonzero(rng.random(len(choice)) < KEPT))
                asked = torch.from_numpy(choice)[kept]
                found.append((seen.passed[seen.parcel[kept]], seen.own[kept], asked))
            if own > 0.0:
                drawn = self._draw(seen, split=False)[0].numpy()
                choice = np.where(acts[seen.env], drawn, choice)
            surfaces.step(fill(seen, choice, surfaces.num_envs, self._view.modules, self._rest))
        return found

    @torch.no_grad()
    def _draw(self, seen: LocalInputs, split: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw choices (modules,) for observations; return choices and log probabilities.

        If `split` is true, a parcel's modules may form two groups; see `draw_groups`.
        """
        rng, parcels = self._rng, len(seen.row)
        new = rng.random(self._slots) < 1.0 / HOLD
        self._number[new] = rng.random(int(new.sum()), dtype=np.float32)
        number = rng.random(GROUPS * parcels, dtype=np.float32)
        number[::GROUPS] = self._number[seen.row]
        probability = self._config.split_probability if split else 0.0
        where = seen.own[:, CENTRE : CENTRE + 2].numpy()
        group = draw_groups(seen.parcel.numpy(), where, parcels, probability, rng)
        log_probability = self._learning(seen.passed[seen.parcel], seen.own)
        choice = draw_choices(log_probability, torch.from_numpy(group), torch.from_numpy(number))
        return choice, gather(log_probability, choice)

    def _decide(self) -> Decision:
        seen = self._seen
        value = self._compute_values(seen, self._slots)
        choice, likely = self._draw(seen)
        drawn = self._rng.random(len(choice)) < LEARNED
        some = torch.from_numpy(np.flatnonzero(drawn))
        parcel = seen.parcel[some]
        return Decision(
            fill(seen, choice.numpy(), self._surfaces.num_envs, self._view.modules, self._rest),
            value,
            (seen.passed[parcel], seen.own[some], choice[some]),
            seen.row[parcel.numpy()],
            torch.ones(len(some), dtype=torch.bool),
            likely[some],
        )

    def _move(self, actions: Integers) -> SlotOutcome:
        period = self._surfaces.step(actions)
        self._seen = self._see()
        count = len(period.last)
        last = np.zeros((count, self._surfaces.rows))
        if count:
            seen = see_modules(self._view, period.last)
            last = self._compute_values(seen, last.size).reshape(last.shape)
        return self._outcome(period, last)

    def _value(self) -> Numbers:
        return self._compute_values(self._seen, self._slots)

    @torch.no_grad()
    def _compute_values(self, seen: LocalInputs, rows: int) -> Numbers:
        """Return the expected return of each parcel, an array (rows,) with 0 in empty rows."""
        value = np.zeros(rows)
        value[seen.row] = self._learning.value(seen.passed).numpy()
        return value

    def _evaluate(self, samples: list[torch.Tensor]) -> Evaluation:
        passed, own, choice = samples
        log_probability = self._learning(passed, own)
        value = self._learning.value(passed)
        return Evaluation(gather(log_probability, choice), value, mean_entropy(log_probability))
