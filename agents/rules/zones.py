"""Zones whose columns turn together, for one parcel at a time: what the study allows, and more."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.task import PRESENT, WAITS
from surface_gym.parcel import Parcel

from ..base import BatchController, Booleans, Controller, Numbers, find_axes, is_fresh
from . import reservation, streams

LENGTH, HALF, FIFTH = 6, 0.175, 0.05  # of a parcel in its row: (half of it - 0.175 m) / 0.05 m
LONGER = 2  # columns by which a zone may be longer than the shortest that does
FAR = 100.0  # [m] farther than any two parcels on a line are apart
UNIT = 0.5  # [m] in which a row says how far the rear is past the exit's start
TRIES = 32  # of each parcel: what varies is drawn anew, and it enters at another physics step


class ZoneMemory(NamedTuple):
    """Memory of a zone's controller, per environment."""

    book: reservation.Book | None  # None where parcels come one by one
    side: Numbers  # (num_envs,) that the zone leads to: 1 left, -1 right, 0 straight on


class WholeZone(BatchController):
    """Columns behind the lead-in turn together, under the one parcel that is over them: at 90 deg
    until it is wholly past the zone's start, then at 45 deg to its side. The next enters the zone
    once it is free. All other columns stay at 90 deg.

    Args:
        alone: whether parcels come one by one, so that none needs to be held at the gate.
    """

    _dims = 2

    def __init__(self, config: EnvConfig, columns: int, alone: bool = False) -> None:
        checks.one_of("actions", config.actions, ("modules",))
        if not config.stream_task.gate:
            raise ValueError(
                "gate must be True for a zone that one parcel has at a time, got False"
            )
        _, self._rows, _, self._obeying = config.site.zone
        self._shown = config.stream_task.max_parcels + 1  # rows up to that of the next parcel
        if not 1 <= columns <= self._obeying:
            raise ValueError(f"columns must be between 1 and {self._obeying}, got {columns!r}")
        span = zone_span(config, columns)
        for each in config.exits:
            if each.side != 0 and each.first > span[0]:
                raise ValueError(
                    f"exits must start at {span[0]:g} m, where the zone does, or before, "
                    f"got {each.name!r} from {each.first:g} m"
                )
        self._axes = find_axes(config)
        self._columns = columns
        self._length = span[1] - span[0]
        self._booking: reservation.Booking | None = None
        if not alone:
            booking = _plan(type(self), config, columns)
            if booking is None:
                raise ValueError(
                    f"columns must be enough for every parcel to leave by its exit, got {columns!r}"
                )
            self._booking = reservation.Booking(config, *booking)

    def _predict(
        self, batch: streams.Rows, state: ZoneMemory | None, episode_start: Any, **_: bool
    ) -> tuple[Any, ZoneMemory]:
        num_envs = len(batch)
        fresh = is_fresh(num_envs, state, episode_start)
        before = np.zeros(num_envs) if state is None else np.where(fresh, 0.0, state.side)
        side = self._side(batch[:, : self._shown], before)
        choice = self._axes.towards(side)
        grid = np.full((num_envs, self._rows, self._obeying), self._axes.roll)
        grid[:, :, : self._columns] = choice[:, np.newaxis, np.newaxis]
        opens, book = np.ones(num_envs, dtype=np.int64), None
        if self._booking is not None:
            opens, book = self._booking.open(batch, None if state is None else state.book, fresh)
        actions = np.concatenate([grid.reshape(num_envs, -1), opens[:, np.newaxis]], axis=1)
        return actions, ZoneMemory(book, side)

    def _side(self, tables: streams.Rows, before: Numbers) -> Numbers:
        """Choose (num_envs,) the side that the zone leads to, by the one before: that of the parcel
        that is wholly in it; 0 where there is none.
        """
        del before
        rear = _rear(tables)
        over = _on_the_line(tables) & (rear > 0.0) & (rear < self._length)
        return _side_of_best(tables, over, -rear, np.zeros(len(tables)))


class ArrangedZone(WholeZone):
    """Columns behind the lead-in are arranged together, for the next parcel while the zone is free
    of all: at 45 deg to its side, or at 90 deg if it goes straight on. So they stay until it is
    out, as the study's do. Arguments and errors are those of `WholeZone`.
    """

    def _side(self, tables: streams.Rows, before: Numbers) -> Numbers:
        rear = _rear(tables)
        front = rear + 2.0 * (HALF + FIFTH * tables[..., LENGTH])
        here = _on_the_line(tables)
        occupied = (here & (front > 0.0) & (rear < self._length)).any(axis=1)
        waits = tables[..., WAITS] > 0.5
        coming = (here | waits) & (front <= 0.0)
        # The one at the gate comes after all on the line, wherever it is shown.
        nearest = np.where(waits, front - FAR, front)
        return np.where(occupied, before, _side_of_best(tables, coming, nearest, before))


def zone_span(config: EnvConfig, columns: int) -> tuple[float, float]:
    """Compute the x [m] at which the first columns that obey begin and end."""
    _, _, first, _ = config.site.zone
    line = config.chosen_line
    return line.column_edge(first), line.column_edge(first + columns)


def find_best_zone(kind: type[WholeZone], config: EnvConfig) -> int | None:
    """Find the columns of a zone that lets most parcels in, of the shortest by which every parcel
    of a stream leaves by its exit and the two next; None where no zone sorts them all.

    The parcels are tried alone on the line, whenever they come and whatever varies.
    """
    _, _, _, obeying = config.site.zone
    rates: dict[int, float] = {}
    for columns in range(1, obeying + 1):
        if rates and columns > min(rates) + LONGER:
            break
        booking = _plan(kind, config, columns)
        if booking is not None:
            rates[columns] = reservation.packed_rate(booking[1], np.ones(len(booking[1])))
    return max(rates, key=lambda columns: rates[columns]) if rates else None


def _plan(kind: type[WholeZone], config: EnvConfig, columns: int) -> tuple[Numbers, Numbers] | None:
    """Compute the signatures of a stream's parcels, and the gaps [s] by which each finds the zone
    free and comes near no other; None where one leaves by another exit than its own.
    """

    def alone(lone: EnvConfig) -> WholeZone:
        return kind(lone, columns, alone=True)

    asked = reservation.list_asked(config)
    crossing = measure_crossings(alone, config, asked, zone_span(config, columns))
    if not crossing.right.all():
        return None
    found = reservation.find_trajectories(alone, config, asked)
    clear = reservation.least_gaps(found.each, reservation.MARGIN)
    return found.signature, np.maximum(clear, crossing.gaps(config.control_period))


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of a zone by parcels that come one at a time, over all tries of each."""

    right: Booleans  # (parcels,) whether it left by its exit every time
    enters: Numbers  # (parcels,) [s] since it came: the soonest that its front was over the zone
    leaves: Numbers  # (parcels,) [s] since it came: the latest that it had left the zone

    def gaps(self, period: float) -> Numbers:
        """Compute (parcels, parcels) [s] between entries, for each (column) to find the zone free
        of each other (row), and turned meanwhile: by a decision that comes up to a period [s] late.
        """
        return np.maximum(0.0, np.subtract.outer(self.leaves + period, self.enters))


def measure_crossings(
    make: Callable[[EnvConfig], Controller],
    config: EnvConfig,
    asked: Sequence[reservation.Asked],
    span: tuple[float, float],
) -> Crossings:
    """Try parcels, each alone on the line, as the sensors see it and with all that varies.

    Args:
        span: [m] of x over which the zone lies.
    """
    each = [one for one in asked for _ in range(TRIES)]
    attempt = np.tile(np.arange(TRIES), len(asked))
    opens = 1 + attempt % config.timing.steps
    runs = reservation.run_alone(make, config, each, attempt.tolist(), opens)
    enters, leaves = np.empty(len(each)), np.empty(len(each))
    for i, (parcel, _, _) in enumerate(each):
        clock, entered, departed = runs.time[:, i], runs.entered[i], runs.departed[i]
        there = (clock > entered) & ~(clock > departed)
        time = clock[there] - entered
        rear, front = _reach(parcel, runs.pose[there, i])
        enters[i] = _time_at(time, front, span[0])
        gone = np.inf if np.isnan(departed) else departed - entered
        leaves[i] = min(gone, _time_at(time, rear, span[1]))
    shape = len(asked), TRIES
    return Crossings(
        right=np.all(runs.right.reshape(shape), axis=1),
        enters=enters.reshape(shape).min(axis=1),
        leaves=leaves.reshape(shape).max(axis=1),
    )


def _reach(parcel: Parcel, pose: Numbers) -> tuple[Numbers, Numbers]:
    """Compute (moments,) [m] least and greatest x of a base at poses (moments, 3)."""
    along, across = (parcel.base.outline - np.array(parcel.base.centroid)).T
    turned = np.outer(np.cos(pose[:, 2]), along) - np.outer(np.sin(pose[:, 2]), across)
    return pose[:, 0] + turned.min(axis=1), pose[:, 0] + turned.max(axis=1)


def _time_at(time: Numbers, x: Numbers, place: float) -> float:
    """Interpolate the time [s] when x [m] first passes a place; infinite if it never does."""
    past = x >= place
    if not past.any():
        return float("inf")
    k = int(past.argmax())
    if k == 0:
        return float(time[0])
    share = (place - x[k - 1]) / (x[k] - x[k - 1])
    return float(time[k - 1] + share * (time[k] - time[k - 1]))


def _rear(tables: streams.Rows) -> Numbers:
    """(num_envs, rows) [m] how far each parcel's rear is past the zone's start."""
    return UNIT * tables[..., streams.PAST_START].astype(np.float64)


def _on_the_line(tables: streams.Rows) -> Booleans:
    """(num_envs, rows) whether there is a parcel that has entered."""
    return (tables[..., PRESENT] > 0.5) & (tables[..., WAITS] < 0.5)


def _side_of_best(
    tables: streams.Rows, among: Booleans, rank: Numbers, otherwise: Numbers
) -> Numbers:
    """Find (num_envs,) the exit side of the parcel that ranks highest among some (num_envs, rows);
    else another.
    """
    chosen = np.arange(len(tables)), np.where(among, rank, -np.inf).argmax(axis=1)
    return np.where(among.any(axis=1), tables[..., streams.SIDE][chosen], otherwise)
