"""Rules with a fixed layout for each start: layouts of the study, and optimised layouts.

As in the study, the rules choose a layout by simulation. The simulation begins at the first
observation, with nominal friction, and without noise and stuck modules.
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

SAME_SIZE = 0.005  # [m] resolution of half lengths; the study's boxes have multiples of it
# [m/s] resolution of entry speeds, rounded down so that rounding stalls no parcel
SAME_SPEED = 0.02
FINE = 0.001  # [m] resolution of positions of a loss
FAST = 6.0  # [m/s] entry speed of a run, enough to cross 16 columns at 0 deg
FAST_STEP = 0.0005  # [s] step of a fast run
STEP = 0.005  # [s] step of a run at the parcel's own speed

Row = tuple[float, ...]


def round_sizes(half_length: Numbers) -> Numbers:
    """Round half lengths (num_envs,) [m], so that one simulation serves parcels of similar size."""
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
    """Simulate a square box on a line, for twice the time to cross the line at the entry speed.

    `zone_axis` (rows, columns) [rad] are the axes of the widest zone. `zone` holds the zone's first
    and last column on the line, or is None for the default zone. `half_length` [m] and `speed`
    [m/s] are the box's half length and entry speed.
    """
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
    """Compute by how much a box's squared speed [m^2/s^2] has decreased at each place (places,).

    Places are 0, `FINE`, 2 `FINE`, ... [m] from the start. If the surface is level and the way is
    straight, the work of friction depends on the distance and not on the speed. So one run of the
    simulator gives the loss for every entry speed.

    `axes` (rows, columns) [rad] are the axes of the widest zone. `zone` holds the zone's first and
    last column on the line, or is None for the default zone.
    """
    run = _run(np.array(axes), half_length, FAST, line, zone, FAST_STEP)
    way = np.arange(0.0, line.length - half_length, FINE)
    return np.interp(way, run.pose[:, 0] - half_length, FAST**2 - run.velocity[:, 0] ** 2)


class FixedBraking(FixedRule):
    """Base class of rules that choose the best of several layouts by simulation."""

    def __init__(self, config: EnvConfig, task: str) -> None:
        super().__init__(config, (task,), ("modules",))
        self._layouts = ColumnAxes(config)(self._levels(self._kind.columns))
        shape = (len(self._layouts), *self._kind.shape)
        self._axes = np.array(config.chosen_orientations)[self._layouts].reshape(shape)

    @abstractmethod
    def _levels(self, columns: int) -> Levels:
        """List the candidate layouts as braking levels (layouts, columns)."""

    @abstractmethod
    def _regret(self, seen: LineObservation, losses: Numbers) -> Numbers:
        """Compute by how much each layout misses the goal, shape (num_envs, layouts).

        `losses` (layouts, places) [m^2/s^2] are decreases of squared speed by `loss_of_layout`.
        They hold for one parcel size. A place is a distance from the start.
        """

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
    """The study's Figures 6b and 6c: the zone's first columns brake, and the others roll.

    The braking axes are at 0 deg, or alternately at 45 and -45 deg. A simulation finds the number
    of braking columns for which the exit speed is closest to the goal.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, "slow")

    def _levels(self, columns: int) -> Levels:
        first = np.arange(columns) < np.arange(columns + 1)[:, np.newaxis]
        return np.concatenate([FULL * first, HALF * first])

    def _regret(self, seen: LineObservation, losses: Numbers) -> Numbers:
        # The rear moves from x = 0 to the zone's end.
        way = seen.pitch[0] * self._kind.columns + seen.half_length - seen.into_zone
        places = np.clip(np.round(way / FINE).astype(np.int64), 0, losses.shape[1] - 1)
        left = seen.vx[:, np.newaxis] ** 2 - losses[:, places].T
        leaves = left > 0.0
        speed = np.where(leaves, seen.vx[:, np.newaxis], 1.0)
        ratio = np.sqrt(np.maximum(0.0, left)) / speed
        return np.where(leaves, np.abs(ratio - seen.ratio[:, np.newaxis]), np.inf)


@rule("fixed layout", "stop", actions="modules")
class FixedStopping(FixedBraking):
    """The first columns roll. The other columns brake at 0 deg or alternately at 45 and -45 deg.

    A simulation finds the layout with which the parcel stops closest to the goal x.
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
    """Compute the angle [rad] of a box when its rear leaves the zone, or infinity if the box stops.

    `shape` is the widest zone's (rows, columns). In the zone's first `turning` columns, the modules
    on the left side are at 45 deg. All other modules are at 90 deg.
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
    """Turn boxes by modules on one side of the first columns. All other modules stay at 90 deg.

    Modules on the left are set to 45 deg and turn boxes to the left. Modules on the right are set
    to -45 deg and turn boxes to the right. If modules on the opposite side were at 0, -45 or
    45 deg, boxes would turn less. A simulation finds the number of columns that turns a box closest
    to the goal angle.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("orient",), ("modules",))
        axes = find_axes(config)
        rows, columns = self._kind.shape
        turning = np.arange(columns) < np.arange(columns + 1)[:, np.newaxis, np.newaxis]
        left = np.arange(rows)[:, np.newaxis] >= rows // 2
        # (layouts, modules) that turn left, and their mirror images.
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
        """Compute a box's final angles (layouts,) [rad], from half length [m] and speed [m/s]."""
        line, zone, shape = self._config.chosen_line, self._config.zone, self._kind.shape
        return np.array(
            [
                angle_at_exit(half_length, speed, line, zone, shape, turning)
                for turning in range(len(self._layouts))
            ]
        )


class _PerStart(FixedRule):
    """Base class of rules that optimise a layout for each start."""

    @abstractmethod
    def _search(self, start: Start) -> Commands:
        """Choose a layout (rows, columns) for a start."""

    def _layout(self, observations: Observations) -> Commands:
        layouts = [self._search(self._config.decode_start(seen)) for seen in observations]
        return np.stack(layouts).reshape(len(observations), -1)


class _SearchedLayout(_PerStart):
    """Base class of rules whose search begins with the candidate layouts of another rule."""

    _layouts: Commands
    _cost: search.LayoutCost

    def __init__(self, config: EnvConfig, *arguments: Any) -> None:
        super().__init__(config, *arguments)
        self._turns = find_axes(config)
        self._known = self._layouts.reshape(-1, *self._kind.shape)
        self._model = search.LayoutModel(config, max(search.LAYOUTS, len(self._known)))

    def _search(self, start: Start) -> Commands:
        self._model.begin_at(start)
        return search.search_layout(self._model, self._cost, self._turns, self._known)


def _graded(missed: int, enough: float, halves: bool = False) -> search.LayoutCost:
    return search.LayoutCost(partial(search.graded_cost, missed=missed), enough, halves)


def _stop_cost(nodes: Nodes) -> Numbers:
    parcels = nodes.parcels
    # A parcel beyond the goal x would stop this much farther at best.
    farther = (parcels.truth[:, VX] ** 2 + parcels.truth[:, VY] ** 2) / (
        2.0 * sg.tasks.base.BRAKING
    )
    passed = search.MISSED + np.abs(parcels.metrics[:, sg.tasks.stop.STOP_ERROR]) + farther
    graded = search.graded_cost(nodes, sg.tasks.stop.MISSED)
    return np.where(parcels.outcome == sg.tasks.stop.OVERSHOT, passed, graded)


@rule("best fixed layout", "slow", actions="modules", searches=True)
class BestSlowing(_SearchedLayout, FixedSlowing):
    """Optimise a layout for each start and its goal ratio; begin with layouts of `FixedSlowing`."""

    _cost = _graded(sg.tasks.slow.MISSED, 2e-4)


@rule("best fixed layout", "stop", actions="modules", searches=True)
class BestStopping(_SearchedLayout, FixedStopping):
    """Optimise a layout for each start; the search begins with the layouts of `FixedStopping`."""

    _cost = search.LayoutCost(_stop_cost, 2e-5, False)


@rule("best fixed layout", "orient", actions="modules", searches=True)
class BestTurning(_SearchedLayout, FixedTurning):
    """Optimise a layout for each start and its goal angle; begin with layouts of `FixedTurning`."""

    _cost = _graded(sg.tasks.orient.MISSED, 1e-3, True)

    def _search(self, start: Start) -> Commands:
        """Optimise a layout (rows, columns). For a right turn, mirror the layout of a left turn."""
        (angle,) = start.goal
        if float(np.asarray(angle)) >= 0.0:
            return super()._search(start)
        image = _mirror(start, 2.0 * self._config.chosen_line.line_y)
        return self._turns.mirrored(super()._search(image._replace(goal=(-np.asarray(angle),))))


@rule("best fixed layout", "track", actions="modules", searches=True, observed_task=ShownPath.of)
class BestTracking(_PerStart):
    """A layout with two orientations per column, one for each side of the path."""

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("track",), ("modules",))
        if not isinstance(config.task, search.ShownPath):
            raise ValueError(f"task must be a ShownPath, got {config.task!r}")
        if config.zone is not None:
            raise ValueError(f"zone must be None, the whole field, got {config.zone!r}")
        self._model = search.path_model(config)
        self._axes = find_axes(config)

    def _search(self, start: Start) -> Commands:
        """Choose a layout, shape (rows, columns).

        A path that first turns right is mirrored for the search, and the result is mirrored back.
        """
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
    """Mirror a start in the line's middle, at y = `across` / 2 [m]. The goal is not mirrored."""
    x, y, theta = start.pose
    vx, vy, omega = start.velocity
    return start._replace(
        pose=(x, across - np.asarray(y), -np.asarray(theta)),
        velocity=(vx, -np.asarray(vy), -np.asarray(omega)),
        path=None if start.path is None else across - start.path,
        tilt_direction=-np.asarray(start.tilt_direction),
    )
