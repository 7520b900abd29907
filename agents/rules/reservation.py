"""Reservation: a parcel books its trajectory ahead in time, and waits at the gate until it is free.

A parcel that has the line to itself takes some trajectory to its exit. A stream of such parcels,
none of which disturbs another, can come no closer than their bases allow: `packed_rate` is that
bound. It holds for parcels that are led as if they were alone; a controller that leads them
otherwise may beat it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.flow import arrivals, task
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import RIGHT
from surface_gym.flow.stream import Stream
from surface_gym.state import RUNNING
from surface_gym.tasks.sort import HORIZON

from ..base import Booleans, Controller, Numbers
from .streams import TIME, Halves, ParcelRule, Rows, StreamEventRule

MARGIN = 0.02  # [m] kept clear between two parcels
FINE = 0.0025  # [s] between the moments at which bases are held against each other
LONGEST = 20.0  # [s] gap that is tried
SPEED_STEP = 0.1  # [m/s] between the trajectories of a stream whose speeds vary, at most
SIGNATURE = (3, 6, 13, 14, 16, 17)  # features that tell apart what waits at the gate
BOOKED = 8  # the latest entries that a new one is held against
SHUT = 0
LONG_AGO = -1e6  # [s]

Asked = tuple[sg.Parcel, float, str]  # a parcel, its speed [m/s] and its exit's name


@dataclass(frozen=True, eq=False)
class ParcelTrajectory:
    """A parcel's way over the line, from its entry to its exit."""

    outline: Numbers  # (corners, 2) [m] of the base from its centroid
    time: Numbers  # (moments,) [s] since it entered, rising from 0
    pose: Numbers  # (moments, 3) [m, m, rad] of the centroid

    def corners(self, time: Numbers) -> Numbers:
        """Locate (moments, corners, 2) [m] the base at times (moments,) within the trajectory's."""
        x, y, theta = (np.interp(time, self.time, column) for column in self.pose.T)
        cosine, sine = np.cos(theta)[:, np.newaxis], np.sin(theta)[:, np.newaxis]
        along, across = self.outline.T
        return np.stack(
            [
                x[:, np.newaxis] + cosine * along - sine * across,
                y[:, np.newaxis] + sine * along + cosine * across,
            ],
            axis=-1,
        )


def clearance(one: Numbers, other: Numbers) -> Numbers:
    """Compute (moments,) [m] between convex bases (moments, corners, 2), by separating axes: less
    than what lies between two corners, negative where they overlap.
    """
    found = np.full(len(one), -np.inf)
    for base, against in ((one, other), (other, one)):
        side = np.roll(base, -1, axis=1) - base
        length = np.hypot(side[..., 0], side[..., 1])
        normal = np.stack([side[..., 1], -side[..., 0]], axis=-1) / length[..., np.newaxis]
        own = np.einsum("mki,mki->mk", normal, base)
        reach = np.einsum("mki,mci->mkc", normal, against).min(axis=2)
        found = np.maximum(found, (reach - own).max(axis=1))
    return found


def least_gap(first: ParcelTrajectory, second: ParcelTrajectory, margin: float = 0.0) -> float:
    """Find the least gap [s] between two entries from which on the second never comes closer to the
    first than a margin [m] while both are on the line.
    """
    low, high = 0.0, LONGEST
    if not _is_clear(first, second, high, margin):
        raise ValueError(f"trajectories must have a gap of at most {LONGEST:g} s, got none")
    while high - low > FINE:
        middle = 0.5 * (low + high)
        if _is_clear(first, second, middle, margin):
            high = middle
        else:
            low = middle
    return high


def _is_clear(first: ParcelTrajectory, second: ParcelTrajectory, gap: float, margin: float) -> bool:
    """Test whether the second, a gap [s] behind, keeps clear of the first."""
    end = min(first.time[-1], gap + second.time[-1])
    if end <= gap:
        return True
    time = np.linspace(gap, end, max(2, math.ceil((end - gap) / FINE)))
    return bool(clearance(first.corners(time), second.corners(time - gap)).min() >= margin)


def least_gaps(trajectories: Sequence[ParcelTrajectory], margin: float = 0.0) -> Numbers:
    """Find the least gaps [s] of each trajectory (column) behind each other (row)."""
    return np.array(
        [[least_gap(one, other, margin) for other in trajectories] for one in trajectories]
    )


def packed_rate(gaps: Numbers, odds: Numbers) -> float:
    """Compute the rate [parcels/h] of a stream whose gaps are each as small as its parcels allow.

    Args:
        gaps: (trajectories, trajectories) [s] as `least_gaps` gives them.
        odds: (trajectories,) of each, independent of the one before.
    """
    share = odds / odds.sum()
    return float(arrivals.HOUR / (share @ gaps @ share))


@dataclass(frozen=True, eq=False)
class LoneRuns:
    """Runs of parcels that each have the line to themselves, by one controller."""

    time: Numbers  # (moments, runs) [s]
    pose: Numbers  # (moments, runs, 3) [m, m, rad] of the centroid
    entered: Numbers  # (runs,) [s]
    departed: Numbers  # (runs,) [s]; NaN: it never left
    right: Booleans  # (runs,) it left by its own exit
    signature: Numbers  # (runs, features) by which each is known as it waits


def run_alone(
    make: Callable[[EnvConfig], Controller],
    config: EnvConfig,
    asked: Sequence[Asked],
    seeds: Sequence[int],
    opens: Halves | None = None,
) -> LoneRuns:
    """Run parcels, each alone on a line with a gate.

    Args:
        opens: (runs,) physics step at which each gate opens; None: as the controller says.
    """
    streams = [Stream(arrivals.Trace((arrivals.Arrival(0.0, *one),))) for one in asked]
    alone = config.replace(max_parcels=1, gate=True, queue=1, stream=streams[0])
    count = len(asked)
    batch = StreamBatch(alone, count)
    for i, seed in enumerate(seeds):
        batch.seed(i, np.random.default_rng(seed))
    batch.reset(np.arange(count), [{"stream": stream} for stream in streams])
    signature = batch.observation[:, -1, SIGNATURE].astype(np.float64)
    controller, actions = make(alone), alone.action_kind
    state: Any = None
    times, poses = [], []
    while (batch.outcome == RUNNING).any() and np.isnan(batch.streams.left[:, 0]).any():
        action, state = controller.predict(batch.observation, state)
        if opens is not None:
            action = np.asarray(action).copy()
            action[:, -1] = opens
        batch.step(actions.commands(action, count))
        times.append(batch.streams.clock.copy())
        poses.append(batch.parcels.truth.reshape(count, alone.stream_task.rows, 6)[:, 0, :3].copy())
    return LoneRuns(
        np.array(times),
        np.array(poses),
        batch.streams.entered[:, 0],
        batch.streams.left[:, 0],
        batch.streams.tally[:, RIGHT] > 0,
        signature,
    )


def list_asked(config: EnvConfig) -> list[Asked]:
    """List every parcel, speed and exit of a stream; of speeds that vary, some from the least to
    the greatest.
    """
    stream = config.stream_task.stream
    if isinstance(stream.arrivals, arrivals.Trace):
        return list(dict.fromkeys((a.parcel, a.speed, a.exit) for a in stream.arrivals.arrivals))
    if isinstance(stream.speeds, tuple):
        low, high = stream.speeds
        count = 1 + int(np.ceil((high - low) / SPEED_STEP - 1e-9))
        speeds = np.linspace(low, high, max(2, count)).tolist()
    else:
        speeds = [stream.speeds]
    named = stream.destinations or [(name, 1.0) for name in config.exits.names]
    return [
        (parcel, speed, name) for parcel in stream.kinds for speed in speeds for name, _ in named
    ]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Trajectories of some parcels, each alone on the line, by one controller."""

    each: tuple[ParcelTrajectory, ...]
    right: tuple[bool, ...]  # whether it leaves by its own exit
    signature: Numbers  # (trajectories, features) by which each is known as it waits


def find_trajectories(
    make: Callable[[EnvConfig], Controller], config: EnvConfig, asked: Sequence[Asked]
) -> Trajectories:
    """Find the trajectories of parcels, each alone on the line, seen as they are."""
    exact = replace(config, sensors=sg.sensors.Exact(), randomisation=sg.Randomisation())
    runs = run_alone(make, exact, asked, range(len(asked)))
    return Trajectories(
        tuple(_trajectory(parcel, runs, i) for i, (parcel, _, _) in enumerate(asked)),
        tuple(runs.right.tolist()),
        runs.signature,
    )


def _trajectory(parcel: sg.Parcel, runs: LoneRuns, i: int) -> ParcelTrajectory:
    """Cut a run to between entry and exit; the pose at the exit lasts until the next reading."""
    time, pose = runs.time[:, i], runs.pose[:, i]
    entered, departed = runs.entered[i], runs.departed[i]
    departed = time[-1] if np.isnan(departed) else departed
    inside = (time > entered) & (time < departed)
    last = pose[np.searchsorted(time, departed)] if departed <= time[-1] else pose[-1]
    time, pose = np.append(time[inside], departed), np.vstack([pose[inside], last])
    outline = parcel.base.outline - np.array(parcel.base.centroid)
    return ParcelTrajectory(outline, time - entered, pose)


class Book(NamedTuple):
    """Entries that were booked, per environment."""

    clock: Numbers  # (num_envs,) [s] since the episode began
    way: Halves  # (num_envs, BOOKED) index of the latest trajectories, the last first
    time: Numbers  # (num_envs, BOOKED) [s] when each entered
    due: Numbers  # (num_envs,) [s] when the one that was let in last was to come
    pending: Booleans  # (num_envs,) whether that one has yet to be seen to have entered


class Booking:
    """Opens a gate for each parcel as soon as gaps to all before it allow.

    Args:
        signature: (trajectories, features) by which parcels are known as they wait.
        gaps: (trajectories, trajectories) [s] of each (column) behind each other (row).
    """

    def __init__(self, config: EnvConfig, signature: Numbers, gaps: Numbers) -> None:
        self._period = config.control_period
        self._dt = config.timing.dt
        self._steps = config.timing.steps
        self._head = config.stream_task.max_parcels  # row of the parcel that enters next
        self._signature = signature
        self._gaps = gaps

    def open(self, tables: Rows, book: Book | None, fresh: Booleans) -> tuple[Halves, Book]:
        """Choose when the gate opens (num_envs,), and book it."""
        num_envs = len(tables)
        if book is None:
            book = Book(
                clock=np.zeros(num_envs),
                way=np.zeros((num_envs, BOOKED), dtype=np.int64),
                time=np.full((num_envs, BOOKED), LONG_AGO),
                due=np.full(num_envs, np.nan),
                pending=np.zeros(num_envs, dtype=np.bool_),
            )
        clock = np.where(fresh, 0.0, book.clock)
        way = np.where(fresh[:, np.newaxis], 0, book.way)
        time = np.where(fresh[:, np.newaxis], LONG_AGO, book.time)
        head = tables[:, self._head]
        waits = head[:, task.PRESENT] > 0.5
        due = clock + HORIZON * head[:, TIME].astype(np.float64)
        # Let in, but there still: there was no room.
        stayed = book.pending & ~fresh & waits & (np.abs(due - book.due) < 1e-3)
        way[stayed] = np.roll(way[stayed], -1, axis=1)
        time[stayed] = np.roll(time[stayed], -1, axis=1)
        time[stayed, -1] = LONG_AGO
        own = self._recognise(head)
        earliest = (time + self._gaps[way, own[:, np.newaxis]]).max(axis=1)
        step = np.maximum(1, np.ceil((earliest - clock) / self._dt - 1e-6)).astype(np.int64)
        opens = np.where(waits & (step <= self._steps), step, SHUT)
        lets = opens != SHUT
        way[lets] = np.roll(way[lets], 1, axis=1)
        time[lets] = np.roll(time[lets], 1, axis=1)
        way[lets, 0] = own[lets]
        time[lets, 0] = clock[lets] + self._dt * opens[lets]
        return opens, Book(clock + self._period, way, time, np.where(lets, due, book.due), lets)

    def _recognise(self, rows: Rows) -> Halves:
        """Recognise (num_envs,) the trajectory of each parcel that waits, by what is seen of it."""
        seen = rows[:, SIGNATURE].astype(np.float64)
        apart = np.abs(seen[:, np.newaxis] - self._signature).max(axis=2)
        return apart.argmin(axis=1)


class Reservation(ParcelRule):
    """Lets each parcel in once its whole trajectory is clear of those before it; on the line a rule
    leads it as if it were alone.

    Args:
        margin: [m] that trajectories are kept apart.
    """

    def __init__(
        self,
        config: EnvConfig,
        lead: Callable[[EnvConfig], ParcelRule] = StreamEventRule,
        margin: float = MARGIN,
    ) -> None:
        super().__init__(config)
        if not config.stream_task.gate:
            raise ValueError("gate must be True for a reservation, got False")
        found = find_trajectories(lead, config, list_asked(config))
        self._lead = lead(config)
        self._booking = Booking(config, found.signature, least_gaps(found.each, margin))

    def halves(self, rows: Rows) -> Halves:
        return self._lead.halves(rows)

    def _open(self, tables: Rows, memory: Any, fresh: Booleans) -> tuple[Halves, Any]:
        return self._booking.open(tables, memory, fresh)
