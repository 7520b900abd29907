import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.rendering import ExitMark, FlowParcel, draw_flow
from surface_gym.rendering.flow_parcel_marks import meeting_point
from surface_gym.rendering.palette import GOAL, axis_colour, exit_colour
from surface_gym.rendering.strokes import inset
from tests.rendering.flow_lines import (
    HIGHEST,
    LONG,
    LOWEST,
    SMALL,
    at,
    changed,
    empty_line,
    pixel_finder,
)


@pytest.fixture
def empty():
    return empty_line()


@pytest.fixture(scope="module")
def pixel():
    return pixel_finder()


@pytest.mark.parametrize("place", [(0.5, 1.0), (1.5, 1.4), (4.13, 0.777), (5.5, 1.1)])
def test_a_parcel_is_drawn_where_it_is_with_y_upwards(empty, pixel, place):
    parcel = FlowParcel(SMALL, (*place, 0.0), 0)
    left, right, top, bottom = changed(
        draw_flow(replace(empty, parcels=(parcel,))), draw_flow(empty)
    )
    middle = (0.5 * (left + right), 0.5 * (top + bottom))
    np.testing.assert_allclose(middle, pixel(*place), atol=1.0)


def test_a_turned_parcel_is_drawn_to_scale(empty, pixel):
    parcel = FlowParcel(LONG, (5.0, 1.0, math.pi / 2), 0)
    left, right, top, bottom = changed(
        draw_flow(replace(empty, parcels=(parcel,))), draw_flow(empty)
    )
    a_metre = pixel(1.0, 0.0)[0] - pixel(0.0, 0.0)[0]
    assert bottom - top == pytest.approx(0.45 * a_metre, abs=3.0)
    assert right - left == pytest.approx(0.25 * a_metre, abs=3.0)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_parcel_shows_its_exit_s_colour_and_what_is_under_it(empty, pixel, place):
    centre = (5.0, 1.0)
    parcel = FlowParcel(sg.Rectangle(0.45, 0.45).outline, (*centre, 0.0), place)
    picture = draw_flow(replace(empty, parcels=(parcel,)))
    rim = pixel(centre[0] - 0.205, centre[1] - 0.05)
    assert at(picture, rim) == exit_colour(place)
    below = pixel(centre[0] - 0.08, centre[1] + 0.15)  # beside a module's bar
    mixed = 0.55 * np.array(exit_colour(place)) + 0.45 * np.array(axis_colour(math.pi / 2))
    np.testing.assert_allclose(at(picture, below), mixed, atol=2.0)


def front(empty, theta):
    """(2,) [px] from the middle of a parcel without a label to the mark at its front."""
    outline = sg.Rectangle(0.45, 0.45).outline
    bare = replace(empty, exits=(ExitMark("", 0, 6.0, 6.6),), delivered=(0,))
    bare = replace(bare, rotor=np.zeros((20, 66), bool))
    one = replace(bare, parcels=(FlowParcel(outline, (3.0, 1.0, theta), 0),))
    other = replace(bare, parcels=(FlowParcel(outline, (3.0, 1.0, theta + math.pi), 0),))
    picture, turned = draw_flow(one).astype(int), draw_flow(other).astype(int)
    darker = (picture - turned).sum(axis=2) < -60
    lighter = (picture - turned).sum(axis=2) > 60
    (rows, columns), (back_rows, back_columns) = np.nonzero(darker), np.nonzero(lighter)
    return np.array([columns.mean() - back_columns.mean(), back_rows.mean() - rows.mean()])


@pytest.mark.parametrize("degrees", [0, 45, 90, 200])
def test_a_mark_shows_a_parcel_s_front(empty, degrees):
    across, up = front(empty, math.radians(degrees))
    assert math.degrees(math.atan2(up, across)) % 360 == pytest.approx(degrees, abs=6.0)


def test_a_label_is_written_where_it_has_room_and_is_the_exit_s_name_by_default(empty):
    def drawn(outline, label):
        parcel = FlowParcel(outline, (3.0, 1.0, 0.0), 0, label=label)
        return draw_flow(replace(empty, parcels=(parcel,)))

    np.testing.assert_array_equal(drawn(SMALL, ""), drawn(SMALL, "A"))
    assert (drawn(SMALL, "B") != drawn(SMALL, "A")).any()
    np.testing.assert_array_equal(drawn(SMALL, "B" * 20), drawn(SMALL, "C" * 20))
    tiny = sg.Rectangle(0.1, 0.1).outline
    np.testing.assert_array_equal(drawn(tiny, "A"), drawn(tiny, "B"))


def test_a_parcel_that_leaves_the_band_is_not_drawn_over_the_strips(empty, pixel):
    parcel = FlowParcel(LONG, (2.5, HIGHEST, 0.3), 0)
    _, _, top, _ = changed(draw_flow(replace(empty, parcels=(parcel,))), draw_flow(empty))
    assert top == round(pixel(0.0, HIGHEST)[1])
    gone = FlowParcel(LONG, (6.6, 1.0, 0.0), 2)
    _, right, _, _ = changed(draw_flow(replace(empty, parcels=(gone,))), draw_flow(empty))
    assert right == round(pixel(6.6, 0.0)[0])


def test_outlines_of_other_shapes_and_turns_are_drawn_alike(empty):
    def drawn(outline):
        return draw_flow(replace(empty, parcels=(FlowParcel(outline, (3.0, 1.0, 0.4), 0),)))

    clockwise, given = drawn(SMALL[::-1]).astype(int), drawn(SMALL).astype(int)
    assert (np.abs(clockwise - given).max(axis=2) > 40).mean() < 1e-5
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    disc = 0.15 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    notched = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [0.0, 0.05], [-0.2, 0.2]])
    for outline in (disc, notched):
        assert (drawn(outline) != draw_flow(empty)).any()


@pytest.mark.parametrize("turn", [1, -1])
def test_an_inset_square_is_smaller_all_round(turn):
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    smaller = np.array([[2.0, 2.0], [8.0, 2.0], [8.0, 8.0], [2.0, 8.0]])
    np.testing.assert_allclose(inset(square[::turn], 2.0), smaller[::turn])


def test_a_trail_runs_where_the_parcel_has_been(empty, pixel):
    trail = np.stack([np.linspace(4.0, 5.0, 40), np.full(40, 0.95)], axis=-1)
    parcel = FlowParcel(SMALL, (5.0, 0.95, 0.0), 1)
    without = draw_flow(replace(empty, parcels=(parcel,)))
    picture = draw_flow(replace(empty, parcels=(replace(parcel, trail=trail),)))
    left, right, top, bottom = changed(picture, without)
    assert left == pytest.approx(pixel(4.0, 0.0)[0], abs=2.0)
    assert right <= pixel(5.0, 0.0)[0] + 2.0
    assert 0.5 * (top + bottom) == pytest.approx(pixel(0.0, 0.95)[1], abs=1.0)
    assert bottom - top < 10
    assert at(picture, pixel(4.8, 0.95)) == exit_colour(1)
    one = replace(parcel, trail=trail[:1])
    np.testing.assert_array_equal(draw_flow(replace(empty, parcels=(one,))), without)


def test_what_the_sensors_see_is_dashed_and_in_the_legend(empty, pixel):
    parcel = FlowParcel(SMALL, (5.0, 1.0, 0.0), 1)
    without = draw_flow(replace(empty, parcels=(parcel,)))
    sensed = replace(parcel, sensed_pose=(5.5, 1.0, 0.0))
    picture = draw_flow(replace(empty, parcels=(sensed,)))
    foot = round(pixel(0.0, LOWEST)[1]) + 40
    left, right, top, bottom = changed(picture[:foot], without[:foot])
    middle = (0.5 * (left + right), 0.5 * (top + bottom))
    np.testing.assert_allclose(middle, pixel(5.5, 1.0), atol=1.0)
    assert (picture[foot:] != without[foot:]).any()


def test_a_flash_marks_where_two_parcels_touch(empty, pixel):
    pair = (FlowParcel(LONG, (3.0, 1.0, 0.0), 0), FlowParcel(SMALL, (3.355, 1.05, 0.0), 1))
    apart = draw_flow(replace(empty, parcels=pair))
    picture = draw_flow(replace(empty, parcels=pair, touching=((0, 1),)))
    left, right, top, bottom = changed(picture, apart)
    middle = (0.5 * (left + right), 0.5 * (top + bottom))
    np.testing.assert_allclose(middle, pixel(3.2275, 1.025), atol=2.0)
    assert (picture[top:bottom, left:right] == GOAL).all(axis=2).sum() > 20


@pytest.mark.parametrize(
    ("pose", "where"),
    [
        ((0.35, 0.0, 0.0), (0.225, 0.0)),  # edge against edge: the middle of both
        ((0.35, 0.2, 0.0), (0.225, 0.1)),  # of the part of the edges that meet
        ((0.225 + 0.125 * math.sqrt(2.0), 0.05, math.pi / 4), (0.225, 0.05)),  # a corner
    ],
)
def test_parcels_meet_in_the_middle_of_what_touches(pose, where):
    first, second = FlowParcel(LONG, (0.0, 0.0, 0.0), 0), FlowParcel(SMALL, pose, 0)
    np.testing.assert_allclose(meeting_point(first, second), where, atol=0.01)
    np.testing.assert_allclose(meeting_point(second, first), where, atol=0.01)
