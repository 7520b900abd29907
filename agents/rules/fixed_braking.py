"""Slow and Stop by the best layout arranged beforehand, found as the study does: by simulation.

On a flat surface friction takes the same work over the same way, however fast a parcel goes that
moves straight: one run of the simulator tells what a layout does to every entry speed.
"""

from abc import abstractmethod
from functools import lru_cache

import numpy as np

from surface_gym.lines import BaseLine
from surface_gym.settings import Settings

from ..sight import LineSight, line_sight
from .columns import FULL, HALF, ColumnAxes, Levels
from .lane_rule import Commands, FixedRule, Numbers, Observations
from .trial import run_over, sizes_of

FINE = 0.001  # [m] between the places that a loss is known at
FAST = 6.0  # [m/s] entry speed of a run: enough to get through any layout of 16 columns at 0 deg
STEP = 0.0005  # [s] of a run, as fine as FAST is fast

Row = tuple[float, ...]


@lru_cache(maxsize=1024)
def loss_of_layout(
    half_length: float, site_plan: BaseLine, zone: tuple[int, int] | None, axes: tuple[Row, ...]
) -> Numbers:
    """(places,) [m^2/s^2] how much of the squared entry speed a box has lost, by the way it went.

    Args:
        half_length: [m] of the box, a square.
        site_plan: the plant.
        zone: first and last column that obey; None for the plant's own.
        axes: (rows, columns) [rad] axes of the widest zone.

    Returns:
        The loss 0, `FINE`, 2 `FINE` ... from the start.
    """
    run = run_over(np.array(axes), half_length, FAST, site_plan, zone, STEP)
    way = np.arange(0.0, site_plan.length - half_length, FINE)
    loss: Numbers = np.interp(way, run.pose[:, 0] - half_length, FAST**2 - run.velocity[:, 0] ** 2)
    return loss


class FixedBraking(FixedRule):
    """The layout, among some, that would do best by the simulator."""

    def __init__(self, settings: Settings, task: str) -> None:
        super().__init__(settings, (task,), ("modules",))
        self._layouts = ColumnAxes(settings)(self._levels(self._kind.columns))
        shape = (len(self._layouts), *self._kind.shape)
        self._axes = np.array(settings.chosen_orientations)[self._layouts].reshape(shape)

    @abstractmethod
    def _levels(self, columns: int) -> Levels:
        """(layouts, columns) that there are to choose from."""

    @abstractmethod
    def _regret(self, see: LineSight, losses: Numbers) -> Numbers:
        """(lanes, layouts) how far from the goal each leads parcels of one size.

        Args:
            see: the parcels at their starts, their rears at x = 0.
            losses: (layouts, places) by `loss_of_layout`.
        """

    def _layout(self, observations: Observations) -> Commands:
        see = line_sight(self._settings, observations)
        sizes = sizes_of(see.half_length)
        best = np.zeros(len(sizes), dtype=np.int64)
        for size in np.unique(sizes).tolist():
            lanes = sizes == size
            best[lanes] = self._regret(see, self._losses(size))[lanes].argmin(axis=1)
        return self._layouts[best]

    def _losses(self, half_length: float) -> Numbers:
        plan, zone = self._settings.chosen_plant, self._settings.zone
        return np.stack(
            [
                loss_of_layout(half_length, plan, zone, tuple(map(tuple, axes)))
                for axes in self._axes.tolist()
            ]
        )


class FixedSlowing(FixedBraking):
    """Figure 6b and 6c: the zone's first columns at 0 deg, or at 45 and -45 deg in turn; so many
    that the parcel should leave nearest to the asked ratio.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, "slow")

    def _levels(self, columns: int) -> Levels:
        first = np.arange(columns) < np.arange(columns + 1)[:, np.newaxis]
        return np.concatenate([FULL * first, HALF * first])

    def _regret(self, see: LineSight, losses: Numbers) -> Numbers:
        # All the way, the rear goes from x = 0 to the zone's end.
        way = see.pitch[0] * self._kind.columns + see.half_length - see.into_zone
        places = np.clip(np.round(way / FINE).astype(np.int64), 0, losses.shape[1] - 1)
        left = see.vx[:, np.newaxis] ** 2 - losses[:, places].T
        leaves = left > 0.0
        speed = np.where(leaves, see.vx[:, np.newaxis], 1.0)
        ratio = np.sqrt(np.maximum(0.0, left)) / speed
        return np.where(leaves, np.abs(ratio - see.ratio[:, np.newaxis]), np.inf)


class FixedStopping(FixedBraking):
    """The zone rolls up to a column and brakes from there on, at 0 deg or at 45 and -45 deg in
    turn; the column is the one with which the parcel should rest nearest to the asked x.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, "stop")

    def _levels(self, columns: int) -> Levels:
        later = np.arange(columns) >= np.arange(columns + 1)[:, np.newaxis]
        return np.concatenate([FULL * later, HALF * later])

    def _regret(self, see: LineSight, losses: Numbers) -> Numbers:
        rests = np.stack([np.searchsorted(loss, see.vx**2) for loss in losses], axis=-1)
        return np.abs(FINE * rests - see.to_go[:, np.newaxis])
