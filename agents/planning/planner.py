"""The planner: beam search through the simulator, the near-optimum to hold others against."""

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
AGREES = 0.05  # largest difference, in the observation's units, between what was planned and is
# [m, m, rad, m/s, m/s, rad/s] within which nodes are so much alike that the best will do.
ALIKE = np.array([0.004, 0.004, 0.02, 0.01, 0.01, 0.1])


@dataclass(frozen=True, eq=False)
class Plan:
    """Actions, and what will be seen before each if the model is right."""

    actions: Integers  # (periods,)
    seen: Singles  # (periods, features)


class Planner(BatchController):
    """A controller that searches for the best actions of a front and a rear half, and follows them.

    It sees what the sensors say, as agents do, and takes it for true: it puts the parcel it sees
    into copies of the simulator, at nominal friction, and moves them. A plan is made anew where
    what is seen is not what was planned; on a path, of which only the next 0.35 m are seen, every
    other period too. The state holds the plan that each environment follows.

    The task says what is minimised (`Task.cost`) and what an observation shows
    (`Task.decode_start`).

    Args:
        config: of the environment it acts in, with "halves" for actions; a parcel is taken for
            the one, of those its task draws, that is nearest in size.
        budget: nodes followed at a time, each with every action; the time of a search is in
            proportion.
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
        """Choose; the state holds each environment's plan and how many actions of it were given."""
        fresh = is_fresh(len(batch), state, episode_start)
        followed = zip(batch, fresh, state or [None] * len(batch), strict=True)
        following = [self._follow(seen, None if new else last) for seen, new, last in followed]
        return np.array([plan.actions[given - 1] for plan, given in following]), following

    def _follow(self, seen: Singles, last: tuple[Plan, int] | None) -> tuple[Plan, int]:
        """Choose the plan to go by, and count its next action as given."""
        if last is not None:
            plan, given = last
            if given < min(len(plan.actions), self._cost.follow) and (
                np.abs(plan.seen[given] - seen).max() <= AGREES
            ):
                return plan, given + 1
        self._model.begin_at(self._config.decode_start(seen))
        return make_plan(self._model, self._cost, self._width), 1


class _Period(NamedTuple):
    """One period of a search; the nodes of the period before are the parents of these."""

    parents: Integers  # (nodes,)
    actions: Integers  # (nodes,)
    seen: Singles  # (nodes, features) at its end


class _End(NamedTuple):
    """Where a plan may end."""

    cost: float
    period: int
    node: int


class _Timings(NamedTuple):
    """Nodes kept whatever they cost, each with the one action it goes on with."""

    nodes: Integers  # (timings,)
    actions: Integers  # (timings,)


def nodes_needed(cost: PlanCost, width: int, choices: int) -> int:
    """Count the nodes that `make_plan` moves at most."""
    return width * choices + cost.horizon + 1


def make_plan(model: SearchModel, cost: PlanCost, width: int) -> Plan:
    """Search for the best plan from where the model stands."""
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
    """Add a timing: the node that has not changed its action yet does."""
    waiting = timings.nodes[timings.actions == before]
    return _Timings(
        np.concatenate([timings.nodes, waiting]),
        np.concatenate([timings.actions, np.full(len(waiting), after)]),
    )


def keep_best(cost: PlanCost, moved: SearchNodes, runs: Booleans, width: int) -> Integers:
    """Choose the best nodes of those that run, none like a better one."""
    order = np.argsort(np.where(runs, cost.running(moved), np.inf), kind="stable")
    order = order[: np.count_nonzero(runs)]
    like = moved.parcels.state[order, : len(ALIKE)] / ALIKE
    if moved.turning is not None:
        # Nodes that are alike go on otherwise where their axes do.
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
