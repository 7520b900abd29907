"""Sort by the best fixed layout there is, found by search beforehand."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surface_gym.design.sorting_layouts import SIDE, SortingLayout, sorting_layouts
from surface_gym.settings import Settings

from ..angles import SAME, axes_apart
from ..sight import line_sight
from .axes import axes_of
from .lane_rule import Commands, FixedRule, Numbers, Observations


class BestSorting(FixedRule):
    """One layout for all entry speeds: the one that `surface_gym.design` found for the study's box
    that is nearer in size, among the orientations on offer. It sorts to y < 0; mirrored, to y > 0.

    Straight through, the axes stay at 90 deg.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("sort",), ("modules",))
        axes = axes_of(settings)
        angles = np.array(settings.chosen_orientations)
        layouts = BoxLayouts(_on_offer(angles), self._kind.shape)
        self._nearest = layouts.nearest
        # (boxes, modules) to either side.
        self._to_side = {side: _choices(layouts.to_side(side), angles) for side in (1, -1)}
        self._roll = axes.roll

    def _layout(self, observations: Observations) -> Commands:
        see = line_sight(self._settings, observations)
        box = self._nearest(see.half_length)
        side = see.side[:, np.newaxis]
        return np.select(
            [side > 0.0, side < 0.0], [self._to_side[1][box], self._to_side[-1][box]], self._roll
        )


class BoxLayouts:
    """Layouts of the study's boxes on a zone, to either side.

    A longer zone goes on like a layout's last column, a shorter one has its first columns.

    Args:
        layouts: one of each box.
        shape: rows and columns of the zone.
    """

    def __init__(self, layouts: Sequence[SortingLayout], shape: tuple[int, int]) -> None:
        self._half_lengths = np.array([layout.half_length for layout in layouts])
        self._axes = np.stack([_fitted(layout.axis, *shape) for layout in layouts])

    def nearest(self, half_length: Numbers) -> NDArray[np.int64]:
        """(lanes,) the box nearest in size to half lengths (lanes,) [m]."""
        apart = np.abs(half_length[:, np.newaxis] - self._half_lengths)
        return np.asarray(apart.argmin(axis=1))

    def to_side(self, side: int) -> Numbers:
        """(boxes, modules) [rad] axes; to the other side than they were found for, mirrored."""
        axes = self._axes if side == SIDE else -self._axes[:, ::-1]
        return axes.reshape(len(axes), -1)


def _on_offer(angles: Numbers) -> list[SortingLayout]:
    """For each box the layout that sorts it at the least speed, of those whose axes are all on
    offer (some,) [rad].
    """
    best: dict[str, SortingLayout] = {}
    for layout in sorted(sorting_layouts(), key=lambda layout: layout.least_speed):
        if axes_apart(layout.axis[..., np.newaxis], angles).min(axis=-1).max() <= SAME:
            best.setdefault(layout.box, layout)
    return list(best.values())


def _fitted(axis: Numbers, rows: int, columns: int) -> Numbers:
    """A layout (its rows, its columns) [rad] on a zone whose middle row is the layout's."""
    row = np.arange(rows) + (len(axis) - rows) // 2
    column = np.arange(columns)
    own = np.ix_(row.clip(0, len(axis) - 1), column.clip(0, axis.shape[1] - 1))
    fitted: Numbers = axis[own]
    return fitted


def _choices(axis: Numbers, angles: Numbers) -> NDArray[np.int64]:
    """The orientations (some,) [rad] nearest to axes (...) [rad], by their places."""
    nearest: NDArray[np.int64] = axes_apart(axis[..., np.newaxis], angles).argmin(axis=-1)
    return nearest
