"""Planners that search through copies of the simulator.

`Planner` is a beam search for one parcel, a near-optimal baseline. `Oracle` is a beam search with
the true state and parameters, an upper bound for other controllers. `RecedingHorizon` plans
streams: it varies a rule's actions in the true model.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.base import HALVES
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, JAM, WRONG
from surface_gym.physics.types import X
from surface_gym.sensors import Exact
from surface_gym.state import OUT_OF_TIME, RUNNING
from surface_gym.tasks.planning import PlanCost

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
from ..rollout import Episodes, stack_poses
from .models import FIRST, NominalModel, SearchModel, SearchNodes, TrueModel

BUDGET = 64
AGREES = 0.05  # maximum difference between planned and actual observation
# [m, m, rad, m/s, m/s, rad/s] nodes that differ by less are duplicates.
ALIKE = np.array([0.004, 0.004, 0.02, 0.01, 0.01, 0.1])


@dataclass(frozen=True, eq=False)
class Plan:
    """Actions, and the expected observation before each action."""

    actions: Integers  # (periods,)
    seen: Singles  # (periods, features)
    cost: float  # cost of its last node


class Planner(BatchController):
    """A controller that searches for the best actions "halves", and follows them.

    The planner trusts the observation, and puts the observed parcel into copies of the simulator at
    nominal friction. The planner plans again if the observation differs from the expected
    observation. On a path, only the next 0.35 m are visible. So in a task with a path, the planner
    also plans again in every other period.

    `Task.cost` defines the objective, and `Task.decode_start` decodes an observation.

    Args:
        config: configuration of the environment, with actions "halves". The planner assumes the
            task's parcel that is closest in size to the observed parcel.
        budget: width of the beam; each node tries every action. Computing time is proportional to
            the width.
    """

    def __init__(self, config: EnvConfig, budget: int = BUDGET) -> None:
        checks.one_of("actions", config.actions, ("halves",))
        self._config = config
        self._shape = (len(config.features),)
        self._cost = cost = config.task.cost()
        self._width = max(1, checks.integer("budget", budget, least=1) // cost.share)
        zone = config.zone if cost.zone is None else cost.zone
        size = nodes_needed(cost, self._width, config.action_kind.choices**2)
        self._model = NominalModel(replace(config, zone=zone), size)

    def _predict(
        self, batch: Singles, state: Any, episode_start: Any, **_: bool
    ) -> tuple[Any, list[tuple[Plan, int]]]:
        """Choose actions. The state has a pair (plan, number of actions done) per environment."""
        fresh = is_fresh(len(batch), state, episode_start)
        followed = zip(batch, fresh, state or [None] * len(batch), strict=True)
        following = [self._follow(seen, None if new else last) for seen, new, last in followed]
        return np.array([plan.actions[given - 1] for plan, given in following]), following

    def _follow(self, seen: Singles, last: tuple[Plan, int] | None) -> tuple[Plan, int]:
        """Return a plan and a number k. The next action is the plan's action k - 1.

        The argument `last` is the previous result of this method, or None.
        """
        if last is not None:
            plan, given = last
            if given < min(len(plan.actions), self._cost.follow) and (
                np.abs(plan.seen[given] - seen).max() <= AGREES
            ):
                return plan, given + 1
        self._model.begin_at(self._config.decode_start(seen))
        return make_plan(self._model, self._cost, self._width), 1


class _Period(NamedTuple):
    """One period of a search. The nodes' parents are indices of the previous period's nodes."""

    parents: Integers  # (nodes,)
    actions: Integers  # (nodes,)
    seen: Singles  # (nodes, features) observations at its end


class _End(NamedTuple):
    """Possible end of a plan."""

    cost: float
    period: int
    node: int


class _Timings(NamedTuple):
    """Nodes that a search always keeps. The nodes differ in the period in which all axes turn."""

    nodes: Integers  # (timings,)
    actions: Integers  # (timings,) their only next action


def nodes_needed(cost: PlanCost, width: int, choices: int) -> int:
    """Return the maximum number of nodes that `make_plan` simulates in one period.

    The search tries `choices` actions from each of `width` nodes.
    """
    return width * choices + cost.horizon + 1


def make_plan(model: SearchModel, cost: PlanCost, width: int) -> Plan:
    """Search for the best plan from the model's current state, with a beam of `width` nodes."""
    first_seen = model.parcels.observation[0].copy()
    angles = cost.event(model.parcels)
    event = [] if angles is None else [model.uniform_action(angle) for angle in angles]
    kept = FIRST.copy()
    timings = _Timings(kept[: len(event)], np.array(event[:1], dtype=np.int64))
    periods: list[_Period] = []
    best = _End(np.inf, 0, 0)
    while len(kept) and len(periods) < cost.horizon and best.cost > cost.enough:
        if event:
            timings = _change(timings, *event)
        parents = np.concatenate([np.repeat(kept, model.choices), timings.nodes])
        every = np.tile(np.arange(model.choices), len(kept))
        actions = np.concatenate([every, timings.actions])
        moved = model.advance(parents, actions)
        runs = moved.parcels.outcome == RUNNING
        over = ~runs if len(periods) < cost.horizon - 1 else np.ones_like(runs)
        if over.any():
            final = np.where(over, cost.final(moved), np.inf)
            best = min(best, _End(float(final.min()), len(periods), int(final.argmin())))
        periods.append(_Period(parents, actions, moved.parcels.observation.copy()))
        timings = _Timings(
            np.nonzero(runs[len(every) :])[0] + len(every), timings.actions[runs[len(every) :]]
        )
        kept = keep_best(cost, moved, runs, width)
    return _trace(periods, best, first_seen)


def _change(timings: _Timings, before: int, after: int) -> _Timings:
    """Add a copy of each node whose next action is `before`. The copy's next action is `after`."""
    waiting = timings.nodes[timings.actions == before]
    return _Timings(
        np.concatenate([timings.nodes, waiting]),
        np.concatenate([timings.actions, np.full(len(waiting), after)]),
    )


def keep_best(cost: PlanCost, moved: SearchNodes, runs: Booleans, width: int) -> Integers:
    """Return the indices of the best running nodes, at most `width`, without duplicates.

    `runs` (nodes,) marks the nodes in `moved` whose episodes still run.
    """
    order = np.argsort(np.where(runs, cost.running(moved), np.inf), kind="stable")
    order = order[: np.count_nonzero(runs)]
    like = moved.parcels.state[order, : len(ALIKE)] / ALIKE
    if moved.turning is not None:
        # Similar nodes with different axes are no duplicates.
        changes = moved.turning.velocity_changes(moved.braking)
        like = np.hstack([like, changes[order] / ALIKE[3:]])
    kinds = np.rint(like).astype(np.int64)
    _, best_of_kind = np.unique(kinds, axis=0, return_index=True)
    return order[np.sort(best_of_kind)[:width]]


def _trace(periods: list[_Period], end: _End, first_seen: Singles) -> Plan:
    node, actions, seen = end.node, [], []
    for period in reversed(periods[: end.period + 1]):
        actions.append(int(period.actions[node]))
        seen.append(period.seen[node])
        node = int(period.parents[node])
    return Plan(np.array(actions[::-1]), np.array([first_seen, *seen[:0:-1]]), end.cost)


ORACLE_BUDGET = 256  # maximum width of the beam
LEAST = 8  # initial width of the beam, enough for most starts
MORE = 4  # factor of the width after a search without success


@dataclass(frozen=True, eq=False)
class OracleResult:
    """Episode from one start, with the best plan that was found."""

    outcome: str  # outcome of the episode
    time: float  # [s] duration of the episode
    metrics: tuple[float, ...]  # metrics of the task
    poses: Numbers  # (periods + 1, 3) [m, m, rad] true poses
    velocity: Numbers  # (3,) [m/s, m/s, rad/s] at the end
    actions: tuple[int, ...]  # (periods,) actions taken
    width: int  # width of the beam
    seconds: float  # computing time

    @property
    def success(self) -> bool:
        return self.outcome == "success"


class Oracle:
    """Planner of actions "halves" with the true parcel, load, friction, stuck modules and axes.

    The planner simulates the whole episode with these true values, without sensors. A search
    without success is repeated with a wider beam, up to the width `budget`. Each node tries every
    action.
    """

    def __init__(self, config: EnvConfig, budget: int = ORACLE_BUDGET) -> None:
        checks.one_of("actions", config.actions, ("halves",))
        if config.action_kind.continuous:
            raise ValueError(
                f"orientations must be some to choose from, got {config.orientations!r}"
            )
        self._config = config
        # The future is known, so a path is first searched to its end at once. Light parcels leave a
        # path too easily for that. Then it is searched piece by piece.
        task = config.task
        cost = task.cost()
        whole = replace(cost, horizon=task.periods, follow=task.periods)
        self._costs = (whole, cost) if task.has_path else (whole,)
        checks.integer("budget", budget, least=1)
        self._widths = [min(LEAST, budget)]  # of successive searches
        while self._widths[-1] < budget:
            self._widths.append(min(MORE * self._widths[-1], budget))
        self._models: dict[int, TrueModel] = {}

    def find(self, options: dict[str, Any], seed: int) -> OracleResult:
        began = time.perf_counter()
        for cost, width in product(self._costs, self._widths):
            found = self._play(cost, width, options, seed)
            if found.success:
                break
        return replace(found, seconds=time.perf_counter() - began)

    def _play(self, cost: PlanCost, width: int, options: dict[str, Any], seed: int) -> OracleResult:
        """Run the episode after a reset with `options` and `seed`; plan with a beam of `width`."""
        size = nodes_needed(cost, width, self._config.action_kind.choices**2)
        if size not in self._models:
            self._models[size] = TrueModel(self._config, size)
        model = self._models[size]
        model.begin(options, seed)
        poses, actions = [model.parcels.truth[0, :3].copy()], list[int]()
        running, left = True, self._config.task.periods
        while running and len(actions) < left:
            plan = make_plan(model, cost, width)
            for action in plan.actions[: cost.follow].tolist():
                parcels = model.step(action).parcels
                poses.append(parcels.truth[0, :3].copy())
                actions.append(action)
                running = bool(parcels.outcome[0] == RUNNING)
                if not running or len(actions) == left:
                    break
        parcels = model.parcels
        return OracleResult(
            outcome=model.outcomes[OUT_OF_TIME if running else int(parcels.outcome[0])],
            time=float(parcels.clock[0]),
            metrics=tuple(parcels.metrics[0].tolist()),
            poses=np.array(poses),
            velocity=parcels.truth[0, 3:].copy(),
            actions=tuple(actions),
            width=width,
            seconds=0.0,
        )


def run_oracle(
    config: EnvConfig, starts: Sequence[dict[str, Any]], seed: int, budget: int = ORACLE_BUDGET
) -> Episodes:
    """Run an oracle from each start. Return `Episodes`, like `agents.rollout.run_episodes`.

    `starts` are options of `reset`; start `k` gets the seed `seed + k`. For `budget` see `Oracle`.
    """
    oracle = Oracle(config, budget)
    runs = [oracle.find(start, seed + k) for k, start in enumerate(starts)]
    metrics = np.array([run.metrics for run in runs]).T
    return Episodes(
        success=np.array([run.success for run in runs]),
        outcome=tuple(run.outcome for run in runs),
        time=np.array([run.time for run in runs]),
        metrics=dict(zip(config.task.metrics, metrics, strict=True)),
        pose=stack_poses([run.poses for run in runs]),
        velocity=np.array([run.velocity for run in runs]),
        decision_times=np.array([run.seconds / len(run.actions) for run in runs]),
    )


CANDIDATES = 12  # candidates per surface, including the rule alone
HORIZON = 50  # control periods that are simulated
FOLLOWED = 10  # control periods until the next plan
DURATION = (2, 30)  # smallest and largest duration of a variation in control periods
WRONG_COST, JAM_COST = 2.0, 10.0  # in units of correctly delivered parcels
PROGRESS = 0.5  # the same unit, of a parcel at the end of the surface; proportional before it


class Variations(NamedTuple):
    """Parcels for which a plan takes another action than the rule, in arrays (num_envs, rows)."""

    choice: Integers  # index of the parcel's action
    left: Integers  # remaining control periods of this action; 0: it obeys the rule


class HorizonState(NamedTuple):
    """Memory of `RecedingHorizon`."""

    memory: Any  # memory of the rule
    variations: Variations
    given: int  # number of control periods so far


class RecedingHorizon(BatchController):
    """Plan with the true model over a receding horizon; the plans are variations of a rule.

    The model has the true state, friction, stuck modules, axes and future parcels. A variation
    gives another action to some parcels for some periods. The planner simulates candidates up to
    the horizon: the rule alone, and the rule with different variations. Then the planner follows
    the best candidate. The criterion counts parcels that departed correctly and wrongly, the
    progress of all other parcels, and jams.

    Args:
        rule: the varied rule; its memory must consist of arrays (num_envs, ...) in tuples.
        config: configuration of the environments, with exact sensors.
        candidates: number of candidates per surface.
        horizon: [control periods] simulated time of a candidate. The computing time is proportional
            to `candidates` and to `horizon`.
        followed: [control periods] time between two plans.
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
        """Let the planner control `batch`, which must have the planner's configuration."""
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
        """Draw variations of the rule for each surface; return the best variation per surface.

        `fresh` (num_envs,) marks episodes that have just begun.
        """
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

        Candidate 0 has no variations. Candidate 1 has the current variations. Every later candidate
        has a new variation for one random parcel. For all other parcels, half of the later
        candidates have no variations, and half have the current variations. `present` (num_envs,
        rows) marks rows that hold a parcel.
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
        """Return a rule's varied actions (num_envs, ...), and the variations of the next period."""
        choice, left = variations
        ruled = actions.reshape(*left.shape, HALVES)
        halves = np.where((left > 0)[..., np.newaxis], self._choices[choice], ruled)
        return halves.reshape(actions.shape), Variations(choice, np.maximum(0, left - 1))

    def _rate(self, before: Integers) -> Numbers:
        """Rate surfaces by jams, progress and deliveries. `before` is the tally before planning."""
        model, streams = self._model, self._model.streams
        done = streams.tally - before
        x = model.parcels.truth[:, X].reshape(streams.present.shape) - self._config.entry_x
        way = self._config.rotors_end - self._config.entry_x
        progress = np.where(streams.present, x / way, 0.0).sum(axis=1)
        jams = model.outcome == JAM
        rated: Numbers = done[:, CORRECT] - WRONG_COST * done[:, WRONG] - JAM_COST * jams
        return rated + PROGRESS * progress


def _repeat(memory: Any, times: int) -> Any:
    """Repeat a rule's memory (num_envs, ...) for `times` copies of all surfaces."""
    if isinstance(memory, tuple):
        repeated = [_repeat(each, times) for each in memory]
        return type(memory)(*repeated) if hasattr(memory, "_fields") else tuple(repeated)
    return None if memory is None else np.concatenate([memory] * times)
