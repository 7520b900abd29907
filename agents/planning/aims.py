"""What the planner looks for, by task: what a lane on its way may come to, what an end is worth.

Costs, the lower the better. Weights were found by trying.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.layouts import ROLLING
from surface_gym.state import PATH_POINTS, SUCCESS, ParcelState
from surface_gym.tasks import TASKS, orient, slow, sort, stop, track

from .branching import Branching
from .stand import Stand

Numbers = NDArray[np.float64]

FAILED = 1e3  # cost of a failure, beyond that of any success
SETTLING = 0.05  # [s] a turning speed goes on for until it is taken back
ARRIVAL = 3.2  # [s] in which Slow is to be over, of 4
EXIT_SPEED = 0.1  # [m/s] Orient is to leave the zone with
CAUTION = 0.5  # [-] of the time of a quarter turn, that Stop keeps to be on the safe side
TURN_LOSS = 2.5  # [m/s^2] of a turn, times the half length: what a radian takes of v^2 / 2
# Track: errors that are as bad as each other.
CROSS_ERROR = 0.003  # [m] off the path
SPEED_ERROR = 0.08  # [m/s] off the asked speed
CROSS_SPEED = 0.09  # [m/s] across the path at the horizon


@dataclass(frozen=True)
class Aim:
    """What a search prefers."""

    way: Callable[[Stand], Numbers]  # cost of lanes on their way
    end: Callable[[Stand], Numbers]  # cost of lanes that have ended, or are at the horizon
    enough: float  # cost of an end that ends the search
    horizon: int  # periods looked ahead
    follow: int  # periods of a plan that are followed at most
    share: int = 1  # of the planner's budget that a search gets: 1 in so many
    # Two actions; each time to change from the first to the second for good is tried. Or None.
    event: Callable[[Branching], tuple[int, int] | None] = lambda _: None


def _rear_to_go(stand: Stand) -> Numbers:
    """[m] from the rear to the zone's end, at least 0."""
    _, _, first, columns = stand.zone
    end = stand.plant.column_edge(first + columns)
    return np.maximum(0.0, end - stand.parcels.truth[:, 0] + stand.reach(-1.0, 0.0))


def _off_line(stand: Stand) -> Numbers:
    """[m] from the line's middle."""
    return np.abs(stand.parcels.truth[:, 1] - stand.plant.line_y)


def _askew(stand: Stand) -> Numbers:
    """How far from straight along the line."""
    _, _, theta, _, vy, omega = stand.parcels.truth.T
    return _off_line(stand) + np.abs(vy) + np.abs(theta) + SETTLING * np.abs(omega)


def _failure(stand: Stand) -> Numbers:
    return np.where(stand.parcels.outcome == SUCCESS, 0.0, FAILED)


def _time(stand: Stand) -> Numbers:
    """[s] until the end."""
    return _failure(stand) + stand.parcels.clock


def _error(stand: Stand) -> Numbers:
    """The task's first figure."""
    return _failure(stand) + np.abs(stand.parcels.metrics[:, 0])


def _sort_way(stand: Stand) -> Numbers:
    """[s] until the parcel is off the line if all axes were at 45 deg from now on; and what it
    lacks where it would come to rest before.
    """
    _, y, _, vx, vy, _ = stand.parcels.truth.T
    turning, loss = stand.braking / math.sqrt(2.0), stand.rolling_loss / math.sqrt(2.0)
    side = stand.parcels.goal[:, sort.SIDE]
    if side[0] == 0.0:
        return _off_line(stand) - 0.1 * stand.parcels.truth[:, 0]
    vy = side * vy
    half_line = 0.5 * stand.plant.pitch_y * (stand.zone[1] - 1)
    left = stand.reach(0.0, -side[0]) + half_line - side * (y - stand.plant.line_y)
    left = np.maximum(0.0, left)
    kept = np.maximum(0.0, np.where(vx > vy, 0.5 * (vx + vy), vy))
    vy = np.clip(vy, 0.0, kept)
    turned_after = (kept - vy) / turning
    while_turning = 0.5 * (kept + vy) * turned_after
    at_once = (np.sqrt(vy**2 + 2.0 * turning * left) - vy) / turning
    square = kept**2 - 2.0 * loss * np.maximum(0.0, left - while_turning)
    later = turned_after + (kept - np.sqrt(np.maximum(0.0, square))) / loss
    return np.where(left < while_turning, at_once, later) + FAILED * np.maximum(0.0, -square)


def _sort_event(model: Branching) -> tuple[int, int] | None:
    """The fixed layout and every event rule: 45 deg to the asked side from some time on."""
    side = float(model.parcels.goal[0, sort.SIDE])
    if side == 0.0:
        return None
    return model.uniform_action(ROLLING), model.uniform_action(-side * math.pi / 4.0)


def _slow_way(stand: Stand) -> Numbers:
    """[m/s] off what would roll out at the asked ratio, straight and in time."""
    lanes, to_go = stand.parcels, _rear_to_go(stand)
    speed = np.hypot(stand.vx, lanes.truth[:, 4])
    asked = lanes.goal[:, slow.RATIO] * lanes.goal[:, slow.ENTRY_SPEED]
    excess = speed - np.sqrt(asked**2 + 2.0 * stand.rolling_loss * to_go)
    late = np.maximum(0.0, lanes.clock + to_go / np.maximum(speed, 1e-3) - ARRIVAL)
    return np.abs(excess) + 2.0 * late + _askew(stand)


def _stop_way(stand: Stand) -> Numbers:
    """[m] that full braking ends short of the asked x; beyond it there is no way back."""
    to_go = stand.parcels.goal[:, stop.POSITION] - stand.parcels.truth[:, 0]
    short = to_go - stand.braking_way
    if stand.turning is None:
        return _short_of(short) + 0.1 * _askew(stand)
    # Axes push aside while they turn, which takes some of the braking; and what they will have
    # taken before they roll again may be too much.
    short -= CAUTION * stand.turning.quarter * stand.parcels.truth[:, 3]
    rolled = stand.vx**2 / (2.0 * stand.rolling_loss)
    lack = np.maximum(0.0, to_go - rolled)
    return _short_of(short) + 10.0 * lack + 0.3 * _askew(stand)


def _short_of(short: Numbers) -> Numbers:
    """[m] short of the asked x, or what is as bad past it."""
    return np.where(short < 0.0, -10.0 * short, short)


def _orient_way(stand: Stand) -> Numbers:
    """[rad] left to turn; with speed enough to turn it and to leave the zone, and on the line."""
    _, _, theta, _, vy, omega = stand.parcels.truth.T
    vx = stand.vx
    left = np.abs(stand.parcels.goal[:, orient.ANGLE] - theta - SETTLING * omega)
    spent = stand.rolling_loss * _rear_to_go(stand) + TURN_LOSS * stand.half_length * left
    lack = np.maximum(0.0, np.sqrt(EXIT_SPEED**2 + 2.0 * spent) - vx)
    return left + lack - 0.2 * vx + 0.2 * _off_line(stand) + 0.06 * np.abs(vy)


def _track_way(stand: Stand) -> Numbers:
    """Mean squares of the errors so far, each over what is as bad, and where they lead."""
    lanes = stand.parcels
    since = np.maximum(lanes.clock, 1e-9)
    off = lanes.memory[:, track.SQUARED_ERROR] / since / CROSS_ERROR**2
    pace = lanes.memory[:, track.SQUARED_SPEED_ERROR] / since / SPEED_ERROR**2
    lost = np.where(lanes.outcome > SUCCESS, FAILED**2, 0.0)
    return off + pace + (_speed_across(lanes) / CROSS_SPEED) ** 2 + lost


def _speed_across(lanes: ParcelState) -> Numbers:
    """[m/s] across the path."""
    x, _, _, vx, vy, _ = lanes.truth.T
    # A search's lanes have their path in common.
    first, step = lanes.goal[0, track.FIRST_X], lanes.goal[0, track.STEP_X]
    piece = np.clip((x - first) / step, 0.0, PATH_POINTS - 2.0).astype(np.int64)
    slope = np.diff(lanes.path[0])[piece] / step
    across: Numbers = (vy - slope * vx) / np.sqrt(1.0 + slope**2)
    return across


_LIMIT = {name: task.periods for name, task in TASKS.items()}
AIMS = {
    "sort": Aim(_sort_way, _time, FAILED, _LIMIT["sort"], _LIMIT["sort"], event=_sort_event),
    "slow": Aim(_slow_way, _error, 2e-4, _LIMIT["slow"], _LIMIT["slow"]),
    "stop": Aim(_stop_way, _error, 2e-5, _LIMIT["stop"], _LIMIT["stop"]),
    "orient": Aim(_orient_way, _error, 1e-3, _LIMIT["orient"], _LIMIT["orient"]),
    "track": Aim(_track_way, _track_way, 0.0, horizon=8, follow=2, share=4),
}
