"""`python -m benchmarks.residual`: does PPO improve the rule "patterns" on Singulate in the lab?

Shared-policy PPO corrects the motion that the rule wants for each parcel, and begins at the rule:
residual policy learning (Silver et al. 2018). A correction lasts `HOLD` control periods. Rule and
corrected rule are then compared on streams on which neither was trained or tuned.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import tyro

from surface_gym.agents.evaluation.method import all_methods
from surface_gym.agents.evaluation.scenario import WHOLE
from surface_gym.agents.evaluation.streams import StreamScenario, measure_stream
from surface_gym.agents.learning.algorithms import ParcelsConfig
from surface_gym.agents.learning.slopes import (
    ParcelLearner,
    SlopeObservations,
    SlopeStep,
    StreamLearner,
    Surfaces,
    training_configs,
)
from surface_gym.agents.rules import patterns as rules
from surface_gym.agents.rules.patterns import Patterns
from surface_gym.agents.scheduling.scheduler import begin_streams
from surface_gym.agents.slope_policy import ParcelNetwork
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.state import RUNNING

HOLD = 5  # control periods that a correction lasts
SPEED = np.array([0.0, -0.15, -0.5, 0.3])  # [m/s] added to the wanted speed along the slope
ASIDE = np.array([0.0, 0.4, -0.4, 0.0])  # [m/s] and across it; the last one stops turning, too
STREAMS_SEED = 424_242  # of no other comparison


@compiled
def choose_corrected(
    corrections, tables, slope, tuning, aim, grid, parcels, slots, below, nearest, order, came,
    stood, axes, commands,
):  # fmt: skip
    """Choose actions as `choose_patterns`, with corrections (num_envs, rows, 2)."""
    for i in range(tables.shape[0]):
        table = tables[i]
        rules.read_parcels(table, slope, tuning, parcels)
        for k in range(table.shape[0]):
            if abs(parcels.shift[k]) < rules.NEAR:
                parcels.shift[k] = 0.0
        count = rules.sort_parcels(table, tuning, parcels, order[i], came[i], stood[i])
        stuck = rules.find_stuck(parcels, order[i], count, stood[i])
        rules.forget_slots(slots)
        nearest[:], commands[i, :] = np.inf, rules.ROLL
        for place in range(count):
            k = order[i, place]
            goes = stuck and stood[i, k] > rules.LONG
            speed, lateral, turning = rules.want_motion(
                slope, tuning, aim, parcels, slots, order[i], count, place, goes
            )
            along, aside = corrections[i, k, 0], corrections[i, k, 1]
            speed = min(slope.take_away, max(0.0, speed + SPEED[along]))
            lateral += ASIDE[aside]
            turning *= aside != 3
            pattern = rules.choose_pattern(
                slope, aim, grid, parcels, table[k], k, axes[i], below, speed, lateral, turning
            )
            rules.claim_modules(aim, grid, parcels, table[k], k, pattern, nearest, commands[i])
        rules.expect_axes(grid, commands[i], axes[i])


class CorrectedPatterns(Patterns):
    """The rule with corrections (num_envs, rows, 2), which are set before `predict`."""

    kernel = staticmethod(choose_corrected)
    corrections: Any

    def arguments(self, tables: Any, memory: Any, commands: Any) -> tuple[Any, ...]:
        return (self.corrections, *super().arguments(tables, memory, commands))

    def correct(self, corrections: Any, tables: Any, periods: int) -> None:
        """Set the corrections of parcels that were there `periods` ago, when they were chosen."""
        new = ta.COLUMN.time.of(tables) < 0.04 * periods - 0.01
        self.corrections = np.where(new[..., np.newaxis], 0, corrections)


class CorrectedSurfaces(Surfaces):
    """Environments in which the rule acts, with corrections as actions."""

    def __init__(self, configs: list[EnvConfig], num_envs: int) -> None:
        super().__init__(configs, num_envs)
        self.orientations = len(SPEED)
        self._acting = [CorrectedPatterns(config) for config in configs]

    def see(self) -> SlopeObservations:
        tables = np.concatenate([batch.observation for batch in self.batches])
        return SlopeObservations(tables, np.zeros(tables.shape[:2], dtype=np.int64))

    def step(self, halves: Any) -> SlopeStep:
        """Step all by `HOLD` control periods with corrections (num_envs, rows, 2)."""
        shape = (self.num_envs, self.rows)
        reward, departed = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
        jammed, timed = np.zeros((2, self.num_envs), dtype=np.bool_)
        last: dict[int, Any] = {}
        for periods in range(HOLD):
            actions, first = [], 0
            for k, (rule, batch) in enumerate(zip(self._acting, self.batches, strict=True)):
                here = slice(first, first + batch.num_envs)
                first += batch.num_envs
                rule.correct(halves[here], batch.observation, periods)
                action, self._memories[k] = rule.predict(
                    batch.observation, self._memories[k], self._fresh[k]
                )
                actions.append(action)
            found = super().step(np.concatenate(actions))
            ended = jammed | timed
            counts = ~departed & ~ended[:, np.newaxis]
            reward += np.where(counts, found.reward, 0.0)
            departed |= counts & found.departed
            index = np.flatnonzero(found.out_of_time)
            last |= {i: table for i, table in zip(index.tolist(), found.last, strict=True)
                     if not ended[i]}  # fmt: skip
            jammed |= found.jammed & ~ended
            timed |= found.out_of_time & ~ended
        tables = [last[i] for i in np.flatnonzero(timed).tolist()]
        empty = np.zeros((0, *self.batches[0].observation.shape[1:]), dtype=np.float32)
        return SlopeStep(reward, departed, jammed, timed, np.stack(tables) if tables else empty)


class Learner(ParcelLearner):
    """Training of the corrections."""

    def __init__(self, config: ParcelsConfig) -> None:
        configs = [each.replace(actions="modules", max_parcels=32) for each in training_configs(config)]
        surfaces = CorrectedSurfaces([each for each in configs if not each.sensors.is_exact] if False else configs[:2], config.num_envs)
        torch.manual_seed(config.seed)
        StreamLearner.__init__(self, config, surfaces, ParcelNetwork(configs[0].features, len(SPEED), config.hidden))


def compare(network: Any, streams: int, seed: int, sample: bool) -> list[list[dict[str, Any]]]:
    """Return the rows of each stream of the rule, and of the corrected rule."""
    method = next(each for each in all_methods("singulate") if each.name == "patterns")
    scenario = StreamScenario("singulate", "lab", WHOLE, "mouth of 0.6 m, 10 deg")
    config = scenario.config(method, scenario.offer.rates[0])
    found = []
    for learns in (False, True):
        rule, rng = CorrectedPatterns(config), np.random.default_rng(seed)
        batch = begin_streams(config, streams, seed)
        corrections = np.zeros((streams, config.rows, 2), dtype=np.int64)
        fresh, state, period = np.ones(streams, dtype=np.bool_), None, 0
        while (batch.outcome == RUNNING).any():
            if learns and period % HOLD == 0:
                corrections[:] = 0
                table = torch.from_numpy(batch.observation.copy())
                with torch.no_grad():
                    seen = network(table, torch.zeros(table.shape[:2], dtype=torch.int64))
                if sample:
                    p = seen.logits.softmax(1).cumsum(1).numpy()
                    choice = (rng.random((len(p), 1)) > p[:, :-1]).sum(1)
                else:
                    choice = seen.logits.argmax(1).numpy()
                flat = corrections.reshape(-1, 2)
                flat[seen.row.numpy()] = np.stack(np.divmod(choice, len(SPEED)), axis=1)
            rule.correct(corrections, batch.observation, period % HOLD)
            action, state = rule.predict(batch.observation, state, fresh)
            batch.step(config.action_kind.commands(action, streams))
            fresh[:] = False
            period += 1
        found.append(measure_stream(batch))
    return found
