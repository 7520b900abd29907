"""Beam search: the best lanes so far go on with every action, and the best of those again."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.state import RUNNING

from .aims import Aim
from .branching import Branching
from .stand import Stand

Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]

# [m, m, rad, m/s, m/s, rad/s] within which lanes are so much alike that the best will do.
ALIKE = np.array([0.004, 0.004, 0.02, 0.01, 0.01, 0.1])


@dataclass(frozen=True, eq=False)
class Plan:
    """Actions, and what will be seen before each if the model is right."""

    actions: Integers  # (periods,)
    seen: NDArray[np.float32]  # (periods, features)


class _Period(NamedTuple):
    """One period of a search; the lanes of the period before are the parents of these."""

    parents: Integers  # (lanes,)
    actions: Integers  # (lanes,)
    seen: NDArray[np.float32]  # (lanes, features) at its end


class _End(NamedTuple):
    """Where a plan may end."""

    cost: float
    period: int
    lane: int


class _Timings(NamedTuple):
    """Lanes kept whatever they cost, each with the one action it goes on with."""

    lanes: Integers  # (timings,)
    actions: Integers  # (timings,)


def lanes_needed(aim: Aim, width: int, choices: int) -> int:
    """How many lanes `make_plan` moves at most."""
    return width * choices + aim.horizon + 1


def make_plan(model: Branching, aim: Aim, width: int) -> Plan:
    """The best plan found from where the model's lanes stand.

    Args:
        model: begun, of `lanes_needed` lanes.
        aim: what is preferred.
        width: lanes that go on from a period.
    """
    first_seen = model.parcels.observation[0].copy()
    event = aim.event(model)
    kept = np.zeros(1, dtype=np.int64)
    timings = _Timings(kept[:0], kept[:0]) if event is None else _Timings(kept, np.array(event[:1]))
    periods: list[_Period] = []
    best = _End(np.inf, 0, 0)
    while len(kept) and len(periods) < aim.horizon and best.cost > aim.enough:
        if event is not None:
            timings = _change(timings, event)
        parents = np.concatenate([np.repeat(kept, model.choices), timings.lanes])
        every = np.tile(np.arange(model.choices), len(kept))
        actions = np.concatenate([every, timings.actions])
        moved = model.advance(parents, actions)
        runs = moved.parcels.outcome == RUNNING
        over = ~runs if len(periods) < aim.horizon - 1 else np.ones_like(runs)
        if over.any():
            cost = np.where(over, aim.end(moved), np.inf)
            best = min(best, _End(float(cost.min()), len(periods), int(cost.argmin())))
        periods.append(_Period(parents, actions, moved.parcels.observation.copy()))
        timings = _Timings(
            np.nonzero(runs[len(every) :])[0] + len(every), timings.actions[runs[len(every) :]]
        )
        kept = _keep(aim, moved, runs, width)
    return _trace(periods, best, first_seen)


def _change(timings: _Timings, event: tuple[int, int]) -> _Timings:
    """With one more: the lane that has not changed its action yet does."""
    waiting = timings.lanes[timings.actions == event[0]]
    return _Timings(
        np.concatenate([timings.lanes, waiting]),
        np.concatenate([timings.actions, np.full(len(waiting), event[1])]),
    )


def _keep(aim: Aim, moved: Stand, runs: Booleans, width: int) -> Integers:
    """The best lanes of those that run, none like a better one."""
    order = np.argsort(np.where(runs, aim.way(moved), np.inf), kind="stable")
    order = order[: np.count_nonzero(runs)]
    like = moved.parcels.state[order, : len(ALIKE)] / ALIKE
    if moved.turning is not None:
        # Lanes that stand alike go on otherwise where their axes do.
        pushes = moved.turning.pushes(moved.braking)
        like = np.hstack([like, pushes[order] / ALIKE[3:]])
    kinds = np.rint(like).astype(np.int64)
    _, best_of_kind = np.unique(kinds, axis=0, return_index=True)
    return order[np.sort(best_of_kind)[:width]]


def _trace(periods: list[_Period], end: _End, first_seen: NDArray[np.float32]) -> Plan:
    """The plan that comes to an end."""
    lane, actions, seen = end.lane, [], []
    for period in reversed(periods[: end.period + 1]):
        actions.append(int(period.actions[lane]))
        seen.append(period.seen[lane])
        lane = int(period.parents[lane])
    return Plan(np.array(actions[::-1]), np.array([first_seen, *seen[:0:-1]]))
