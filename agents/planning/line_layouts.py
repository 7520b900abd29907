"""The best layout of a line for one start: layouts that do well are changed, and the best kept.

What a column takes of a parcel's motion hardly hangs on what the others take, so that a change of
few modules leads from a good layout to one that is a little different: that is all there is to go
by, as choices of orientations have neither slope nor order. All lanes are tried at once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surface_gym.physics.types import VX, VY, X
from surface_gym.state import SUCCESS
from surface_gym.tasks import orient, slow, stop
from surface_gym.tasks.line import BRAKING

from .layouts import LayoutModel
from .stand import Stand

if TYPE_CHECKING:
    from ..rules.axes import Axes  # whose package imports this

Integers = NDArray[np.int64]
Numbers = NDArray[np.float64]

LAYOUTS = 128  # tried at a time
GENERATIONS = 20
PARENTS = 12  # layouts kept from generation to generation
CHANGES = 2  # of a layout at most
TOGETHER = 0.7  # share of changes that are of several modules of a column

# Costs beyond that of any success, the lower the better.
MISSED = 1e3  # of an end at another ratio, place or angle; its error comes on top
FAILED = MISSED + 0.05  # of any other failure; its error and the way to go come on top
LEFT = 0.5  # cost of a metre to go


@dataclass(frozen=True)
class Search:
    """What is looked for, and how layouts are changed."""

    cost: Callable[[Stand], Numbers]  # (lanes,) of episodes that have ended
    enough: float  # cost at which the search ends
    halves: bool  # what changes together: half a column, else a module and its mirror image


def _graded(stand: Stand, missed: int) -> Numbers:
    """The task's first figure; a failure's grows with what it lacks, to lead to a success."""
    lanes = stand.parcels
    error = np.abs(lanes.metrics[:, 0])
    _, _, first, columns = stand.zone
    to_go = np.maximum(0.0, stand.plant.column_edge(first + columns) - lanes.truth[:, X])
    cost: Numbers = np.select(
        [lanes.outcome == SUCCESS, lanes.outcome == missed],
        [error, MISSED + error],
        FAILED + error + LEFT * to_go,
    )
    return cost


def _slow_cost(stand: Stand) -> Numbers:
    return _graded(stand, slow.MISSED)


def _stop_cost(stand: Stand) -> Numbers:
    lanes = stand.parcels
    # One that has passed the asked x would rest this much farther at best.
    farther = (lanes.truth[:, VX] ** 2 + lanes.truth[:, VY] ** 2) / (2.0 * BRAKING)
    passed = MISSED + np.abs(lanes.metrics[:, stop.STOP_ERROR]) + farther
    return np.where(lanes.outcome == stop.OVERSHOT, passed, _graded(stand, stop.MISSED))


def _orient_cost(stand: Stand) -> Numbers:
    return _graded(stand, orient.MISSED)


SEARCHES = {
    "slow": Search(_slow_cost, enough=2e-4, halves=False),
    "stop": Search(_stop_cost, enough=2e-5, halves=False),
    "orient": Search(_orient_cost, enough=1e-3, halves=True),
}


def best_line_layout(model: LayoutModel, search: Search, axes: "Axes", known: Integers) -> Integers:
    """The best layout found from the model's start; the same whenever it is asked for.

    Args:
        model: begun.
        search: what is looked for.
        axes: orientations to choose from.
        known: (layouts, rows, columns) to begin with, choices of the widest zone; the best found is
            as good as the best of these at least.

    Returns:
        Its choices (rows, columns).
    """
    change = _Change(model, search, axes)
    layouts = np.concatenate([known, change(_picked(known, change, model.size))])[: model.size]
    cost = search.cost(model.run(layouts))
    for _ in range(GENERATIONS):
        layouts, cost = _keep(layouts, cost)
        if cost[0] <= search.enough:
            break
        tried = change(_picked(layouts, change, model.size))
        layouts = np.concatenate([layouts, tried])
        cost = np.concatenate([cost, search.cost(model.run(tried))])
    best: Integers = layouts[cost.argmin()]
    return best


def _picked(layouts: Integers, change: "_Change", count: int) -> Integers:
    picked: Integers = layouts[change.random.integers(len(layouts), size=count)]
    return picked


def _keep(layouts: Integers, cost: Numbers) -> tuple[Integers, Numbers]:
    """The best, no two that cost the same: such differ where no parcel comes."""
    _, first = np.unique(cost, return_index=True)
    best = first[:PARENTS]
    return layouts[best], cost[best]


class _Change:
    """Random changes of layouts, those of modules that the parcel of a start can touch."""

    def __init__(self, model: LayoutModel, search: Search, axes: "Axes") -> None:
        self.random = np.random.default_rng(0)
        self._halves = search.halves
        self._axes = np.array([axes.roll, axes.right, axes.brake, axes.left])
        self._images = np.array([axes.roll, axes.left, axes.brake, axes.right])
        rows = model.settings.action_kind.rows
        _, site_rows, _, _ = model.stand(1).zone
        self._rows = np.arange(rows)[(rows - site_rows) // 2 :][:site_rows]

    def __call__(self, layouts: Integers) -> Integers:
        """Layouts (count, rows, columns), each changed in a place or more."""
        changed, random = layouts.copy(), self.random
        count, rows, columns = layouts.shape
        for turn in range(CHANGES):
            more = random.random(count) < (1.0 if turn == 0 else 0.5)
            lane = np.arange(count)[more]
            row = random.choice(self._rows, len(lane))
            column = random.integers(columns, size=len(lane))
            which = random.integers(len(self._axes), size=len(lane))
            several = random.random(len(lane)) < TOGETHER
            changed[lane, row, column] = self._axes[which]
            lane, row, column, which = (each[several] for each in (lane, row, column, which))
            if self._halves:
                for other in self._rows:
                    same = (other >= rows // 2) == (row >= rows // 2)
                    changed[lane[same], other, column[same]] = self._axes[which[same]]
            else:
                changed[lane, rows - 1 - row, column] = self._images[which]
        return changed
