"""Layouts arranged beforehand, for each start: those of the study, and the best there are.

They are chosen by the simulator, as the study does. They know what the sensors say of the parcel at
the start, the goal and the physics at nominal friction; not the noise, nor which modules are stuck.
"""

import math
from abc import abstractmethod
from functools import lru_cache, partial
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.physics.types import VX, VY
from surface_gym.simulation import expect_tipping
from surface_gym.tasks.planning import LineObservation, Nodes, square_reach
from surface_gym.tasks.start import Start

from ..base import Numbers, find_axes
from ..planning import layouts as search
from ..planning.layouts import ShownPath
from .base import FULL, HALF, ColumnAxes, Commands, FixedRule, Levels, Observations, rule

SAME_SIZE = 0.005  # [m] half lengths are rounded to it; those of the study's boxes are multiples
SAME_SPEED = 0.02  # [m/s] entry speeds are rounded down to it, so that none stalls for it
FINE = 0.001  # [m] between the places that a loss is known at
FAST = 6.0  # [m/s] entry speed of a run: enough to get through any layout of 16 columns at 0 deg
FAST_STEP = 0.0005  # [s] of a run, as fine as FAST is fast
STEP = 0.005  # [s] of a run at the parcel's own speed

Row = tuple[float, ...]


def round_sizes(half_length: Numbers) -> Numbers:
    """Round half lengths (num_envs,) [m], so that a run serves all parcels of about a size."""
    return SAME_SIZE * np.round(half_length / SAME_SIZE)


@expect_tipping()
def _run(
    zone_axis: Numbers,
    half_length: float,
    speed: float,
    line: sg.lines.BaseLine,
    zone: tuple[int, int] | None,
    dt: float,
) -> sg.Trajectory:
    """Run a square box along a line, long enough to cross it by rolling."""
    base = sg.Rectangle(2.0 * half_length, 2.0 * half_length)
    rotor, (first_row, rows, first, columns) = line.site(base, zone)
    margin = (len(zone_axis) - rows) // 2
    axis = np.full(rotor.shape, sg.layouts.ROLLING)
    axis[first_row : first_row + rows, first : first + columns] = zone_axis[margin : margin + rows]
    return sg.simulate(
        line.surface(axis, rotor),
        sg.Parcel(base),
        (half_length, line.line_y, 0.0),
        (speed, 0.0, 0.0),
        duration=2.0 * line.length / speed,
        dt=dt,
    )


@lru_cache(maxsize=1024)
def loss_of_layout(
    half_length: float, line: sg.lines.BaseLine, zone: tuple[int, int] | None, axes: tuple[Row, ...]
) -> Numbers:
    """Compute how much of the squared entry speed a box has lost (places,) [m^2/s^2], by the way it
    went: 0, `FINE`, 2 `FINE` ... from the start.

    On a flat surface friction takes the same work over the same way, however fast a parcel goes
    that moves straight: one run of the simulator tells what a layout does to every entry speed.

    Args:
        axes: (rows, columns) [rad] axes of the widest zone.
    """
    run = _run(np.array(axes), half_length, FAST, line, zone, FAST_STEP)
    way = np.arange(0.0, line.length - half_length, FINE)
    return np.interp(way, run.pose[:, 0] - half_length, FAST**2 - run.velocity[:, 0] ** 2)


class FixedBraking(FixedRule):
    """The layout, among some, that should do best by the simulator."""

    def __init__(self, config: EnvConfig, task: str) -> None:
        super().__init__(config, (task,), ("modules",))
        self._layouts = ColumnAxes(config)(self._levels(self._kind.columns))
        shape = (len(self._layouts), *self._kind.shape)
        self._axes = np.array(config.chosen_orientations)[self._layouts].reshape(shape)

    @abstractmethod
    def _levels(self, columns: int) -> Levels:
        """List (layouts, columns) what there is to choose from."""

    @abstractmethod
    def _regret(self, seen: LineObservation, losses: Numbers) -> Numbers:
        """Compute (num_envs, layouts) how far from the goal each leads parcels of one size."""

    def _layout(self, observations: Observations) -> Commands:
        seen = self._config.decode(observations)
        sizes = round_sizes(seen.half_length)
        best = np.zeros(len(sizes), dtype=np.int64)
        for size in np.unique(sizes).tolist():
            alike = sizes == size
            best[alike] = self._regret(seen, self._losses(size))[alike].argmin(axis=1)
        return self._layouts[best]

    def _losses(self, half_length: float) -> Numbers:
        line, zone = self._config.chosen_line, self._config.zone
        return np.stack(
            [
                loss_of_layout(half_length, line, zone, tuple(map(tuple, axes)))
                for axes in self._axes.tolist()
            ]
        )


@rule("fixed layout", "slow", actions="modules")
class FixedSlowing(FixedBraking):
    """Figure 6b and 6c: the zone's first columns at 0 deg, or at 45 and -45 deg in turn; so many
    that the parcel should leave nearest to the asked ratio.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, "slow")

    def _levels(self, columns: int) -> Levels:
        first = np.arange(columns) < np.arange(columns + 1)[:, np.newaxis]
        return np.concatenate([FULL * first, HALF * first])

    def _regret(self, seen: LineObservation, losses: Numbers) -> Numbers:
        # All the way, the rear goes from x = 0 to the zone's end.
        way = seen.pitch[0] * self._kind.columns + seen.half_length - seen.into_zone
        places = np.clip(np.round(way / FINE).astype(np.int64), 0, losses.shape[1] - 1)
        left = seen.vx[:, np.newaxis] ** 2 - losses[:, places].T
        leaves = left > 0.0
        speed = np.where(leaves, seen.vx[:, np.newaxis], 1.0)
        ratio = np.sqrt(np.maximum(0.0, left)) / speed
        return np.where(leaves, np.abs(ratio - seen.ratio[:, np.newaxis]), np.inf)


@rule("fixed layout", "stop", actions="modules")
class FixedStopping(FixedBraking):
    """The zone rolls up to a column and brakes from there on, at 0 deg or at 45 and -45 deg in
    turn; the column is the one with which the parcel should rest nearest to the asked x.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, "stop")

    def _levels(self, columns: int) -> Levels:
        later = np.arange(columns) >= np.arange(columns + 1)[:, np.newaxis]
        return np.concatenate([FULL * later, HALF * later])

    def _regret(self, seen: LineObservation, losses: Numbers) -> Numbers:
        rests = np.stack([np.searchsorted(loss, seen.vx**2) for loss in losses], axis=-1)
        return np.abs(FINE * rests - seen.to_go[:, np.newaxis])


@lru_cache(maxsize=4096)
def angle_at_exit(
    half_length: float,
    speed: float,
    line: sg.lines.BaseLine,
    zone: tuple[int, int] | None,
    shape: tuple[int, int],
    turning: int,
) -> float:
    """Compute the angle [rad] to which a box has turned when its rear leaves the zone; infinite if
    it never does.

    Args:
        shape: rows of the widest zone, and columns.
        turning: first columns of the zone whose left half is at 45 deg.
    """
    rows, columns = shape
    axis = np.full(shape, sg.layouts.ROLLING)
    axis[rows // 2 :, :turning] = math.pi / 4.0
    run = _run(axis, half_length, speed, line, zone, STEP)
    theta = run.pose[:, 2]
    reach = square_reach(half_length, theta)
    # The rear enters at x = 0; the lead-in is as long as the box, in whole columns.
    lead_in = math.ceil(2.0 * half_length / line.pitch_x - 1e-9) if zone is None else zone[0]
    gone = run.pose[:, 0] - reach > line.pitch_x * (lead_in + columns)
    return float(theta[gone.argmax()]) if gone.any() else math.inf


@rule("fixed layout", "orient", actions="modules")
class FixedTurning(FixedRule):
    """The zone's first columns at 45 deg in the half of the rows that is on the asked side, all
    others at 90 deg: as many as by the simulator leave the parcel nearest to the asked angle.

    45 deg inside and 90 outside turns farther than 0, -45 or 45 deg against one another.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("orient",), ("modules",))
        axes = find_axes(config)
        rows, columns = self._kind.shape
        turning = np.arange(columns) < np.arange(columns + 1)[:, np.newaxis, np.newaxis]
        left = np.arange(rows)[:, np.newaxis] >= rows // 2
        # (layouts, modules) to turn left, and their mirror images.
        self._layouts = np.where(turning & left, axes.right, axes.roll).reshape(columns + 1, -1)
        self._to_right = np.where(turning & ~left, axes.left, axes.roll).reshape(columns + 1, -1)

    def _layout(self, observations: Observations) -> Commands:
        seen = self._config.decode(observations)
        speeds = np.maximum(SAME_SPEED, SAME_SPEED * np.floor(seen.vx / SAME_SPEED))
        cases, case = np.unique(
            np.stack([round_sizes(seen.half_length), speeds], axis=-1), axis=0, return_inverse=True
        )
        angles = np.stack([self._angles(*case) for case in cases.tolist()])[case.ravel()]
        best = np.abs(angles - np.abs(seen.angle)[:, np.newaxis]).argmin(axis=1)
        left = (seen.angle > 0.0)[:, np.newaxis]
        return np.where(left, self._layouts[best], self._to_right[best])

    def _angles(self, half_length: float, speed: float) -> Numbers:
        """Compute (layouts,) [rad] the angle that each turns a box of a size and a speed to."""
        line, zone, shape = self._config.chosen_line, self._config.zone, self._kind.shape
        return np.array(
            [
                angle_at_exit(half_length, speed, line, zone, shape, turning)
                for turning in range(len(self._layouts))
            ]
        )


class _Searched(FixedRule):
    """Layouts that are searched for each start, from known ones (layouts, modules) on."""

    _layouts: Commands
    _cost: search.LayoutCost

    def __init__(self, config: EnvConfig, *arguments: Any) -> None:
        super().__init__(config, *arguments)
        self._turns = find_axes(config)
        self._known = self._layouts.reshape(-1, *self._kind.shape)
        self._model = search.LayoutModel(config, max(search.LAYOUTS, len(self._known)))

    def _layout(self, observations: Observations) -> Commands:
        layouts = [self._search(self._config.decode_start(seen)) for seen in observations]
        return np.stack(layouts).reshape(len(observations), -1)

    def _search(self, start: Start) -> Commands:
        """Choose (rows, columns)."""
        self._model.begin_at(start)
        return search.search_layout(self._model, self._cost, self._turns, self._known)


def _graded(missed: int, enough: float, halves: bool = False) -> search.LayoutCost:
    return search.LayoutCost(partial(search.graded_cost, missed=missed), enough, halves)


def _stop_cost(nodes: Nodes) -> Numbers:
    parcels = nodes.parcels
    # One that has passed the asked x would rest this much farther at best.
    farther = (parcels.truth[:, VX] ** 2 + parcels.truth[:, VY] ** 2) / (
        2.0 * sg.tasks.base.BRAKING
    )
    passed = search.MISSED + np.abs(parcels.metrics[:, sg.tasks.stop.STOP_ERROR]) + farther
    graded = search.graded_cost(nodes, sg.tasks.stop.MISSED)
    return np.where(parcels.outcome == sg.tasks.stop.OVERSHOT, passed, graded)


@rule("best fixed layout", "slow", actions="modules", searches=True)
class BestSlowing(_Searched, FixedSlowing):
    """Layouts from those of `FixedSlowing` on, searched module by module for the asked ratio."""

    _cost = _graded(sg.tasks.slow.MISSED, 2e-4)


@rule("best fixed layout", "stop", actions="modules", searches=True)
class BestStopping(_Searched, FixedStopping):
    """Layouts from those of `FixedStopping` on, searched module by module for the asked x."""

    _cost = search.LayoutCost(_stop_cost, 2e-5, False)


@rule("best fixed layout", "orient", actions="modules", searches=True)
class BestTurning(_Searched, FixedTurning):
    """Layouts from those of `FixedTurning` on, searched module by module for the asked angle."""

    _cost = _graded(sg.tasks.orient.MISSED, 1e-3, True)

    def _search(self, start: Start) -> Commands:
        """Search for turns to the left; others are searched in a mirror."""
        (angle,) = start.goal
        if float(np.asarray(angle)) >= 0.0:
            return super()._search(start)
        image = _mirror(start, 2.0 * self._config.chosen_line.line_y)
        return self._turns.mirrored(super()._search(image._replace(goal=(-np.asarray(angle),))))


@rule("best fixed layout", "track", actions="modules", searches=True, observed_task=ShownPath.of)
class BestTracking(FixedRule):
    """Two axes a column of the field, one left and one right of the path, so that the parcel should
    follow it at the asked speed.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("track",), ("modules",))
        if not isinstance(config.task, search.ShownPath):
            raise ValueError(f"task must be a ShownPath, got {config.task!r}")
        if config.zone is not None:
            raise ValueError(f"zone must be None, the whole field, got {config.zone!r}")
        self._model = search.path_model(config)
        self._axes = find_axes(config)

    def _layout(self, observations: Observations) -> Commands:
        layouts = [self._search(self._config.decode_start(seen)) for seen in observations]
        return np.stack(layouts).reshape(len(observations), -1)

    def _search(self, start: Start) -> Commands:
        """Choose (rows, columns); paths that first turn to the right are searched in a mirror."""
        assert start.path is not None
        aside = start.path - start.path[0]
        if aside[np.argmax(np.abs(aside) > 1e-6)] >= 0.0:
            return self._best(start)
        image = _mirror(start, 2.0 * self._config.chosen_line.line_y)
        return self._axes.mirrored(self._best(image))

    def _best(self, start: Start) -> Commands:
        limit = self._config.task.periods * self._config.control_period
        return search.search_path_layout(self._model, self._axes, start, limit)


def _mirror(start: Start, across: float) -> Start:
    """Mirror a start in the line's middle, all but its goal."""
    x, y, theta = start.pose
    vx, vy, omega = start.velocity
    return start._replace(
        pose=(x, across - np.asarray(y), -np.asarray(theta)),
        velocity=(vx, -np.asarray(vy), -np.asarray(omega)),
        path=None if start.path is None else across - start.path,
    )
