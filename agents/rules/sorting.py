"""Rules that sort one parcel or a stream: fixed layouts, and rules that turn axes once. The zone is
all columns whose axes a controller sets; columns before it stay at 90 deg.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.actions import ANY
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.design.fixed_layout import SIDE, SortingLayout, sorting_layouts
from surface_gym.flow.task import COLUMN as STREAM
from surface_gym.layouts import ROLLING
from surface_gym.tasks import Sort
from surface_gym.tasks.features import read

from .. import library
from ..base import SAME, BatchController, Integers, Numbers, Singles, axes_apart, find_axes
from .base import (
    BaseStreamRule,
    Commands,
    CompiledController,
    CompiledRule,
    FixedRule,
    Observations,
    rule,
)
from .decoding import Sight, look_at_line, see_line
from .slopes import ROLL, TO_LEFT, TO_RIGHT

OWN = len(Sort.features)  # number of Sort's features, the first of a stream's row
OPEN = 1  # the gate opens at the first physics step, if there is room


@compiled
def choose_by_side(
    observations: Singles, sight: Sight, axes: Integers, waits: int, commands: Integers
) -> None:
    """Write commands (num_envs, modules) that turn all axes to 45 deg, towards the goal side.

    If `waits` is 1, axes stay at 90 deg until the parcel is wholly in the zone. For the exit
    straight ahead, axes stay at 90 deg. The array `axes` (4,) has the orientations for rolling,
    braking, leading left and leading right.
    """
    roll, _, left, right = axes
    for i in range(observations.shape[0]):
        seen = see_line(observations[i], sight)
        choice = roll
        if seen.side != 0.0 and (seen.wholly_in_zone or waits == 0):
            choice = left if seen.side > 0.0 else right
        for k in range(commands.shape[1]):
            commands[i, k] = choice


@rule("fixed layout", "sort", actions="modules")
class FixedLayout(CompiledRule):
    """The study's Figure 6a: fixed axes at -45 deg sort to y > 0, and at +45 deg to y < 0.

    For the exit straight ahead, the axes stay at 90 deg.
    """

    kernel = staticmethod(choose_by_side)
    waits = 0  # 1: wait until the parcel is wholly in the zone

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("sort",))
        self._sight = look_at_line(config)

    def arguments(self, observations: Observations, _: Any, commands: Commands) -> tuple[Any, ...]:
        return observations, self._sight, self._axes, self.waits, commands


class BoxLayouts:
    """Layouts of `surface_gym.design` for the study's boxes, fitted to a zone.

    A longer zone repeats the last column of a layout; a shorter zone omits the last columns.
    """

    def __init__(self, layouts: Sequence[SortingLayout], shape: tuple[int, int]) -> None:
        self._half_lengths = np.array([layout.half_length for layout in layouts])
        self._axes = np.stack([_fit(layout.axis, *shape) for layout in layouts])

    def arrange(self, half_length: Numbers, side: Numbers) -> Numbers:
        """Return axes (num_envs, modules) [rad] by the layout for the box most similar in length.

        `half_length` (num_envs,) [m] are the half lengths of the parcels. `side` (num_envs,) has
        the goals of the parcels: +1 means y > 0, -1 means y < 0, and 0 means straight ahead.
        """
        box = np.abs(half_length[:, np.newaxis] - self._half_lengths).argmin(axis=1)
        found, mirrored = self._axes, -self._axes[:, ::-1]
        to_left, to_right = (found, mirrored) if SIDE == 1 else (mirrored, found)
        side = side[:, np.newaxis, np.newaxis]
        axes = np.select([side > 0.0, side < 0.0], [to_left[box], to_right[box]], ROLLING)
        return axes.reshape(len(box), -1)


@rule("best fixed layout", "sort", actions="modules")
class BestSorting(FixedRule):
    """One layout for all entry speeds, found by `surface_gym.design` for available orientations.

    The study's box nearest to the parcel in size determines the layout. The layout sorts to y < 0,
    and its mirror image sorts to y > 0. For the exit straight ahead, the axes stay at 90 deg.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("sort",), ("modules",))
        find_axes(config)
        self._angles = np.array(config.chosen_orientations)
        self._layouts = BoxLayouts(_on_offer(self._angles), self._kind.shape)

    def _layout(self, observations: Observations) -> Commands:
        seen = self._config.decode(observations)
        axes = self._layouts.arrange(seen.half_length, seen.side)
        return axes_apart(axes[..., np.newaxis], self._angles).argmin(axis=-1)


@rule("event rule", "sort", actions="halves")
class EventRule(FixedLayout):
    """When the parcel is wholly in the zone, turn all axes from 90 to 45 deg, to the goal's side.

    If the rule did not wait, modules before the zone would hold the rear and turn the parcel. For
    the exit straight ahead, the axes stay at 90 deg.
    """

    waits = 1


@rule("fixed layout, any angle", "sort", actions="modules", orientations=ANY)
class GradedLayout(BatchController):
    """One layout for all entry speeds. The axes change gradually from column to column.

    A parcel gets the layout that `surface_gym.design` found for the study's box most similar in
    length. For the exit straight ahead, the axes stay at 90 deg.
    """

    def __init__(self, config: EnvConfig) -> None:
        checks.one_of("task", config.task_name, ("sort",))
        checks.one_of("actions", config.actions, ("modules",))
        checks.one_of("orientations", config.orientations, (ANY,))
        self._config = config
        self._shape = (len(config.features),)
        chosen = [layout for layout in sorting_layouts() if layout.offer == "any"]
        self._layouts = BoxLayouts(chosen, config.action_kind.shape)

    def _predict(self, batch: Observations, *_: Any, **__: bool) -> tuple[Any, None]:
        """Choose angles [rad]."""
        seen = self._config.decode(batch)
        return self._layouts.arrange(seen.half_length, seen.side), None


def _on_offer(angles: Numbers) -> list[SortingLayout]:
    """Choose for each box the possible layout that sorts at the lowest speed.

    A layout is possible if all its axes are among the available angles (angles,) [rad].
    """
    best: dict[str, SortingLayout] = {}
    for layout in sorted(sorting_layouts(), key=lambda layout: layout.least_speed):
        if axes_apart(layout.axis[..., np.newaxis], angles).min(axis=-1).max() <= SAME:
            best.setdefault(layout.box, layout)
    return list(best.values())


def _fit(axis: Numbers, rows: int, columns: int) -> Numbers:
    """Fit a layout (layout rows, layout columns) [rad] to a zone's `rows` and `columns`.

    The layout's middle row stays in the middle. Outer rows and last columns are repeated for a
    larger zone, and omitted for a smaller zone.
    """
    row = np.arange(rows) + (len(axis) - rows) // 2
    column = np.arange(columns)
    own = np.ix_(row.clip(0, len(axis) - 1), column.clip(0, axis.shape[1] - 1))
    return axis[own]


class ParcelRule(BaseStreamRule):
    """A rule for streams. A decision for a parcel uses only this parcel's row of the table."""

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config)
        self._shape = (config.rows, len(config.features))
        self._places = config.stream_task.max_parcels
        self._gated = config.stream_task.gate

    @abstractmethod
    def halves(self, rows: Singles) -> Integers:
        """Choose two orientations (parcels, 2) for each of the rows (parcels, features).

        Column 0 is for the modules ahead of a parcel's centre, column 1 for the modules behind it.
        """

    def _predict(self, batch: Singles, *_: Any, **__: bool) -> tuple[Integers, None]:
        num_envs = len(batch)
        rows = batch[:, : self._places].reshape(-1, batch.shape[-1])
        present = (STREAM.present.of(rows) > 0.5) & (STREAM.waits.of(rows) < 0.5)
        choices = np.full((len(rows), 2), self.choices[ROLL])
        if present.any():
            choices[present] = self.halves(rows[present])
        actions = choices.reshape(num_envs, -1)
        if self._gated:
            actions = np.pad(actions, ((0, 0), (0, 1)), constant_values=OPEN)
        return actions, None


@compiled
def choose_by_exits(tables: Singles, halves: Integers) -> None:
    """Write actions `halves` (num_envs, rows, 2) for modules ahead of and behind parcels' centres.

    A parcel rolls until its rear is past the start of its exit. Then the rule leads the parcel to
    the exit's side.
    """
    for i in range(tables.shape[0]):
        for k in range(tables.shape[1]):
            row, choice = tables[i, k], ROLL
            is_there = read(row, STREAM.present) > 0.5 and read(row, STREAM.waits) < 0.5
            side = read(row, STREAM.side)
            if is_there and side != 0.0 and read(row, STREAM.past_the_exit_s_start) > 0.0:
                choice = TO_LEFT if side > 0.0 else TO_RIGHT
            halves[i, k, 0] = halves[i, k, 1] = choice


@rule("event rule", "flow", actions="parcels")
class StreamEventRule(ParcelRule, CompiledController):
    """Turn axes under a parcel from 90 to 45 deg when the rear passes the start of the exit."""

    kernel = staticmethod(choose_by_exits)

    def halves(self, rows: Singles) -> Integers:
        found = np.zeros((1, len(rows), 2), dtype=np.int64)
        self.kernel(rows[np.newaxis], found)
        return self.choices[found[0]]

    def begin(self) -> tuple[Any, ...]:
        rows = self._shape[0]
        tables = np.zeros((1, *self._shape), dtype=np.float32)
        return tables, np.zeros((1, rows, 2), dtype=np.int64)


@rule("sort-ppo", "flow", actions="parcels")
class SortEach(ParcelRule):
    """A shipped agent of Sort, unchanged, for every parcel of a stream.

    A parcel's row of the observation begins with Sort's observation. The agent was not trained on
    parcels with an exit straight ahead. These parcels roll over axes at 90 deg.
    """

    def __init__(self, config: EnvConfig, name: str = "sort-ppo", seed: int = 0) -> None:
        super().__init__(config)
        self.name, self.policy = name, library.load(name, seed)
        self._choices = config.action_kind.choices

    def halves(self, rows: Singles) -> Integers:
        choices = np.full((len(rows), 2), self.choices[ROLL])
        aside = STREAM.side.of(rows) != 0.0
        if aside.any():
            actions, _ = self.policy.predict(rows[aside, :OWN])
            choices[aside] = np.stack(np.divmod(actions, self._choices), axis=-1)
        return choices
