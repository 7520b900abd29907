"""Contacts with the elements, and the scratch they are kept in."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import surface_gym as sg
from surface_gym.compiler.jit import compiled
from surface_gym.physics import contacts, types as ph
from surface_gym.physics.contacts import EDGE_TOLERANCE
from surface_gym.physics.references import find_contacts, step_implicit
from surface_gym.physics.step import BALANCED, OFF_SURFACE, UNSUPPORTED
from tests.physics.contact_sets import scan
from tests.strategies import COLUMNS, ROWS, bases

Pose = tuple[float, float, float]
BOX = sg.layouts.box("S")

NUMBER = np.arange(ROWS * COLUMNS, dtype=float).reshape(ROWS, COLUMNS)
SURFACE = sg.Surface(
    axis=NUMBER % 7, rotor=NUMBER % 3 > 0, mu_max=0.1 + 0.001 * NUMBER, stiffness=1.0 + NUMBER
)
OBLONG = replace(SURFACE, pitch=(0.13, 0.07), origin=(0.02, 0.3))


def contacts_of(
    parcel: sg.Parcel, pose: Pose, surface: sg.Surface = SURFACE
) -> tuple[ph.Scratch, int, Any]:
    """The contacts, their number, and their [row, column] in the grid."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    com_x, com_y = parcel.centre_of_mass
    x = pose[0] + cosine * com_x - sine * com_y
    y = pose[1] + sine * com_x + cosine * com_y
    scratch = ph.make_scratch()
    count, _, supports = find_contacts(surface.grid, parcel.body, x, y, pose[2], scratch)
    columns = (ph.table_row(scratch, ph.ARM_X, count) + x - surface.origin[0]) / surface.pitch_x
    rows = (ph.table_row(scratch, ph.ARM_Y, count) + y - surface.origin[1]) / surface.pitch_y
    assert supports == count - scratch.marks[ph.KIND : ph.KIND + count].sum()
    return scratch, count, np.column_stack([rows, columns])


@given(
    base=bases,
    x=st.floats(-0.3, 2.3),
    y=st.floats(-0.3, 1.9),
    theta=st.one_of(st.floats(-10.0, 10.0), st.sampled_from([0.0, math.pi / 2, math.pi, 1e6])),
    surface=st.sampled_from([SURFACE, OBLONG]),
)
def test_they_are_what_a_scan_finds(
    base: sg.parcel.Base, x: float, y: float, theta: float, surface: sg.Surface
) -> None:
    parcel = sg.Parcel(base)
    _, _, places = contacts_of(parcel, (x, y, theta), surface)
    found = np.zeros((ROWS, COLUMNS), dtype=int)
    for row, column in np.rint(places).astype(int):
        found[row, column] += 1
    largest = scan(surface, parcel, (x, y, theta))
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
def test_contacts_stay_when_the_mass_moves(x: float, y: float, theta: float, offset: float) -> None:
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
        (ph.AXIS_X, np.where(rotor, np.cos(axis), 1.0)),
        (ph.AXIS_Y, np.where(rotor, np.sin(axis), 0.0)),
        (ph.STIFFNESS, SURFACE.stiffness[rows, columns]),
        (ph.MU_ALONG, np.where(rotor, SURFACE.mu_max[rows, columns], SURFACE.mu_support)),
        (ph.MU_ACROSS, np.where(rotor, SURFACE.mu_min, SURFACE.mu_support)),
    ):
        np.testing.assert_array_equal(ph.table_row(scratch, row, count), expected)
    np.testing.assert_array_equal(scratch.marks[ph.KIND : ph.KIND + count], rotor)


def test_a_scratch_follows_a_parcel_whose_axes_turn_once_it_forgets_them() -> None:
    grid, pose = sg.layouts.sorting().grid, (1.0, 1.0, 0.0)
    used, fresh = ph.make_scratch(), ph.make_scratch()
    found = find_contacts(grid, BOX.body, *pose, used)
    turned = grid._replace(direction=grid.direction[:, ::-1])
    assert find_contacts(turned, BOX.body, *pose, used) == found
    contacts.invalidate_contacts.py_func(used)
    for scratch in (used, fresh):
        find_contacts(turned, BOX.body, *pose, scratch)
    for row in (ph.AXIS_X, ph.AXIS_Y):
        np.testing.assert_array_equal(ph.table_row(used, row, 4), ph.table_row(fresh, row, 4))


@pytest.mark.parametrize("quarter_turns", range(-4, 5))
def test_an_element_on_the_perimeter_is_a_contact(quarter_turns: int) -> None:
    # The paper's start: the S-box covers 0 ... 0.25 m, whose right side runs through x = 0.25.
    pose = (0.125, 1.0, quarter_turns * math.pi / 2)
    _, _, places = contacts_of(BOX, pose)
    np.testing.assert_allclose(places, [[9, 0], [9, 1], [9, 2], [10, 0], [10, 1], [10, 2]])


def test_the_corners_of_a_box_at_45_degrees_are_contacts() -> None:
    diagonal = 0.4
    box = sg.Parcel(sg.Rectangle(diagonal / math.sqrt(2.0), diagonal / math.sqrt(2.0)))
    _, count, places = contacts_of(box, (1.05, 0.85, math.pi / 4))
    assert count == 13  # |rows| + |columns| <= 2 around the middle
    np.testing.assert_allclose(np.abs(places - [8, 10]).sum(axis=1).max(), 2.0)


@pytest.mark.parametrize(
    ("base", "pose", "count"),
    [
        *((BOX.base, pose, 0) for pose in [(-1.0, 0.8, 0.3), (1.0, 5.0, 0.0), (1e6, -1e6, 2.0)]),
        (sg.Rectangle(9.0, 8.0), (1.0, 0.8, 0.5), ROWS * COLUMNS),  # larger than the surface
        (sg.Disc(0.01), (0.95, 0.75, 0.0), 1),  # smaller than the pitch
        (sg.Disc(0.01), (1.0, 0.8, 0.0), 0),
    ],
)
def test_they_are_as_many_as_the_base_covers(base: sg.parcel.Base, pose: Pose, count: int) -> None:
    assert contacts_of(sg.Parcel(base), pose)[1] == count


bounded = compiled(contacts.bounded.py_func)

WILD = [math.nan, math.inf, -math.inf, 1e308, -1e308, 1e19, -1e19, 2.0**63, -(2.0**63)]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (math.nan, -1.0), (-math.inf, -1.0), (-1e308, -1.0), (-1.0, -1.0), (-0.3, -0.3),
        (7.9, 7.9), (20.0, 20.0), (20.1, 20.0), (1e308, 20.0), (math.inf, 20.0),
    ],
)  # fmt: skip
def test_it_lies_between_and_else_stays(value: float, expected: float) -> None:
    assert bounded(value, -1.0, 20.0) == expected
    assert contacts.bounded.py_func(value, -1.0, 20.0) == expected


@pytest.mark.parametrize("wild", WILD)
@pytest.mark.parametrize("place", range(3), ids=["x", "y", "theta"])
def test_contacts_of_a_wild_pose_are_on_the_surface(wild: float, place: int) -> None:
    surface, pose = sg.layouts.sorting(), [1.0, 1.0, 0.2]
    pose[place] = wild
    found = find_contacts(surface.grid, BOX.body, *pose, ph.make_scratch())
    assert 0 <= found.supports <= found.total <= surface.axis.size


@pytest.mark.parametrize("wild", WILD)
@pytest.mark.parametrize("place", range(ph.STATE_SIZE))
def test_a_step_from_a_wild_state_ends(wild: float, place: int) -> None:
    state = np.zeros(ph.STATE_SIZE)
    state[[ph.X, ph.Y, ph.VX]] = (1.0, 1.0, 1.0)
    state[place] = wild
    before = state.copy()
    report, _ = step_implicit(sg.layouts.sorting().grid, BOX.body, state, ph.make_scratch(), 0.005)
    if place in (ph.X, ph.Y):
        assert report == OFF_SURFACE
        np.testing.assert_array_equal(state, before)
    elif place == ph.THETA and math.isfinite(wild):
        assert report == BALANCED
    assert report in range(UNSUPPORTED + 1)


SIDE = math.isqrt(ph.CAPACITY)


def test_a_base_may_cover_as_many_elements_and_have_as_many_edges_as_there_is_room_for() -> None:
    radius = 0.5 * 0.1 * (SIDE - 1)
    ph.check_capacity(4, radius, (0.1, 0.1), (1000, 1000))
    with pytest.raises(ValueError, match=f"base must cover at most {ph.CAPACITY} elements"):
        ph.check_capacity(4, radius + 0.1, (0.1, 0.1), (1000, 1000))
    # No more are counted than a surface has.
    ph.check_capacity(4, 1e6, (0.1, 0.1), (SIDE, SIDE))
    run = sg.simulate(sg.layouts.sorting(), sg.Parcel(sg.Rectangle(9.0, 8.0)), (1.0, 1.0, 0.0))
    assert run.end == "duration"
    ph.check_capacity(ph.CAPACITY, 0.1, (0.1, 0.1), (20, 30))
    with pytest.raises(ValueError, match=f"base must have at most {ph.CAPACITY} edges"):
        ph.check_capacity(ph.CAPACITY + 1, 0.1, (0.1, 0.1), (20, 30))
