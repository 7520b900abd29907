"""Rules of Sort: fixed layouts, and a rule with one event."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.actions import ANY
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.design.fixed_layout import SIDE, SortingLayout, sorting_layouts
from surface_gym.layouts import ROLLING

from ..base import SAME, BatchController, Integers, Numbers, Singles, axes_apart, find_axes
from .base import Commands, CompiledRule, FixedRule, Observations, rule
from .decoding import Sight, look_at_line, see_line


@compiled
def choose_by_side(
    observations: Singles, sight: Sight, axes: Integers, waits: int, commands: Integers
) -> None:
    """Choose 45 deg towards the goal side; if `waits`, 90 deg before the parcel is in the zone."""
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
    """Figure 6a: fixed axes at -45 deg sort to y > 0, and at +45 deg to y < 0.

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

    A longer zone repeats the last column of a layout; a shorter zone has its first columns.
    """

    def __init__(self, layouts: Sequence[SortingLayout], shape: tuple[int, int]) -> None:
        self._half_lengths = np.array([layout.half_length for layout in layouts])
        self._axes = np.stack([_fit(layout.axis, *shape) for layout in layouts])

    def arrange(self, half_length: Numbers, side: Numbers) -> Numbers:
        """Choose axes (num_envs, modules) [rad] of the box with the closest size, for a side.

        Args:
            side: (num_envs,) +1 for y > 0, -1 for y < 0, 0 for straight through.
        """
        box = np.abs(half_length[:, np.newaxis] - self._half_lengths).argmin(axis=1)
        found, mirrored = self._axes, -self._axes[:, ::-1]
        to_left, to_right = (found, mirrored) if SIDE == 1 else (mirrored, found)
        side = side[:, np.newaxis, np.newaxis]
        axes = np.select([side > 0.0, side < 0.0], [to_left[box], to_right[box]], ROLLING)
        return axes.reshape(len(box), -1)


@rule("best fixed layout", "sort", actions="modules")
class BestSorting(FixedRule):
    """One layout for all entry speeds, found by `surface_gym.design` among the orientations.

    It is the layout for the study's box with the closest size. It sorts to y < 0; its mirror image
    sorts to y > 0. For the exit straight ahead, the axes stay at 90 deg.
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
    """90 deg until the parcel is wholly in the zone, then 45 deg everywhere.

    A lead-in module under the rear holds it while the zone pushes the front aside, which limits the
    fixed layout. For the exit straight ahead, the axes stay at 90 deg.
    """

    waits = 1


@rule("fixed layout, any angle", "sort", actions="modules", orientations=ANY)
class GradedLayout(BatchController):
    """One layout for all entry speeds with axes that change gradually from column to column.

    It is found by `surface_gym.design` for the study's box with the closest size. For the exit
    straight ahead, the axes stay at 90 deg.
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
    """Choose the layout of each box that sorts at the lowest speed.

    All axes of a layout must be among the available angles (angles,) [rad].
    """
    best: dict[str, SortingLayout] = {}
    for layout in sorted(sorting_layouts(), key=lambda layout: layout.least_speed):
        if axes_apart(layout.axis[..., np.newaxis], angles).min(axis=-1).max() <= SAME:
            best.setdefault(layout.box, layout)
    return list(best.values())


def _fit(axis: Numbers, rows: int, columns: int) -> Numbers:
    """Fit a layout (layout rows, layout columns) [rad] to a zone with the same middle row."""
    row = np.arange(rows) + (len(axis) - rows) // 2
    column = np.arange(columns)
    own = np.ix_(row.clip(0, len(axis) - 1), column.clip(0, axis.shape[1] - 1))
    return axis[own]
