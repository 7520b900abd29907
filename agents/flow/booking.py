"""Booking a way ahead in time: the gate opens once a parcel can go its whole way undisturbed."""

from typing import NamedTuple

import numpy as np

from surface_gym.flow.features import PRESENT
from surface_gym.flow.settings import FlowSettings
from surface_gym.tasks.sort import HORIZON

from .packing import Numbers
from .parcel_rule import TIME, Booleans, Halves, Rows
from .ways import SIGNATURE, Ways

BOOKED = 8  # the latest entries that a new one is held against
SHUT = 0
LONG_AGO = -1e6  # [s]


class Book(NamedTuple):
    """What has been let in, lane by lane."""

    clock: Numbers  # (lanes,) [s] since the episode began
    way: Halves  # (lanes, BOOKED) the latest, the last first
    time: Numbers  # (lanes, BOOKED) [s] when each entered
    due: Numbers  # (lanes,) [s] when the one that was let in last was to come
    pending: Booleans  # (lanes,) whether that one has yet to be seen to have entered


class Booking:
    """Opens a gate for each parcel as soon as gaps to all before it allow.

    Args:
        settings: of the environment, with a gate.
        ways: that there are.
        gaps: (ways, ways) [s] of each way (column) behind each other (row).
    """

    def __init__(self, settings: FlowSettings, ways: Ways, gaps: Numbers) -> None:
        self._period = settings.control_period
        self._dt = settings.timing.dt
        self._steps = settings.timing.steps
        self._signature = ways.signature
        self._gaps = gaps

    def open(self, tables: Rows, book: Book | None, fresh: Booleans) -> tuple[Halves, Book]:
        """When the gate opens (lanes,), and the book."""
        lanes = len(tables)
        if book is None:
            book = _new_book(lanes)
        clock = np.where(fresh, 0.0, book.clock)
        way = np.where(fresh[:, np.newaxis], 0, book.way)
        time = np.where(fresh[:, np.newaxis], LONG_AGO, book.time)
        waits = tables[:, -1, PRESENT] > 0.5
        due = clock + HORIZON * tables[:, -1, TIME].astype(np.float64)
        # Let in, but there still: there was no room.
        stayed = book.pending & ~fresh & waits & (np.abs(due - book.due) < 1e-3)
        way[stayed] = np.roll(way[stayed], -1, axis=1)
        time[stayed] = np.roll(time[stayed], -1, axis=1)
        time[stayed, -1] = LONG_AGO
        own = self._way_of(tables[:, -1])
        earliest = (time + self._gaps[way, own[:, np.newaxis]]).max(axis=1)
        step = np.maximum(1, np.ceil((earliest - clock) / self._dt - 1e-6)).astype(np.int64)
        opens = np.where(waits & (step <= self._steps), step, SHUT)
        lets = opens != SHUT
        way[lets] = np.roll(way[lets], 1, axis=1)
        time[lets] = np.roll(time[lets], 1, axis=1)
        way[lets, 0] = own[lets]
        time[lets, 0] = clock[lets] + self._dt * opens[lets]
        return opens, Book(clock + self._period, way, time, np.where(lets, due, book.due), lets)

    def _way_of(self, rows: Rows) -> Halves:
        """(lanes,) the way of each parcel that waits, by what is seen of it."""
        seen = rows[:, SIGNATURE].astype(np.float64)
        apart = np.abs(seen[:, np.newaxis] - self._signature).max(axis=2)
        nearest: Halves = apart.argmin(axis=1)
        return nearest


def _new_book(lanes: int) -> Book:
    return Book(
        clock=np.zeros(lanes),
        way=np.zeros((lanes, BOOKED), dtype=np.int64),
        time=np.full((lanes, BOOKED), LONG_AGO),
        due=np.full(lanes, np.nan),
        pending=np.zeros(lanes, dtype=np.bool_),
    )
