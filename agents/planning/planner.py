"""The planner: beam search through the simulator, a near-optimal baseline."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.state import RUNNING
from surface_gym.tasks.planning import PlanCost

from ..base import BatchController, Booleans, Integers, Singles, is_fresh
from .models import FIRST, NominalModel, SearchModel, SearchNodes

BUDGET = 64
AGREES = 0.05  # maximum difference between planned and actual observation
# [m, m, rad, m/s, m/s, rad/s] nodes that differ by less are duplicates.
ALIKE = np.array([0.004, 0.004, 0.02, 0.01, 0.01, 0.1])


@dataclass(frozen=True, eq=False)
class Plan:
    """Actions, and the expected observation before each."""

    actions: Integers  # (periods,)
    seen: Singles  # (periods, features)


class Planner(BatchController):
    """A controller that searches for the best actions "halves", and follows them.

    It trusts the observation: it puts the observed parcel into copies of the simulator at nominal
    friction. It plans again if the observation differs from the plan. On a path, where only the
    next 0.35 m are visible, it also plans again in every other period. The state holds the plan of
    each environment.

    `Task.cost` defines the objective, and `Task.decode_start` decodes an observation.

    Args:
        config: configuration of the environment, with actions "halves". A parcel is assumed to be
            the task's parcel of the closest size.
        budget: width of the beam; each node tries every action. Computing time is proportional to
            it.
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
        """Choose actions; the state holds each environment's plan and its used actions."""
        fresh = is_fresh(len(batch), state, episode_start)
        followed = zip(batch, fresh, state or [None] * len(batch), strict=True)
        following = [self._follow(seen, None if new else last) for seen, new, last in followed]
        return np.array([plan.actions[given - 1] for plan, given in following]), following

    def _follow(self, seen: Singles, last: tuple[Plan, int] | None) -> tuple[Plan, int]:
        """Choose the plan to follow, and count its next action as used."""
        if last is not None:
            plan, given = last
            if given < min(len(plan.actions), self._cost.follow) and (
                np.abs(plan.seen[given] - seen).max() <= AGREES
            ):
                return plan, given + 1
        self._model.begin_at(self._config.decode_start(seen))
        return make_plan(self._model, self._cost, self._width), 1


class _Period(NamedTuple):
    """One period of a search; its nodes' parents are the nodes of the period before."""

    parents: Integers  # (nodes,)
    actions: Integers  # (nodes,)
    seen: Singles  # (nodes, features) observations at its end


class _End(NamedTuple):
    """Possible end of a plan."""

    cost: float
    period: int
    node: int


class _Timings(NamedTuple):
    """Nodes kept regardless of their cost, each with its only next action."""

    nodes: Integers  # (timings,)
    actions: Integers  # (timings,)


def nodes_needed(cost: PlanCost, width: int, choices: int) -> int:
    """Return the maximum number of nodes in `make_plan`."""
    return width * choices + cost.horizon + 1


def make_plan(model: SearchModel, cost: PlanCost, width: int) -> Plan:
    """Search for the best plan from the model's current state."""
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
    """Add a timing: the node that has not changed its action yet changes it now."""
    waiting = timings.nodes[timings.actions == before]
    return _Timings(
        np.concatenate([timings.nodes, waiting]),
        np.concatenate([timings.actions, np.full(len(waiting), after)]),
    )


def keep_best(cost: PlanCost, moved: SearchNodes, runs: Booleans, width: int) -> Integers:
    """Choose the best running nodes, without duplicates of better ones."""
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
    return Plan(np.array(actions[::-1]), np.array([first_seen, *seen[:0:-1]]))
