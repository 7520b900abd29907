"""Contacts with the elements, and the scratch they are kept in."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import surface_gym as sg
from surface_gym.physics import contacts
from surface_gym.physics.contacts import EDGE_TOLERANCE, invalidate_contacts
from surface_gym.physics.jit import compiled
from surface_gym.physics.references import find_contacts, find_support, step_implicit
from surface_gym.physics.step import BALANCED, OFF_SURFACE, UNSUPPORTED
from surface_gym.physics.types import (
    ARM_X,
    ARM_Y,
    AXIS_X,
    AXIS_Y,
    CAPACITY,
    MU_ACROSS,
    MU_ALONG,
    ROTOR,
    STATE_SIZE,
    STIFFNESS,
    THETA,
    VX,
    Scratch,
    X,
    Y,
    check_capacity,
    make_scratch,
    table_row,
)
from tests.strategies import COLUMNS, ROWS, bases, polygon_vertices

Pose = tuple[float, float, float]

SURFACE = sg.Surface(
    axis=np.arange(ROWS * COLUMNS, dtype=float).reshape(ROWS, COLUMNS),
    rotor=np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS) % 3 > 0,
    mu_max=0.1 + 0.001 * np.arange(ROWS * COLUMNS, dtype=float).reshape(ROWS, COLUMNS),
    stiffness=1.0 + np.arange(ROWS * COLUMNS, dtype=float).reshape(ROWS, COLUMNS),
)
OBLONG = replace(SURFACE, pitch=(0.13, 0.07), origin=(0.02, 0.3))


def contacts_of(
    parcel: sg.Parcel, pose: Pose, surface: sg.Surface = SURFACE
) -> tuple[Scratch, int, np.ndarray]:
    """The contacts, their number, and their [row, column] in the grid."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    com_x, com_y = parcel.centre_of_mass
    x = pose[0] + cosine * com_x - sine * com_y
    y = pose[1] + sine * com_x + cosine * com_y
    scratch = make_scratch()
    count, supports = find_contacts(surface.grid, parcel.body, x, y, pose[2], scratch)
    columns = (table_row(scratch, ARM_X, count) + x - surface.origin[0]) / surface.pitch_x
    rows = (table_row(scratch, ARM_Y, count) + y - surface.origin[1]) / surface.pitch_y
    assert supports == count - scratch.marks[ROTOR : ROTOR + count].sum()
    return scratch, count, np.column_stack([rows, columns])


def scan(parcel: sg.Parcel, pose: Pose, surface: sg.Surface = SURFACE) -> np.ndarray:
    """(ROWS, COLUMNS) the largest F_lambda at each element."""
    x, y = np.meshgrid(surface.x - pose[0], surface.y - pose[1])
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    return parcel.base.functions(cosine * x + sine * y, cosine * y - sine * x).max(axis=0)


@given(
    base=bases,
    x=st.floats(-0.3, 2.3),
    y=st.floats(-0.3, 1.9),
    theta=st.one_of(st.floats(-10.0, 10.0), st.sampled_from([0.0, math.pi / 2, math.pi, 1e6])),
    surface=st.sampled_from([SURFACE, OBLONG]),
)
def test_contacts_are_the_elements_a_scan_finds(
    base: sg.parcel.Base, x: float, y: float, theta: float, surface: sg.Surface
) -> None:
    parcel = sg.Parcel(base)
    _, _, places = contacts_of(parcel, (x, y, theta), surface)
    found = np.zeros((ROWS, COLUMNS), dtype=int)
    for row, column in np.rint(places).astype(int):
        found[row, column] += 1
    largest = scan(parcel, (x, y, theta), surface)
    np.testing.assert_allclose(places, np.rint(places), atol=1e-9)
    assert found.max(initial=0) <= 1
    assert found[largest <= 0.0].all()
    assert not found[largest > 1.01 * EDGE_TOLERANCE].any()


@given(
    x=st.floats(0.0, 2.0),
    y=st.floats(0.0, 1.6),
    theta=st.floats(-4.0, 4.0),
    offset=st.floats(-0.05, 0.05),
)
def test_contacts_stay_where_they_are_when_the_mass_moves(
    x: float, y: float, theta: float, offset: float
) -> None:
    base = sg.Rectangle(0.31, 0.27)
    _, _, central = contacts_of(sg.Parcel(base), (x, y, theta))
    _, _, shifted = contacts_of(sg.Parcel(base, com_offset=(offset, -offset)), (x, y, theta))
    np.testing.assert_allclose(shifted, central, atol=1e-9)


def test_each_contact_has_its_elements_axis_kind_and_stiffness() -> None:
    scratch, count, places = contacts_of(sg.Parcel(sg.Disc(0.3)), (1.0, 0.8, 0.0))
    rows, columns = np.rint(places).astype(int).T
    assert count == len(places) > 20
    rotor, axis = SURFACE.rotor[rows, columns], SURFACE.axis[rows, columns]
    for row, expected in (
        (AXIS_X, np.where(rotor, np.cos(axis), 1.0)),
        (AXIS_Y, np.where(rotor, np.sin(axis), 0.0)),
        (STIFFNESS, SURFACE.stiffness[rows, columns]),
        (MU_ALONG, np.where(rotor, SURFACE.mu_max[rows, columns], SURFACE.mu_support)),
        (MU_ACROSS, np.where(rotor, SURFACE.mu_min, SURFACE.mu_support)),
    ):
        np.testing.assert_array_equal(table_row(scratch, row, count), expected)
    np.testing.assert_array_equal(scratch.marks[ROTOR : ROTOR + count], rotor)


def test_a_scratch_follows_a_parcel_whose_axes_turn_once_it_forgets_them() -> None:
    parcel, grid = sg.layouts.box("S"), sg.layouts.sorting().grid
    scratch = make_scratch()
    pose = (1.0, 1.0, 0.0)
    contacts = find_contacts(grid, parcel.body, *pose, scratch)
    turned = grid._replace(direction=grid.direction[:, ::-1])
    assert find_contacts(turned, parcel.body, *pose, scratch) == contacts
    invalidate_contacts.py_func(scratch)
    find_contacts(turned, parcel.body, *pose, scratch)
    fresh = make_scratch()
    find_contacts(turned, parcel.body, *pose, fresh)
    for row in (AXIS_X, AXIS_Y):
        np.testing.assert_array_equal(table_row(scratch, row, 4), table_row(fresh, row, 4))


@pytest.mark.parametrize("quarter_turns", range(-4, 5))
def test_an_element_on_the_perimeter_is_a_contact(quarter_turns: int) -> None:
    # The paper's start: the S-box covers 0 ... 0.25 m, whose right side runs through x = 0.25.
    pose = (0.125, 1.0, quarter_turns * math.pi / 2)
    _, _, places = contacts_of(sg.layouts.box("S"), pose)
    np.testing.assert_allclose(places, [[9, 0], [9, 1], [9, 2], [10, 0], [10, 1], [10, 2]])


def test_the_corners_of_a_box_at_45_degrees_are_contacts() -> None:
    diagonal = 0.4
    box = sg.Parcel(sg.Rectangle(diagonal / math.sqrt(2.0), diagonal / math.sqrt(2.0)))
    _, count, places = contacts_of(box, (1.05, 0.85, math.pi / 4))
    assert count == 13  # |rows| + |columns| <= 2 around the middle
    np.testing.assert_allclose(np.abs(places - [8, 10]).sum(axis=1).max(), 2.0)


def test_both_senses_of_a_polygon_have_the_same_contacts() -> None:
    vertices = polygon_vertices(5, 0.3, 0.7, 0.4)
    pose = (0.9, 0.7, 1.0)
    _, _, anti_clockwise = contacts_of(sg.Parcel(sg.Polygon(vertices)), pose)
    _, _, clockwise = contacts_of(sg.Parcel(sg.Polygon(vertices[::-1])), pose)
    assert len(anti_clockwise) > 10
    np.testing.assert_allclose(clockwise, anti_clockwise, atol=1e-9)


@pytest.mark.parametrize("pose", [(-1.0, 0.8, 0.3), (1.0, 5.0, 0.0), (1e6, -1e6, 2.0)])
def test_a_parcel_beside_the_surface_has_no_contacts(pose: Pose) -> None:
    assert contacts_of(sg.layouts.box("B"), pose)[1] == 0


def test_a_parcel_larger_than_the_surface_touches_all_of_it() -> None:
    assert contacts_of(sg.Parcel(sg.Rectangle(9.0, 8.0)), (1.0, 0.8, 0.5))[1] == ROWS * COLUMNS


def test_a_parcel_smaller_than_the_pitch_touches_one_element_or_none() -> None:
    parcel = sg.Parcel(sg.Disc(0.01))
    assert contacts_of(parcel, (0.95, 0.75, 0.0))[1] == 1
    assert contacts_of(parcel, (1.0, 0.8, 0.0))[1] == 0


bounded = compiled(contacts.bounded.py_func)

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
    assert contacts.bounded.py_func(value, -1.0, 20.0) == expected


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
    assert report in range(UNSUPPORTED + 1)


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
