"""Booking: who is let in when, by gaps made by hand."""

from typing import Any

import numpy as np
import pytest

from agents.flow.booking import Book, Booking
from agents.flow.ways import SIGNATURE, Ways
from surface_gym.flow.features import FEATURES, PRESENT, WAITS
from tests.agents.flow.lines import gated

SETTINGS = gated()
PERIOD, DT, STEPS = SETTINGS.control_period, SETTINGS.timing.dt, SETTINGS.timing.steps
GAPS = np.array([[0.3, 0.05], [1.0, 0.5]])  # [s] of way 0 and 1 (column) behind each (row)
FRESH, GOES_ON = np.ones(1, dtype=bool), np.zeros(1, dtype=bool)


def booking() -> Booking:
    """Of two ways that are told apart by the parcel's size."""
    signature = np.zeros((2, len(SIGNATURE)))
    signature[1, SIGNATURE.index(6)] = 2.0
    return Booking(SETTINGS, Ways((), (), (), signature), GAPS)


def waiting(way: int | None, since: float = 0.0) -> np.ndarray:
    """A table with a parcel at the gate that is to go a way, its time come so long ago [s]."""
    table = np.zeros((1, SETTINGS.rows, len(FEATURES)), dtype=np.float32)
    if way is not None:
        table[0, -1, [PRESENT, WAITS]] = 1.0
        table[0, -1, 6] = 2.0 * way
        table[0, -1, 12] = -since / 4.0
    return table


def entries(ways: list[int], periods: int) -> list[float]:
    """[s] when each of a queue of parcels is let in, all of which have waited from the start."""
    book: Any = None
    times: list[float] = []
    gate = booking()
    for period in range(periods):
        clock = period * PERIOD
        head = ways[len(times)] if len(times) < len(ways) else None
        # Each in turn comes to the gate a moment after the one before.
        opens, book = gate.open(
            waiting(head, clock - 1e-2 * len(times)), book, FRESH if period == 0 else GOES_ON
        )
        if opens[0]:
            times.append(clock + opens[0] * DT)
    return times


def test_the_first_enters_at_once_and_nobody_is_let_in_who_is_not_there() -> None:
    opens, book = booking().open(waiting(None), None, FRESH)
    assert opens.tolist() == [0]
    opens, _ = booking().open(waiting(0), book, GOES_ON)
    assert opens.tolist() == [1]


@pytest.mark.parametrize("ways", [[0, 0], [0, 1], [1, 0], [1, 1]])
def test_the_next_keeps_its_gap_to_a_physics_step(ways: list[int]) -> None:
    first, second = entries(ways, 40)
    gap = GAPS[ways[0], ways[1]]
    assert gap - 1e-6 <= second - first <= gap + PERIOD + DT


def test_gaps_hold_to_all_before_not_only_to_the_last() -> None:
    """Way 1, then 0 at once would be 1 s later; way 1 behind way 1 has to wait for the first."""
    first, second, third = entries([1, 1, 0], 60)
    assert second - first >= 0.5 - 1e-6
    assert third - second >= 1.0 - 1e-6
    first, second, third = entries([0, 1, 0], 60)
    assert third - second >= 1.0 - 1e-6
    assert third - first >= 0.3


def test_who_found_no_room_is_let_in_again() -> None:
    gate = booking()
    opens, book = gate.open(waiting(0), None, FRESH)
    assert opens.tolist() == [1]
    # It waits there still: what was booked is taken back, and it need not keep a gap to itself.
    opens, book = gate.open(waiting(0, since=PERIOD), book, GOES_ON)
    assert opens.tolist() == [1]
    # Now it has entered, and another has come.
    opens, _ = gate.open(waiting(0, since=0.0), book, GOES_ON)
    assert opens.tolist() == [0]


def test_a_new_episode_forgets_the_old() -> None:
    gate = booking()
    _, book = gate.open(waiting(1), None, FRESH)
    opens, again = gate.open(waiting(1), book, FRESH)
    assert opens.tolist() == [1]
    assert isinstance(again, Book)
    assert again.clock.tolist() == [PERIOD]


def test_lanes_are_booked_apart() -> None:
    gate = booking()
    tables = np.concatenate([waiting(0), waiting(None), waiting(1)])
    opens, book = gate.open(tables, None, np.ones(3, dtype=bool))
    assert opens.tolist() == [1, 0, 1]
    later = np.concatenate([waiting(0), waiting(0), waiting(1)])
    opens, _ = gate.open(later, book, np.zeros(3, dtype=bool))
    assert opens.tolist() == [0, 1, 0]
    assert STEPS >= 1
