"""A planner with the true model for slopes, which varies a rule.

It copies every surface including future arrivals, simulates the rule and its variations for a few
seconds, and follows the best. A variation brakes some parcels, lets them roll, moves them aside or
turns them for a while, instead of the rule. Then the rule continues alone.
"""

from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.base import HALVES
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, JAM, WRONG
from surface_gym.physics.types import X
from surface_gym.sensors import Exact

from ..base import (
    BatchController,
    Booleans,
    Controller,
    Integers,
    Numbers,
    Singles,
    find_axes,
    is_fresh,
)

CANDIDATES = 12  # candidates per surface, including the rule alone
HORIZON = 50  # control periods that are simulated
FOLLOWED = 10  # control periods until the next plan
DURATION = (
    2,
    30,
)  # smallest and largest duration of a variation in control periods
WRONG_COST, JAM_COST = 2.0, 10.0  # in units of correctly delivered parcels
PROGRESS = 0.5  # the same unit, for a parcel at the end of the surface; proportional before


class Variations(NamedTuple):
    """Parcels that deviate from the rule, in arrays (num_envs, rows)."""

    choice: Integers  # index of the parcel's action
    left: Integers  # remaining control periods of this action; 0: it obeys the rule


class HorizonState(NamedTuple):
    """Memory of the planner."""

    memory: Any  # memory of the rule
    variations: Variations
    given: int  # number of control periods so far


class RecedingHorizon(BatchController):
    """Plan with the true model over a receding horizon, by variations of a rule.

    It needs no sensors: it knows the true state, friction, stuck modules, axes and future parcels.
    No real controller knows as much, so its result is an upper bound. It always tries the rule
    alone, and follows it unless a variation is better at the horizon. The criterion counts parcels
    that departed correctly and wrongly, the progress of the others, and jams. Half of the
    variations add one parcel to the current variation. Results are reproducible by seed.

    Args:
        rule: the varied rule; its memory must consist of arrays (num_envs, ...) in tuples.
        config: configuration of the environments, with exact sensors.
        candidates: number of candidates per surface; computing time is proportional to it.
        horizon: [control periods] simulated per candidate; computing time is proportional to it.
        followed: [control periods] until the next plan.
        seed: seed of the random variations.
    """

    def __init__(
        self, rule: Controller, config: EnvConfig, candidates: int = CANDIDATES,
        horizon: int = HORIZON, followed: int = FOLLOWED, seed: int = 0,
    ) -> None:  # fmt: skip
        checks.instance("sensors", config.sensors, Exact, "Exact(), as the true state is known")
        self._config, self._rule = config, rule
        self._shape = (config.rows, len(config.features))
        self._candidates = checks.integer("candidates", candidates, least=2)
        self._horizon = checks.integer("horizon", horizon, least=1)
        self._followed = checks.integer("followed", followed, least=1, most=self._horizon)
        self._seed = checks.integer("seed", seed, least=0)
        axes = find_axes(config)
        alone = ((each, each) for each in (axes.brake, axes.roll, axes.left, axes.right))
        self._choices = np.array([*alone, (axes.left, axes.right), (axes.right, axes.left)])
        self._batch: StreamBatch | None = None

    def watch(self, batch: StreamBatch) -> None:
        """Set the batch to control; it must have the same configuration."""
        self._batch = batch
        self._model = StreamBatch(self._config, self._candidates * batch.num_envs)

    def _predict(
        self, batch: Singles, state: HorizonState | None, episode_start: Any, **_: bool
    ) -> tuple[Integers, HorizonState]:
        num_envs, rows, _features = batch.shape
        fresh = is_fresh(num_envs, state, episode_start)
        if state is None:
            none = Variations(*np.zeros((2, num_envs, rows), dtype=np.int64))
            state = HorizonState(None, none, 0)
        memory, (choice, left), given = state
        variations = Variations(choice, np.where(fresh[:, np.newaxis], 0, left))
        if given % self._followed == 0:
            variations = self._plan(HorizonState(memory, variations, given), fresh)
        actions, memory = self._rule.predict(batch, memory, fresh)
        actions, variations = self._vary(actions, variations)
        return actions, HorizonState(memory, variations, given + 1)

    def _plan(self, state: HorizonState, fresh: Booleans) -> Variations:
        """Draw variations, and choose the best for each surface."""
        if self._batch is None or self._batch.num_envs != len(fresh):
            raise ValueError(f"watch a batch of the {len(fresh)} surfaces first")
        model, count, tries = self._model, len(fresh), self._candidates
        snapshot = self._batch.snapshot()
        for first in range(0, tries * count, count):
            model.restore(snapshot, np.arange(first, first + count))
        before = model.streams.tally.copy()
        drawn = left = self._draw(state, self._batch.streams.present)
        memory, fresh = _repeat(state.memory, tries), np.tile(fresh, tries)
        for _ in range(self._horizon):
            actions, memory = self._rule.predict(model.observation, memory, fresh)
            actions, left = self._vary(actions, left)
            model.step(self._config.action_kind.commands(actions, len(fresh)))
            fresh[:] = False
        # Among equals, the first wins: the rule alone.
        best = self._rate(before).reshape(tries, count).argmax(axis=0) * count + np.arange(count)
        return Variations(drawn.choice[best], drawn.left[best])

    def _draw(self, state: HorizonState, present: Booleans) -> Variations:
        """Draw the variations of every candidate.

        Candidate 0 has no variation, and candidate 1 has the current variation. Half of the others
        vary one parcel only; the other half vary one parcel in addition to the current variation.
        The parcel is drawn from the parcels present (num_envs, rows).
        """
        tries = self._candidates
        shape = (tries, *present.shape)
        choice = np.broadcast_to(state.variations.choice, shape).copy()
        left = np.broadcast_to(np.where(present, state.variations.left, 0), shape).copy()
        left[0] = 0
        left[2 : 2 + (tries - 2) // 2] = 0
        low, high = np.log(DURATION)
        for i, here in enumerate(present):
            rows = np.flatnonzero(here)
            if not len(rows):
                continue
            rng = np.random.default_rng((self._seed, i, state.given))
            drawn = np.arange(2, tries)
            row = rng.choice(rows, tries - 2)
            choice[drawn, i, row] = rng.integers(len(self._choices), size=tries - 2)
            left[drawn, i, row] = np.rint(np.exp(rng.uniform(low, high, tries - 2)))
        return Variations(choice.reshape(-1, shape[-1]), left.reshape(-1, shape[-1]))

    def _vary(self, actions: Integers, variations: Variations) -> tuple[Integers, Variations]:
        """Replace a rule's actions (num_envs, ...) by variations for a control period."""
        choice, left = variations
        ruled = actions.reshape(*left.shape, HALVES)
        halves = np.where((left > 0)[..., np.newaxis], self._choices[choice], ruled)
        return halves.reshape(actions.shape), Variations(choice, np.maximum(0, left - 1))

    def _rate(self, before: Integers) -> Numbers:
        """Rate the model's surfaces by their change since the tally `before`."""
        model, streams = self._model, self._model.streams
        done = streams.tally - before
        x = model.parcels.truth[:, X].reshape(streams.present.shape) - self._config.entry_x
        way = self._config.rotors_end - self._config.entry_x
        progress = np.where(streams.present, x / way, 0.0).sum(axis=1)
        jams = model.outcome == JAM
        rated: Numbers = done[:, CORRECT] - WRONG_COST * done[:, WRONG] - JAM_COST * jams
        return rated + PROGRESS * progress


def _repeat(memory: Any, times: int) -> Any:
    """Repeat a rule's memory for several copies of its surfaces."""
    if isinstance(memory, tuple):
        repeated = [_repeat(each, times) for each in memory]
        return type(memory)(*repeated) if hasattr(memory, "_fields") else tuple(repeated)
    return None if memory is None else np.concatenate([memory] * times)
