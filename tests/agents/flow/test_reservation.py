"""Reservation: nobody touches, and the closer a stream the later its parcels enter."""

import numpy as np
import pytest

from agents.flow.event import EventRule
from agents.flow.packing import gaps_between, packed_rate
from agents.flow.reservation import MARGIN, Reservation
from agents.flow.ways import asked_of, ways_of
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from tests.agents.flow.lines import counts, gated, line

CROWD = Stream(Steady(15000.0), parcels=("S",), speeds=1.5)


def test_more_than_a_line_takes_is_sorted_without_a_touch() -> None:
    settings = gated(CROWD)
    found = counts(Reservation(settings), settings)
    assert (found["wrong"], found["touches"]) == (0, 0)
    assert found["right"] > 4 * 12
    alone = counts(EventRule(line(CROWD)), line(CROWD))
    assert alone["touches"] > 0


def test_it_comes_near_the_packed_ways_and_not_above() -> None:
    settings = gated(CROWD, duration=20.0)
    asked = asked_of(settings)
    gaps = gaps_between(list(ways_of(EventRule, settings, asked).ways), MARGIN)
    bound = packed_rate(gaps, np.ones(len(asked)))
    lanes = 8
    found = counts(Reservation(settings), settings, lanes)
    rate = 3600.0 * found["right"] / (lanes * settings.duration)
    assert 0.8 * bound < rate < 1.02 * bound


def test_a_wider_margin_lets_fewer_in() -> None:
    settings = gated(CROWD)
    near, wide = (counts(Reservation(settings, margin=m), settings)["right"] for m in (0.02, 0.2))
    assert wide < near


def test_on_the_line_it_does_what_its_lead_does() -> None:
    settings = gated(CROWD)
    rows = np.random.default_rng(0).normal(size=(20, 29)).astype(np.float32)
    rule, lead = Reservation(settings), EventRule(settings)
    np.testing.assert_array_equal(rule._halves(rows), lead._halves(rows))


def test_a_gate_is_needed() -> None:
    with pytest.raises(ValueError, match="gate must be True for a reservation, got False"):
        Reservation(line())
