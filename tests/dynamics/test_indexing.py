"""A float becomes an index only within bounds, whatever it is."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.dynamics import indexing
from surface_gym.dynamics.compiled import compiled
from surface_gym.dynamics.entries import find_contacts, find_support, step_implicit
from surface_gym.dynamics.memory import make_scratch
from surface_gym.dynamics.step import BALANCED, OFF_SURFACE, UNBORNE
from surface_gym.dynamics.types import STATE_SIZE, THETA, VX, X, Y

bounded = compiled(indexing.bounded.py_func)

WILD = [math.nan, math.inf, -math.inf, 1e308, -1e308, 1e19, -1e19, 2.0**63, -(2.0**63)]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (math.nan, -1.0),
        (-math.inf, -1.0),
        (-1e308, -1.0),
        (-1.0, -1.0),
        (-0.3, -0.3),
        (7.9, 7.9),
        (20.0, 20.0),
        (20.1, 20.0),
        (1e308, 20.0),
        (math.inf, 20.0),
    ],
)
def test_it_lies_between_and_else_stays(value: float, expected: float) -> None:
    assert bounded(value, -1.0, 20.0) == expected
    assert indexing.bounded.py_func(value, -1.0, 20.0) == expected


@pytest.mark.parametrize("wild", WILD)
@pytest.mark.parametrize("place", range(3), ids=["x", "y", "theta"])
def test_contacts_of_a_wild_pose_are_on_the_surface(wild: float, place: int) -> None:
    surface, parcel = sg.layouts.sorting(), sg.layouts.box("S")
    pose = [1.0, 1.0, 0.2]
    pose[place] = wild
    scratch = make_scratch()
    contacts = find_contacts(surface.grid, parcel.body, *pose, scratch)
    assert 0 <= contacts.supports <= contacts.total <= surface.axis.size


@pytest.mark.parametrize("wild", WILD)
@pytest.mark.parametrize("place", range(STATE_SIZE))
def test_a_step_from_a_wild_state_ends(wild: float, place: int) -> None:
    surface, parcel = sg.layouts.sorting(), sg.layouts.box("S")
    state = np.zeros(STATE_SIZE)
    state[[X, Y, VX]] = (1.0, 1.0, 1.0)
    state[place] = wild
    before = state.copy()
    report, _ = step_implicit(surface.grid, parcel.body, state, make_scratch(), 0.005)
    if place in (X, Y):
        assert report == OFF_SURFACE
        np.testing.assert_array_equal(state, before)
    elif place == THETA and math.isfinite(wild):
        assert report == BALANCED
    assert report in range(UNBORNE + 1)


def test_every_ordinary_pose_has_the_contacts_of_a_search_of_all_elements() -> None:
    surface, parcel = sg.layouts.sorting(), sg.layouts.box("S")
    rng = np.random.default_rng(0)
    for _ in range(200):
        x, y, theta = rng.uniform((-0.1, -0.1, -4.0), (4.1, 2.1, 4.0))
        state = np.array([x, y, theta, 0.0, 0.0, 0.0, 0.0, 0.0])
        found = find_support(surface.grid, parcel.body, state, make_scratch(), 0.0).total
        dx, dy = np.meshgrid(surface.x - x, surface.y - y)
        along = math.cos(theta) * dx + math.sin(theta) * dy
        across = math.cos(theta) * dy - math.sin(theta) * dx
        under = (parcel.base.functions(along, across).max(axis=0) <= 1e-9).sum()
        on_surface = 0.0 <= x <= 4.0 and 0.0 <= y <= 2.0
        assert found == (under if on_surface else 0)
