"""How much a scratch has room for."""

import math

import pytest

import surface_gym as sg
from surface_gym.dynamics.memory import check_capacity
from surface_gym.dynamics.types import CAPACITY

SIDE = math.isqrt(CAPACITY)


def test_a_base_may_cover_as_many_elements_as_there_is_room_for() -> None:
    radius = 0.5 * 0.1 * (SIDE - 1)
    check_capacity(4, radius, (0.1, 0.1), (1000, 1000))
    with pytest.raises(ValueError, match=f"base must cover at most {CAPACITY} elements"):
        check_capacity(4, radius + 0.1, (0.1, 0.1), (1000, 1000))


def test_no_more_elements_are_counted_than_a_surface_has() -> None:
    check_capacity(4, 1e6, (0.1, 0.1), (SIDE, SIDE))
    run = sg.simulate(sg.layouts.sorting(), sg.Parcel(sg.Rectangle(9.0, 8.0)), (1.0, 1.0, 0.0))
    assert run.end == "duration"


def test_a_base_of_too_many_edges_is_named() -> None:
    check_capacity(CAPACITY, 0.1, (0.1, 0.1), (20, 30))
    with pytest.raises(ValueError, match=f"base must have at most {CAPACITY} edges"):
        check_capacity(CAPACITY + 1, 0.1, (0.1, 0.1), (20, 30))
