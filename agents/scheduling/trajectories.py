"""Trajectories of parcels that are alone on a line, and minimum gaps. A gap is the time between the
entries of two parcels. Moments are the times 0, DT, 2 DT, ... [s] since a parcel's entry.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import surface_gym as sg
from surface_gym.compiler.jit import compiled, inlined
from surface_gym.config import EnvConfig
from surface_gym.flow import arrivals
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import COLUMN
from surface_gym.state import RUNNING

from ..base import Booleans, Integers, Numbers, Singles

DT = 0.005  # [s] between the times at which bases are compared
LONGEST = 20.0  # [s] longest gap to try
SPEED_STEP = 0.1  # [m/s] maximum step between the speeds of a stream with variable speed
SIGNATURE = tuple(  # columns that identify a waiting parcel
    each.place
    for each in (
        COLUMN.forward_speed, COLUMN.size, COLUMN.past_the_exit_s_start, COLUMN.side, COLUMN.width,
        COLUMN.to_the_exit_s_end,
    )
)  # fmt: skip

Asked = tuple[sg.Parcel, float, str]  # a parcel, its speed [m/s] and its exit's name


def list_speeds(config: EnvConfig) -> tuple[list[float], float]:
    """Return typical speeds [m/s], and the largest distance [m/s] of any speed to the nearest."""
    speeds = config.stream_task.stream.speeds
    if not isinstance(speeds, tuple):
        return [speeds], 0.0
    low, high = speeds
    count = max(1, math.ceil((high - low) / SPEED_STEP - 1e-9))
    half = 0.5 * (high - low) / count
    return [round(low + half * (2 * k + 1), 9) for k in range(count)], half


def list_asked(config: EnvConfig) -> list[Asked]:
    """List all combinations of parcel, speed and exit in a stream; variable speeds are sampled."""
    stream = config.stream_task.stream
    if isinstance(stream.arrivals, arrivals.Trace):
        return list(dict.fromkeys((a.parcel, a.speed, a.exit) for a in stream.arrivals.arrivals))
    speeds, _ = list_speeds(config)
    named = stream.destinations or [(name, 1.0) for name in config.exits.names]
    return [
        (parcel, speed, name) for parcel in stream.kinds for speed in speeds for name, _ in named
    ]


@dataclass(frozen=True, eq=False)
class LoneRuns:
    """Runs of single parcels on a line."""

    pose: Numbers  # (runs, moments, 3) [m, m, rad] poses of the centroid every DT from entry
    moments: Integers  # (runs,) number of moments until departure
    outline: Numbers  # (runs, corners, 2) [m] corners from the centroid, padded with the last one
    correct: Booleans  # (runs,) whether it departed by its own exit
    signature: Numbers  # (runs, features) features that identify the waiting parcel

    def pick(self, chosen: Booleans) -> "LoneRuns":
        """Return the runs selected by a mask (runs,)."""
        return LoneRuns(*(values[chosen] for values in vars(self).values()))


def run_alone(
    act: Callable[[Singles], Integers],
    config: EnvConfig,
    asked: Sequence[Asked],
    opens: Integers,
    seeds: Sequence[int],
) -> LoneRuns:
    """Run each parcel in `asked` alone on a line with a gate.

    Args:
        act: function from observations (runs, rows, features) to actions (runs, size). The actions
            lack the entry that opens the gate.
        opens: (runs,) physics step, within the first control period, at which the parcel enters.
        seeds: (runs,) seeds of all random draws.
    """
    streams = [Stream(arrivals.Trace((arrivals.Arrival(0.0, *one),))) for one in asked]
    alone = config.replace(max_parcels=1, gate=True, queue=1, stream=streams[0])
    count = len(asked)
    batch = StreamBatch(alone, count)
    for i, seed in enumerate(seeds):
        batch.seed(i, np.random.default_rng(seed))
    batch.reset(np.arange(count), [{"stream": stream} for stream in streams])
    signature = batch.observation[:, -1, SIGNATURE].astype(np.float64)

    def poses(row: int) -> Numbers:
        return batch.parcels.truth.reshape(count, -1, 6)[:, row, :3].copy()

    outlines = [batch.parcel(i, 1).base for i in range(count)]
    times, found = [np.zeros(count)], [poses(1)]
    while (batch.outcome == RUNNING).any() and np.isnan(batch.streams.departed[:, 0]).any():
        action = np.concatenate([act(batch.observation), opens[:, np.newaxis]], axis=1)
        batch.step(alone.action_kind.commands(action, count))
        times.append(batch.streams.clock.copy())
        found.append(poses(0))
    state = batch.streams
    entered, departed = state.entered[:, 0], state.departed[:, 0]
    time, pose = np.array(times), np.array(found)
    each = [_sample(time[:, i], pose[:, i], entered[i], departed[i]) for i in range(count)]
    corners = [base.outline - np.array(base.centroid) for base in outlines]
    return LoneRuns(
        _padded(each), np.array([len(one) for one in each]), _padded(corners),
        state.tally[:, CORRECT] > 0, signature,
    )  # fmt: skip


def _sample(time: Numbers, pose: Numbers, entered: float, departed: float) -> Numbers:
    """Interpolate the poses (moments, 3) at all moments between entry and departure.

    `pose` (samples, 3) was sampled at `time` (samples,) [s]. `entered` and `departed` [s] are the
    parcel's times of entry and departure. If the parcel is still on the line, `departed` is NaN.
    """
    departed = time[-1] if np.isnan(departed) else departed
    inside = np.concatenate([[True], (time[1:] > entered) & (time[1:] < departed)])
    last = min(int(np.searchsorted(time, departed)), len(time) - 1)
    moment = np.concatenate([[0.0], time[inside][1:] - entered, [departed - entered]])
    corner = np.vstack([pose[inside], pose[last]])
    wanted = DT * np.arange(math.floor((departed - entered) / DT) + 1)
    return np.stack([np.interp(wanted, moment, column) for column in corner.T], axis=1)


def _padded(arrays: Sequence[Numbers]) -> Numbers:
    """Stack arrays (rows, columns). A short array is padded with copies of the array's last row."""
    most = max(map(len, arrays))
    return np.stack([np.pad(one, ((0, most - len(one)), (0, 0)), "edge") for one in arrays])


@inlined
def _reach(outline: Numbers, pose: Numbers, x: float, y: float) -> float:
    """Return the smallest coordinate [m] of a base's corners along a direction (x, y).

    `outline` (corners, 2) [m] is relative to the base's centroid; `pose` is [m, m, rad].
    """
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    least = np.inf
    for k in range(outline.shape[0]):
        across = (cosine * outline[k, 0] - sine * outline[k, 1] + pose[0]) * x
        least = min(least, across + (sine * outline[k, 0] + cosine * outline[k, 1] + pose[1]) * y)
    return least


@inlined
def _separated(
    one: Numbers, pose: Numbers, other: Numbers, other_pose: Numbers, margin: float
) -> bool:
    """Return whether base `other` lies at least `margin` [m] beyond a side of base `one`.

    Bases are outlines (corners, 2) [m] relative to their centroids, with poses [m, m, rad].
    """
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for k in range(one.shape[0]):
        after = k + 1 if k + 1 < one.shape[0] else 0
        along, across = one[after, 0] - one[k, 0], one[after, 1] - one[k, 1]
        length = math.hypot(along, across)
        if length == 0.0:
            continue
        x = (cosine * across + sine * along) / length
        y = (sine * across - cosine * along) / length
        corner_x = cosine * one[k, 0] - sine * one[k, 1] + pose[0]
        corner_y = sine * one[k, 0] + cosine * one[k, 1] + pose[1]
        if _reach(other, other_pose, x, y) - corner_x * x - corner_y * y >= margin:
            return True
    return False


class TimedRuns(NamedTuple):
    """Runs of parcels (see `LoneRuns`), and the orientations of the modules under the parcels."""

    pose: Numbers  # (parcels, moments, 3)
    moments: Integers  # (parcels,)
    outline: Numbers  # (parcels, corners, 2)
    reach: Numbers  # (parcels,) [m] distance from the centroid to the farthest corner
    choice: Integers  # (parcels, moments) orientation of the modules under the parcel


@inlined
def _is_clear(
    ahead: TimedRuns, i: int, behind: TimedRuns, j: int, gap: int, margin: float, late: int
) -> bool:
    """Return whether parcel `j`, which enters `gap` moments after `i`, keeps clear of parcel `i`.

    `margin` [m] is the least distance. If the parcels need a module at different orientations,
    parcel `j` must reach the module at least `late` moments after parcel `i` leaves the module.
    """
    far = ahead.reach[i] + behind.reach[j]
    for k in range(max(0, gap - late), min(ahead.moments[i], gap + behind.moments[j])):
        for shift in range(0 if k >= gap else late, late + 1, max(1, late)):
            other = k - gap + shift
            if other >= behind.moments[j] or (
                shift > 0 and ahead.choice[i, k] == behind.choice[j, other]
            ):
                continue
            one_pose, other_pose = ahead.pose[i, k], behind.pose[j, other]
            apart = margin if shift == 0 else 0.0
            x, y = one_pose[0] - other_pose[0], one_pose[1] - other_pose[1]
            if x * x + y * y < (far + apart) ** 2 and not (
                _separated(ahead.outline[i], one_pose, behind.outline[j], other_pose, apart)
                or _separated(behind.outline[j], other_pose, ahead.outline[i], one_pose, apart)
            ):
                return False
    return True


@compiled
def find_gaps(
    ahead: TimedRuns, behind: TimedRuns, margin: float, late: float, gaps: Numbers
) -> None:
    """Raise the gaps (parcels, parcels) [s] so that parcels `behind` keep clear of `ahead`.

    In `gaps`, a row stands for a parcel ahead, and a column stands for a parcel behind. At the
    resulting gap and all larger gaps, the two parcels are at least `margin` [m] apart at all
    moments (tested with separating axes). If no gap suffices, the gap is infinite. If a module
    must turn between the two parcels, the parcel behind reaches the module at least `late` [s]
    after the parcel ahead has passed the module.
    """
    shift = math.ceil(late / DT - 1e-6)
    for i in range(gaps.shape[0]):
        for j in range(gaps.shape[0]):
            low, high = math.floor(gaps[i, j] / DT + 1e-6), round(LONGEST / DT)
            if not math.isfinite(gaps[i, j]) or _is_clear(ahead, i, behind, j, low, margin, shift):
                continue
            if not _is_clear(ahead, i, behind, j, high, margin, shift):
                gaps[i, j] = np.inf
                continue
            while high - low > 1:
                middle = (low + high) // 2
                if _is_clear(ahead, i, behind, j, middle, margin, shift):
                    high = middle
                else:
                    low = middle
            gaps[i, j] = DT * high
