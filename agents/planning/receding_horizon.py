"""A planner with the true model for slopes: variations of a rule, tried ahead, the best followed.

It copies every surface as it is, with all that will come, and plays the rule and variations of it
for a few seconds. A variation brakes some parcels, lets them roll, leads them aside or turns them
for a while, whatever the rule says; then the rule goes on alone.
"""

from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, JAM, WRONG
from surface_gym.flow.task import HALVES
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

CANDIDATES = 12  # of each surface, the rule alone among them
HORIZON = 50  # control periods for which each is played
FOLLOWED = 10  # of these, for which the best is followed until the next plan
DURATION = (
    2,
    30,
)  # control periods, least and greatest, for which a parcel is made to do something
WRONG_COST, JAM_COST = 2.0, 10.0  # in parcels that leave rightly
PROGRESS = 0.5  # the same, of one that is at the end but has not left; in proportion before


class Variations(NamedTuple):
    """Parcels that do something else than a rule says, an array (num_envs, rows) each."""

    choice: Integers  # place in what a parcel may be made to do
    left: Integers  # control periods for which it will do so; 0: it obeys the rule


class Followed(NamedTuple):
    """What the planner remembers."""

    memory: Any  # of the rule
    variations: Variations
    given: int  # control periods so far


class RecedingHorizon(BatchController):
    """Plan with the true model over a receding horizon, by variations of a rule.

    It needs no sensors: it knows the true state, the friction, the stuck modules, the axes, and the
    parcels to come. So it tells what can be reached; no other controller can know as much. The rule
    alone is always tried, and followed unless a variation of it is better at the horizon: by the
    parcels that left rightly and wrongly, how far the others have come, and jams. Half of the
    variations change what is followed already in one parcel more. The same seed draws the same.

    Args:
        rule: that is varied; what it remembers are arrays (num_envs, ...), in tuples.
        config: of the environments, with exact sensors.
        candidates: that are tried on each surface; the time of a plan is in proportion.
        horizon: [control periods] for which each is played; so is this.
        followed: [control periods] until the next plan.
        seed: of the draws.
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
        """Take a batch of the same configuration as the surfaces that are to be controlled."""
        self._batch = batch
        self._model = StreamBatch(self._config, self._candidates * batch.num_envs)

    def _predict(
        self, batch: Singles, state: Followed | None, episode_start: Any, **_: bool
    ) -> tuple[Integers, Followed]:
        num_envs, rows, _features = batch.shape
        fresh = is_fresh(num_envs, state, episode_start)
        if state is None:
            none = Variations(*np.zeros((2, num_envs, rows), dtype=np.int64))
            state = Followed(None, none, 0)
        memory, (choice, left), given = state
        variations = Variations(choice, np.where(fresh[:, np.newaxis], 0, left))
        if given % self._followed == 0:
            variations = self._plan(Followed(memory, variations, given), fresh)
        actions, memory = self._rule.predict(batch, memory, fresh)
        actions, variations = self._vary(actions, variations)
        return actions, Followed(memory, variations, given + 1)

    def _plan(self, state: Followed, fresh: Booleans) -> Variations:
        """Choose the best variations for each surface, of those drawn."""
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
        # Of equals the first is best, which is the rule alone.
        best = self._rate(before).reshape(tries, count).argmax(axis=0) * count + np.arange(count)
        return Variations(drawn.choice[best], drawn.left[best])

    def _draw(self, state: Followed, present: Booleans) -> Variations:
        """Draw the variations of every candidate: none, those followed, and then one parcel's more
        than either, where a parcel is present (num_envs, rows).
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
        """Put variations in the place of a rule's actions (num_envs, ...), for a control period."""
        choice, left = variations
        ruled = actions.reshape(*left.shape, HALVES)
        halves = np.where((left > 0)[..., np.newaxis], self._choices[choice], ruled)
        return halves.reshape(actions.shape), Variations(choice, np.maximum(0, left - 1))

    def _rate(self, before: Integers) -> Numbers:
        """Rate what has become of the model's surfaces since they had a tally."""
        model, streams = self._model, self._model.streams
        done = streams.tally - before
        x = model.parcels.truth[:, X].reshape(streams.present.shape) - self._config.entry_x
        way = self._config.rotors_end - self._config.entry_x
        progress = np.where(streams.present, x / way, 0.0).sum(axis=1)
        jams = model.outcome == JAM
        rated: Numbers = done[:, CORRECT] - WRONG_COST * done[:, WRONG] - JAM_COST * jams
        return rated + PROGRESS * progress


def _repeat(memory: Any, times: int) -> Any:
    """Repeat a rule's memory for so many copies of its surfaces."""
    if isinstance(memory, tuple):
        repeated = [_repeat(each, times) for each in memory]
        return type(memory)(*repeated) if hasattr(memory, "_fields") else tuple(repeated)
    return None if memory is None else np.concatenate([memory] * times)
