"""The best layout of a field along a path: beam search, column by column as parcels get there.

What a column does to a parcel tells on all that comes after it, so that a layout is laid from its
beginning on. Every layout of a beam waits where its parcel's front is about to touch a column that
is not laid yet; there the best go on, each with every way to lay that column.
"""

import itertools
import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.physics.types import OMEGA, THETA, VX, VY, X
from surface_gym.settings import Settings
from surface_gym.state import OUT_OF_TIME, RUNNING, SUCCESS
from surface_gym.tasks.base import Start
from surface_gym.tasks.track import Track

from ..sight import square_reach
from .aims import AIMS
from .layouts import LayoutModel
from .search import ALIKE

if TYPE_CHECKING:
    from ..rules.axes import Axes  # whose package imports this

Integers = NDArray[np.int64]
Numbers = NDArray[np.float64]

LANES = 512  # layouts tried at a time
LOST = 1e6  # cost of a failure, beyond that of any success
LATER = 1.1  # [-] what a parcel moves in a period at most, of what it moves by its speed now
NEAR = 0.002  # [m] from a column that is too near to go on


def path_model(settings: Settings) -> LayoutModel:
    """A model for `best_path_layout`: two physics steps a period, and actions that set the last
    column only, which no parcel touches that follows its path.
    """
    last = settings.chosen_plant.columns - 1
    return LayoutModel(
        replace(
            settings,
            task=Track(),  # whatever more is shown
            actions="modules",
            zone=(last, last),
            control_period=2.0 * settings.timing.dt,
        ),
        LANES,
    )


def best_path_layout(model: LayoutModel, axes: "Axes", start: Start, limit: float) -> Integers:
    """The best layout found for a start; the same whenever it is asked for.

    It is of those with two axes a column: one left of the path, one right of it. Where none is
    found that leads to the path's end, of those with one axis a column, of which more can be tried.

    Args:
        model: by `path_model`.
        axes: orientations to choose from.
        start: with its path.
        limit: [s] an episode may take.

    Returns:
        Its choices (rows, columns) of the whole field.
    """
    four = (axes.roll, axes.right, axes.brake, axes.left)
    found = []
    for ways in (itertools.product(four, four), zip(four, four, strict=True)):
        model.begin(start)
        model.commands[:] = axes.roll
        model.axis[:] = axes.roll
        found.append(_Beam(model, np.array(list(ways)), limit).search())
        if found[-1].cost < LOST:
            break
    return min(found, key=lambda each: each.cost).layout


class _Found(NamedTuple):
    """A layout that a parcel has run over to the episode's end."""

    cost: float
    layout: Integers  # (rows, columns) its choices


class _Beam:
    """One search."""

    def __init__(self, model: LayoutModel, ways: Integers, limit: float) -> None:
        self._model = model
        self._ways = ways  # (ways, 2) to lay a column: right of the path and left of it
        self._width = model.size // len(ways)  # layouts that go on from a column
        self._limit = limit
        self._plant = model.settings.chosen_plant
        stand = model.stand(1)
        self._half_length = stand.half_length
        _, first_x, step = stand.parcels.goal[0]
        x = self._plant.column_edge(0.5) + self._plant.pitch_x * np.arange(self._plant.columns)
        path = np.interp(
            x, first_x + step * np.arange(stand.parcels.path.shape[1]), stand.parcels.path[0]
        )
        y = self._plant.origin[1] + self._plant.pitch_y * np.arange(self._plant.rows)
        self._left = (y[:, np.newaxis] > path).astype(np.int64)  # (rows, columns)
        self._best = _Found(math.inf, model.axis[0].astype(np.int64))

    def search(self) -> _Found:
        """The best layout."""
        columns = self._plant.columns - 1
        front = self._front(1)[0]
        # Columns that the parcel stands on are laid alike.
        first, kept = 0, np.zeros(1, dtype=np.int64)
        while len(kept) and first <= columns:
            last = first
            while last + 1 < columns and self._centre(last + 1) <= front + NEAR:
                last += 1
            self._lay(kept, first, last + 1)
            count = len(kept) * len(self._ways)
            first = last + 1
            self._approach(count, self._centre(first) if first < columns else math.inf)
            self._note(count)
            kept = self._keep(count, first)
            front = -math.inf
        return self._best

    def _centre(self, column: int) -> float:
        return self._plant.column_edge(column + 0.5)

    def _lay(self, kept: Integers, first: int, end: int) -> None:
        """Go on from the kept lanes with every way to lay some columns."""
        ways = len(self._ways)
        self._model.branch(np.repeat(kept, ways))
        laid = self._ways[:, self._left[:, first:end]]  # (ways, rows, columns)
        self._model.axis[: ways * len(kept), :, first:end] = np.tile(laid, (len(kept), 1, 1))

    def _front(self, count: int) -> Numbers:
        """(count,) [m] x that the foremost point is at after another period, at most."""
        motion = self._model.lanes.truth[:count]
        reach = square_reach(self._half_length, motion[:, THETA])
        speed = np.hypot(motion[:, VX], motion[:, VY])
        speed += math.sqrt(2.0) * self._half_length * np.abs(motion[:, OMEGA])
        front: Numbers = motion[:, X] + reach + LATER * self._model.settings.control_period * speed
        return front

    def _approach(self, count: int, centre: float) -> None:
        """Move the lanes until each is about to touch a column, or has ended."""
        outcome = self._model.lanes.outcome
        waiting = np.zeros(count, dtype=np.bool_)
        for _ in range(self._model.settings.chosen_task.periods):
            there = (outcome[:count] == RUNNING) & (self._front(count) + NEAR >= centre)
            waiting |= there
            outcome[:count][there] = OUT_OF_TIME
            if not self._model.advance():
                break
        outcome[:count][waiting] = RUNNING

    def _note(self, count: int) -> None:
        """Remember the best layout of all that have ended."""
        stand = self._model.stand(count)
        lanes = stand.parcels
        there = (lanes.outcome == SUCCESS) & (lanes.clock <= self._limit)
        # Of failures, the one that got farthest.
        cost = np.where(there, AIMS["track"].end(stand), LOST + LOST / (1.0 + lanes.truth[:, X]))
        cost[lanes.outcome == RUNNING] = math.inf
        if cost.min() < self._best.cost:
            layout = self._model.axis[cost.argmin()].astype(np.int64)
            self._best = _Found(float(cost.min()), layout)

    def _keep(self, count: int, laid: int) -> Integers:
        """The best lanes of those that run, none like a better one."""
        stand = self._model.stand(count)
        runs = stand.parcels.outcome == RUNNING
        cost = np.where(runs, AIMS["track"].way(stand), math.inf)
        order = np.argsort(cost, kind="stable")[: np.count_nonzero(runs)]
        kinds = np.rint(stand.parcels.state[order, : len(ALIKE)] / ALIKE).astype(np.int64)
        under = self._under(order, laid)
        _, best = np.unique(np.concatenate([kinds, under], axis=1), axis=0, return_index=True)
        return order[np.sort(best)[: self._width]]

    def _under(self, order: Integers, laid: int) -> Integers:
        """(lanes, 2 x columns) how columns under the parcel are laid, by the outermost rows."""
        reach = math.ceil(2.0 * math.sqrt(2.0) * self._half_length / self._plant.pitch_x)
        columns = self._model.axis[order][:, [0, -1], max(0, laid - reach) : laid]
        under: Integers = columns.reshape(len(order), 2 * columns.shape[2]).astype(np.int64)
        return under
