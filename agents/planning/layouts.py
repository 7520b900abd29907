"""Search for the best layout of a line: layouts that do well are changed, and the best kept.

What a column takes of a parcel's motion hardly depends on what the others take, so that a change of
few modules leads from a good layout to one that is a little different: that is all there is to go
by, as choices of orientations have neither slope nor order. Many layouts are tried at once.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.compiler.jit import kernel_function
from surface_gym.config import EnvConfig
from surface_gym.physics.types import OMEGA, THETA, VX, VY, X, Y
from surface_gym.state import OUT_OF_TIME, PATH_POINTS, RUNNING, SUCCESS, EnvState
from surface_gym.tasks import Task, track
from surface_gym.tasks.base import Feature
from surface_gym.tasks.planning import Nodes, Observed, square_reach
from surface_gym.tasks.start import Start
from surface_gym.tasks.track import Track

from ..base import Axes, Integers, Numbers
from .models import NominalModel, SearchNodes
from .planner import ALIKE

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
        return self._batch.surfaces.axis

    @property
    def commands(self) -> Integers:
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
    """Cost that a search of layouts minimises, and the way it changes them."""

    cost: Callable[[Nodes], Numbers]  # (nodes,) of episodes that have ended
    enough: float  # cost at which the search ends
    halves: bool  # what changes together: half a column, else a module and its mirror image


def graded_cost(nodes: Nodes, missed: int) -> Numbers:
    """Compute the size of the task's first metric; a failure's grows with what it lacks, to lead to
    a success.
    """
    parcels = nodes.parcels
    error = np.abs(parcels.metrics[:, 0])
    _, _, first, columns = nodes.zone
    to_go = np.maximum(0.0, nodes.line.column_edge(first + columns) - parcels.truth[:, X])
    return np.select(
        [parcels.outcome == SUCCESS, parcels.outcome == missed],
        [error, MISSED + error],
        FAILED + error + LEFT * to_go,
    )


def search_layout(model: LayoutModel, search: LayoutCost, axes: Axes, known: Integers) -> Integers:
    """Search for the best layout from the model's start; the result is always the same.

    Args:
        known: (layouts, rows, columns) to begin with, choices of the widest zone; the best found is
            as good as the best of these at least.
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
    return layouts[cost.argmin()]


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
        return layouts[self._random.integers(len(layouts), size=count)]

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


SIZE = 512  # layouts tried at a time
LOST = 1e6  # cost of a failure, beyond that of any success
LATER = 1.1  # [-] what a parcel moves in a period at most, of what it moves by its speed now
NEAR = 0.002  # [m] from a column that is too near to go on

OWN = len(track.FEATURES)  # index of the first feature that Track does not show
FARTHEST = 1000.0  # [m] that anything can be from the origin

_observe_track = Track.observe  # compiled code knows no classes


class ShownPath(Track):
    """Track for methods that may know the whole path: its observation also shows the path, and
    where the parcel is.
    """

    features = (
        *track.FEATURES,
        Feature("x", -FARTHEST, FARTHEST, "of the base's centre / 1 m"),
        Feature("y", -FARTHEST, FARTHEST, ""),
        Feature("path's first x", -FARTHEST, FARTHEST, "/ 1 m"),
        Feature("path's step", 0.0, FARTHEST, "in x, from point to point / 1 m"),
        *(Feature(f"path {k}", -FARTHEST, FARTHEST, "y / 1 m") for k in range(PATH_POINTS)),
    )

    @classmethod
    def of(cls, task: Task) -> "ShownPath":
        """Make the same Track with its whole path shown."""
        return cls(**{each.name: getattr(task, each.name) for each in fields(task)})

    def decode_start(self, seen: Observed) -> Start:
        """Decode the first observation into the start that it shows."""
        x, y, first_x, step, *path = seen.values[0, OWN:].tolist()
        return self.decode(seen).start(self.parcels, (x, y), (first_x, step), np.array(path))

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        _observe_track(state)
        see = state.observation
        see[OWN] = state.sensed[X]
        see[OWN + 1] = state.sensed[Y]
        see[OWN + 2] = state.goal[track.FIRST_X]
        see[OWN + 3] = state.goal[track.STEP_X]
        for k in range(PATH_POINTS):
            see[OWN + 4 + k] = state.path[k]


def path_model(config: EnvConfig) -> LayoutModel:
    """Make a model for `search_path_layout`: two physics steps a period, and actions that set the
    last column only, which no parcel touches that follows its path.
    """
    last = config.chosen_line.columns - 1
    return LayoutModel(
        replace(
            config,
            task=Track(),  # whatever more is shown
            actions="modules",
            zone=(last, last),
            control_period=2.0 * config.timing.dt,
        ),
        SIZE,
    )


def search_path_layout(model: LayoutModel, axes: Axes, start: Start, limit: float) -> Integers:
    """Search for the best layout for a start; the result is always the same.

    It is one with two axes a column: one left of the path, one right of it. Where none is found
    that leads to the path's end, it is one with one axis a column, of which more can be tried.
    """
    four = (axes.roll, axes.right, axes.brake, axes.left)
    found = []
    for ways in (itertools.product(four, four), zip(four, four, strict=True)):
        model.begin_at(start)
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
        self._cost = model.config.task.cost()
        self._ways = ways  # (ways, 2) to lay a column: right of the path and left of it
        self._width = model.size // len(ways)  # layouts that go on from a column
        self._limit = limit
        self._line = model.config.chosen_line
        nodes = model.nodes(1)
        self._half_length = nodes.half_length
        _, first_x, step = nodes.parcels.goal[0]
        x = self._line.column_edge(0.5) + self._line.pitch_x * np.arange(self._line.columns)
        path = nodes.parcels.path[0]
        path = np.interp(x, first_x + step * np.arange(len(path)), path)
        y = self._line.origin[1] + self._line.pitch_y * np.arange(self._line.rows)
        self._left = (y[:, np.newaxis] > path).astype(np.int64)  # (rows, columns)
        self._best = _Found(math.inf, model.axis[0].astype(np.int64))

    def search(self) -> _Found:
        columns = self._line.columns - 1
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
        return self._line.column_edge(column + 0.5)

    def _lay(self, kept: Integers, first: int, end: int) -> None:
        """Go on from the kept copies with every way to lay some columns."""
        ways = len(self._ways)
        self._model.fork(np.repeat(kept, ways))
        laid = self._ways[:, self._left[:, first:end]]  # (ways, rows, columns)
        self._model.axis[: ways * len(kept), :, first:end] = np.tile(laid, (len(kept), 1, 1))

    def _front(self, count: int) -> Numbers:
        """Bound the x (count,) [m] of the foremost point after another period."""
        motion = self._model.parcels.truth[:count]
        reach = square_reach(self._half_length, motion[:, THETA])
        speed = np.hypot(motion[:, VX], motion[:, VY])
        speed += math.sqrt(2.0) * self._half_length * np.abs(motion[:, OMEGA])
        return motion[:, X] + reach + LATER * self._model.config.control_period * speed

    def _approach(self, count: int, centre: float) -> None:
        """Move the copies until each is about to touch a column, or has ended."""
        outcome = self._model.parcels.outcome
        waiting = np.zeros(count, dtype=np.bool_)
        for _ in range(self._model.config.task.periods):
            there = (outcome[:count] == RUNNING) & (self._front(count) + NEAR >= centre)
            waiting |= there
            outcome[:count][there] = OUT_OF_TIME
            if not self._model.step():
                break
        outcome[:count][waiting] = RUNNING

    def _note(self, count: int) -> None:
        """Remember the best layout of all that have ended."""
        nodes = self._model.nodes(count)
        parcels = nodes.parcels
        there = (parcels.outcome == SUCCESS) & (parcels.clock <= self._limit)
        # Of failures, the one that got farthest.
        cost = np.where(there, self._cost.final(nodes), LOST + LOST / (1.0 + parcels.truth[:, X]))
        cost[parcels.outcome == RUNNING] = math.inf
        if cost.min() < self._best.cost:
            layout = self._model.axis[cost.argmin()].astype(np.int64)
            self._best = _Found(float(cost.min()), layout)

    def _keep(self, count: int, laid: int) -> Integers:
        """Choose the best copies of those that run, none like a better one."""
        nodes = self._model.nodes(count)
        runs = nodes.parcels.outcome == RUNNING
        cost = np.where(runs, self._cost.running(nodes), math.inf)
        order = np.argsort(cost, kind="stable")[: np.count_nonzero(runs)]
        kinds = np.rint(nodes.parcels.state[order, : len(ALIKE)] / ALIKE).astype(np.int64)
        under = self._under(order, laid)
        _, best = np.unique(np.concatenate([kinds, under], axis=1), axis=0, return_index=True)
        return order[np.sort(best)[: self._width]]

    def _under(self, order: Integers, laid: int) -> Integers:
        """List (copies, 2 x columns) the outermost axes of the columns under the parcel."""
        reach = math.ceil(2.0 * math.sqrt(2.0) * self._half_length / self._line.pitch_x)
        columns = self._model.axis[order][:, [0, -1], max(0, laid - reach) : laid]
        return columns.reshape(len(order), 2 * columns.shape[2]).astype(np.int64)
