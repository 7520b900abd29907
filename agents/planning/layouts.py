"""Searches for the best layout of a line; a layout is one orientation for every module.

`search_layout` keeps the best layouts of each generation, and tries copies with random changes.
Changes are random, since orientations have neither gradient nor order. Changing a few modules of a
good layout changes the result only a little, since columns act almost independently. Many layouts
run at once. `search_path_layout` is a beam search, column by column.
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
from surface_gym.tasks.features import Feature, columns, show
from surface_gym.tasks.planning import Nodes, ObservationTable, square_reach
from surface_gym.tasks.start import Start
from surface_gym.tasks.track import Track

from ..base import Axes, Integers, Numbers
from .models import NominalModel, SearchNodes
from .planner import ALIKE

LAYOUTS = 128  # layouts per batch
GENERATIONS = 20
PARENTS = 12  # layouts kept per generation
CHANGES = 2  # maximum changes of a layout per generation
TOGETHER = 0.7  # share of changes of several modules of a column

# Costs of failures, higher than any success.
MISSED = 1e3  # end at a wrong ratio, position or angle; plus its error
FAILED = MISSED + 0.05  # any other failure; plus its error and the remaining distance
LEFT = 0.5  # cost per remaining metre


class LayoutModel(NominalModel):
    """A nominal model in which each copy runs over its own fixed layout."""

    @property
    def axis(self) -> NDArray[np.int32]:
        """Writable indices (copies, rows, columns) of each module's orientation."""
        return self._batch.surfaces.axis

    @property
    def commands(self) -> Integers:
        return self._batch.surfaces.command

    def fork(self, parents: Integers) -> None:
        """Overwrite copy k with copy `parents[k]`, k < len(parents). End all other copies."""
        self._batch.fork(parents)

    def step(self) -> bool:
        """Move every running copy by a control period; return whether any copy still runs."""
        self._batch.step(self.commands)
        return bool((self.parcels.outcome == RUNNING).any())

    def run(self, layouts: Integers) -> SearchNodes:
        """Run a parcel from the start to the episode's end over each of `layouts`.

        `layouts` (count, rows, columns) are choices of orientation for the zone. `count` is at
        most the number of copies.
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
    """Cost that a search of layouts minimises, and the kind of changes that the search tries."""

    cost: Callable[[Nodes], Numbers]  # (nodes,) cost of finished episodes
    enough: float  # cost at which the search ends
    halves: bool  # whether changes apply to half a column, else to a module and its mirror image


def graded_cost(nodes: Nodes, missed: int) -> Numbers:
    """Compute costs (nodes,). A success costs the absolute value of the task's first metric.

    Failures cost more. `missed` is the outcome of an episode that ends at a wrong speed ratio,
    position or angle. Other failures cost most, and the cost grows with the remaining distance.
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
    """Search, deterministically, for the best layout (rows, columns) for the model's start.

    The search begins with the layouts `known` (layouts, rows, columns). Rows and columns are of the
    task's widest zone. The result is at least as good as the best of the known layouts.
    """
    change = _Change(model, search, axes)
    layouts = np.concatenate([known, change(change.pick(known, model.size))])[: model.size]
    cost = search.cost(model.run(layouts))
    for _ in range(GENERATIONS):
        # Keep one layout per cost: layouts with equal cost differ only away from the parcel.
        _, first = np.unique(cost, return_index=True)
        layouts, cost = layouts[first[:PARENTS]], cost[first[:PARENTS]]
        if cost[0] <= search.enough:
            break
        tried = change(change.pick(layouts, model.size))
        layouts = np.concatenate([layouts, tried])
        cost = np.concatenate([cost, search.cost(model.run(tried))])
    return layouts[cost.argmin()]


class _Change:
    """Changes orientations in layouts at random, only in rows that the parcel can touch."""

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
        """Return copies of layouts (count, rows, columns), each with one change or more."""
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


SIZE = 512  # layouts per batch
LOST = 1e6  # cost of a failure, higher than any success
LATER = 1.1  # [-] maximum distance in a period, relative to the current speed times the period
NEAR = 0.002  # [m] smaller distances to a column are too small to go on

FARTHEST = 1000.0  # [m] maximum distance from the origin
FEATURES = (
    *track.FEATURES,
    Feature("x", -FARTHEST, FARTHEST, "of the base's centre", "m"),
    Feature("y", -FARTHEST, FARTHEST, "of the base's centre", "m"),
    Feature("path's first x", -FARTHEST, FARTHEST, unit="m"),
    Feature("path's step", 0.0, FARTHEST, "in x, from point to point", "m"),
    *(Feature(f"path {k}", -FARTHEST, FARTHEST, "its y", "m") for k in range(PATH_POINTS)),
)
COLUMN = columns(FEATURES)
PATH = COLUMN.path_0.place  # the first of its points

_observe_track = Track.observe  # compiled code cannot use classes


class ShownPath(Track):
    """Track with an observation that also shows the whole path and the parcel's position."""

    features = FEATURES

    @classmethod
    def of(cls, task: Task) -> "ShownPath":
        """Copy the fields of the task `task` into a `ShownPath`."""
        return cls(**{each.name: getattr(task, each.name) for each in fields(task)})

    def decode_start(self, seen: ObservationTable) -> Start:
        """Decode the start of an episode from its first observation."""
        names = ("x", "y", "path's first x", "path's step")
        x, y, first_x, step = (float(seen[name][0]) for name in names)
        path = seen.shown[0, PATH:]
        return self.decode(seen).start(self.parcels, (x, y), (first_x, step), path)

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        _observe_track(state)
        see = state.observation
        show(see, COLUMN.x, state.sensed[X])
        show(see, COLUMN.y, state.sensed[Y])
        show(see, COLUMN.path_s_first_x, state.goal[track.FIRST_X])
        show(see, COLUMN.path_s_step, state.goal[track.STEP_X])
        for k in range(PATH_POINTS):
            see[PATH + k] = state.path[k]


def path_model(config: EnvConfig) -> LayoutModel:
    """Make a model for `search_path_layout`, with two physics steps per period.

    The model's actions set only the last column. A parcel on a path does not touch this column.
    """
    last = config.chosen_line.columns - 1
    return LayoutModel(
        replace(
            config,
            task=Track(),  # without additional observations
            actions="modules",
            zone=(last, last),
            control_period=2.0 * config.timing.dt,
        ),
        SIZE,
    )


def search_path_layout(model: LayoutModel, axes: Axes, start: Start, limit: float) -> Integers:
    """Search deterministically for the layout (rows, columns) that best leads a parcel on a path.

    Each column has two orientations: one left of the path and one right of the path. If no layout
    leads to the path's end within `limit` [s], the search starts again with one orientation per
    column. Then there are fewer choices, and the beam is wider.
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


class _CompletedRun(NamedTuple):
    """Result of an episode over one layout."""

    cost: float
    layout: Integers  # (rows, columns) choices of the layout


class _Beam:
    """A beam search for the layout that best leads a parcel along a path."""

    def __init__(self, model: LayoutModel, ways: Integers, limit: float) -> None:
        self._model = model
        self._cost = model.config.task.cost()
        self._ways = ways  # (ways, 2) choices of a column: right of the path and left of it
        self._width = model.size // len(ways)  # layouts that continue from a column
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
        self._best = _CompletedRun(math.inf, model.axis[0].astype(np.int64))

    def search(self) -> _CompletedRun:
        columns = self._line.columns - 1
        front = self._front(1)[0]
        # Columns under the initial parcel get equal axes.
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
        """Fork each copy in `kept` for every way to orient the columns `first`, ..., `end` - 1."""
        ways = len(self._ways)
        self._model.fork(np.repeat(kept, ways))
        laid = self._ways[:, self._left[:, first:end]]  # (ways, rows, columns)
        self._model.axis[: ways * len(kept), :, first:end] = np.tile(laid, (len(kept), 1, 1))

    def _front(self, count: int) -> Numbers:
        """Return upper bounds (count,) [m] on the x of the parcels' fronts after another period."""
        motion = self._model.parcels.truth[:count]
        reach = square_reach(self._half_length, motion[:, THETA])
        speed = np.hypot(motion[:, VX], motion[:, VY])
        speed += math.sqrt(2.0) * self._half_length * np.abs(motion[:, OMEGA])
        return motion[:, X] + reach + LATER * self._model.config.control_period * speed

    def _approach(self, count: int, centre: float) -> None:
        """Step the first `count` copies. A copy stops near the next column, or when its run ends.

        The next column is at x = `centre` [m]. If `centre` is infinite, there is no next column.
        """
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
        """Update the best layout from ended episodes among the first `count` environments."""
        nodes = self._model.nodes(count)
        parcels = nodes.parcels
        there = (parcels.outcome == SUCCESS) & (parcels.clock <= self._limit)
        # The best failure is the run that came farthest.
        cost = np.where(there, self._cost.final(nodes), LOST + LOST / (1.0 + parcels.truth[:, X]))
        cost[parcels.outcome == RUNNING] = math.inf
        if cost.min() < self._best.cost:
            layout = self._model.axis[cost.argmin()].astype(np.int64)
            self._best = _CompletedRun(float(cost.min()), layout)

    def _keep(self, count: int, laid: int) -> Integers:
        """Choose the copies of the environment with the lowest cost among the first `count` copies.

        The choice leaves out near duplicates, and copies with an ended episode. `laid` is the
        number of columns that already have their orientations.
        """
        nodes = self._model.nodes(count)
        runs = nodes.parcels.outcome == RUNNING
        cost = np.where(runs, self._cost.running(nodes), math.inf)
        order = np.argsort(cost, kind="stable")[: np.count_nonzero(runs)]
        kinds = np.rint(nodes.parcels.state[order, : len(ALIKE)] / ALIKE).astype(np.int64)
        # The first and last axes of the columns under the parcel tell copies apart, too.
        reach = math.ceil(2.0 * math.sqrt(2.0) * self._half_length / self._line.pitch_x)
        under = self._model.axis[order][:, [0, -1], max(0, laid - reach) : laid]
        alike = np.hstack([kinds, under.reshape(len(order), 2 * under.shape[2])])
        _, best = np.unique(alike, axis=0, return_index=True)
        return order[np.sort(best)[: self._width]]
