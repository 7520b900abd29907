"""Search for the best layout of a line: layouts that do well are changed, and the best kept.

What a column takes of a parcel's motion hardly depends on what the others take, so that a change of
few modules leads from a good layout to one that is a little different: that is all there is to go
by, as choices of orientations have neither slope nor order. Many layouts are tried at once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.physics.types import X
from surface_gym.state import OUT_OF_TIME, RUNNING, SUCCESS
from surface_gym.tasks.cost import Nodes

from ..axes import Axes
from .models import NominalModel
from .nodes import SearchNodes

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


class LayoutModel(NominalModel):
    """A nominal model whose copies run over axes that stay as they were arranged."""

    @property
    def axis(self) -> NDArray[np.int32]:
        """(copies, rows, columns) index of each axis among the orientations, to read and write;
        actions set those of the zone.
        """
        axis: NDArray[np.int32] = self._batch.surfaces.axis
        return axis

    @property
    def commands(self) -> Integers:
        """(copies, command size) of the zone's modules, to read and write."""
        return self._batch.surfaces.command

    def fork(self, parents: Integers) -> None:
        """Make the first copies ones of their parents (count,), axes and all; park the others."""
        self._batch.fork(parents)

    def step(self) -> bool:
        """Move every copy that runs over a control period; tell whether one still does."""
        self._batch.step(self.commands)
        return bool((self.parcels.outcome == RUNNING).any())

    def run(self, layouts: Integers) -> SearchNodes:
        """Let a parcel run from the start to the episode's end over each of some layouts.

        Args:
            layouts: (count, rows, columns) the place of each axis of the widest zone among the
                orientations; at most as many as there are copies.
        """
        count = len(layouts)
        self._batch.restore(self._begun)
        self.parcels.outcome[count:] = OUT_OF_TIME
        self.commands[:count] = layouts.reshape(count, -1)
        for _ in range(self.config.task.periods):
            if not self.step():
                break
        return self.nodes(count)


@dataclass(frozen=True)
class LayoutCost:
    """What a search of layouts minimises, and how it changes them."""

    cost: Callable[[Nodes], Numbers]  # (nodes,) of episodes that have ended
    enough: float  # cost at which the search ends
    halves: bool  # what changes together: half a column, else a module and its mirror image


def graded_cost(nodes: Nodes, missed: int) -> Numbers:
    """Compute the size of the task's first figure; a failure's grows with what it lacks, to lead to
    a success.

    Args:
        nodes: ended.
        missed: outcome of an end at another ratio, place or angle.
    """
    parcels = nodes.parcels
    error = np.abs(parcels.metrics[:, 0])
    _, _, first, columns = nodes.zone
    to_go = np.maximum(0.0, nodes.line.column_edge(first + columns) - parcels.truth[:, X])
    cost: Numbers = np.select(
        [parcels.outcome == SUCCESS, parcels.outcome == missed],
        [error, MISSED + error],
        FAILED + error + LEFT * to_go,
    )
    return cost


def search_layout(model: LayoutModel, search: LayoutCost, axes: Axes, known: Integers) -> Integers:
    """Search for the best layout from the model's start; the result is always the same.

    Args:
        model: begun.
        search: what is minimised.
        axes: orientations to choose from.
        known: (layouts, rows, columns) to begin with, choices of the widest zone; the best found is
            as good as the best of these at least.

    Returns:
        Its choices (rows, columns).
    """
    change = _Change(model, search, axes)
    layouts = np.concatenate([known, change(change.pick(known, model.size))])[: model.size]
    cost = search.cost(model.run(layouts))
    for _ in range(GENERATIONS):
        # No two that cost the same: such differ where no parcel comes.
        _, first = np.unique(cost, return_index=True)
        layouts, cost = layouts[first[:PARENTS]], cost[first[:PARENTS]]
        if cost[0] <= search.enough:
            break
        tried = change(change.pick(layouts, model.size))
        layouts = np.concatenate([layouts, tried])
        cost = np.concatenate([cost, search.cost(model.run(tried))])
    best: Integers = layouts[cost.argmin()]
    return best


class _Change:
    """Random changes of layouts, those of modules that the parcel of a start can touch."""

    def __init__(self, model: LayoutModel, search: LayoutCost, axes: Axes) -> None:
        self._random = np.random.default_rng(0)
        self._halves = search.halves
        self._axes = np.array([axes.roll, axes.right, axes.brake, axes.left])
        self._images = np.array([axes.roll, axes.left, axes.brake, axes.right])
        rows = model.config.action_kind.rows
        _, line_rows, _, _ = model.nodes(1).zone
        self._rows = np.arange(rows)[(rows - line_rows) // 2 :][:line_rows]

    def pick(self, layouts: Integers, count: int) -> Integers:
        """Draw some layouts."""
        picked: Integers = layouts[self._random.integers(len(layouts), size=count)]
        return picked

    def __call__(self, layouts: Integers) -> Integers:
        """Change each of some layouts (count, rows, columns) in a place or more."""
        changed, random = layouts.copy(), self._random
        count, rows, columns = layouts.shape
        for turn in range(CHANGES):
            more = random.random(count) < (1.0 if turn == 0 else 0.5)
            which = np.arange(count)[more]
            row = random.choice(self._rows, len(which))
            column = random.integers(columns, size=len(which))
            axis = random.integers(len(self._axes), size=len(which))
            several = random.random(len(which)) < TOGETHER
            changed[which, row, column] = self._axes[axis]
            which, row, column, axis = (each[several] for each in (which, row, column, axis))
            if self._halves:
                for other in self._rows:
                    same = (other >= rows // 2) == (row >= rows // 2)
                    changed[which[same], other, column[same]] = self._axes[axis[same]]
            else:
                changed[which, rows - 1 - row, column] = self._images[axis]
        return changed
