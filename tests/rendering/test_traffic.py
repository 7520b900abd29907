"""Pictures of streams: exits, queue, counts and the parcels in the colours of their exits."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.rendering import ExitMark, Scene, SceneParcel, Traffic, draw
from surface_gym.rendering.ink import GOAL, PLATE, PLATE_EDGE, axis_colour, exit_colour, inset
from surface_gym.rendering.marks import contact_point
from tests.rendering.conftest import EXITS, LONG, SMALL

HIGHEST, LOWEST = 1.7, 0.3  # [m] shown of the surface: 0.5 m beside the rotor rows
NO_EXITS = Traffic((), ())


def with_traffic(scene, **fields):
    return replace(scene, traffic=replace(scene.traffic, **fields))


def with_parcels(scene, *parcels):
    return replace(scene, parcels=parcels)


@pytest.fixture
def pixel(empty):
    """From [m] to fractions of a pixel (column, row), by the plate's border."""
    border = (draw(replace(empty, traffic=NO_EXITS)) == PLATE_EDGE).all(axis=2)
    rows = np.flatnonzero(border.mean(axis=1) > 0.7)
    columns = np.flatnonzero(border.mean(axis=0) > 0.4)
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1

    def pixel(x, y):
        column = left + (right - left) * x / 6.6
        return column, top + (bottom - top) * (HIGHEST - y) / (HIGHEST - LOWEST)

    return pixel


def at(picture, place):
    """The colour at fractions of a pixel (column, row)."""
    return tuple(picture[int(place[1]), int(place[0])].tolist())


def changed(scene, other):
    """(left, right, top, bottom) [px] of where the pictures of two scenes differ."""
    return differing(draw(scene), draw(other))


def differing(picture, other):
    rows, columns = np.nonzero((picture != other).any(axis=2))
    return columns.min(), columns.max() + 1, rows.min(), rows.max() + 1


class TestLine:
    def test_a_picture_is_a_wide_strip_to_scale(self, busy, pixel):
        height, width, _ = draw(busy).shape
        assert width == 1280
        assert 2.5 < width / height < 3.5
        (left, top), (right, bottom) = pixel(0.0, HIGHEST), pixel(6.6, LOWEST)
        assert (bottom - top) / (HIGHEST - LOWEST) == (right - left) / 6.6

    def test_all_scenes_of_a_line_have_one_size(self, busy, empty):
        full = replace(busy, zone=(8, 4, 10, 20), tilt=0.1, title="A" * 200)
        without = replace(empty, traffic=NO_EXITS)
        assert draw(full).shape == draw(empty).shape == draw(without).shape

    def test_chutes_have_their_exit_s_colour_on_their_side(self, empty, pixel):
        picture = draw(empty)
        cell = pixel(0.1, 0.0)[0] - pixel(0.0, 0.0)[0]
        (x, top), (y, bottom) = pixel(1.1, HIGHEST), pixel(3.1, LOWEST)
        assert at(picture, (x, top - 0.5 * cell)) == exit_colour(0)
        assert at(picture, (y, bottom + 0.5 * cell)) == exit_colour(1)
        assert at(picture, pixel(6.65, 1.0)) == exit_colour(2)

    @pytest.mark.parametrize(("index", "side", "span"), [(0, 1, (1.0, 2.0)), (1, -1, (3.0, 4.0))])
    def test_a_chute_takes_its_span_beside_the_rotor_rows(self, empty, pixel, index, side, span):
        without = draw(replace(empty, traffic=NO_EXITS))
        picture = draw(replace(empty, traffic=Traffic((EXITS[index],), (0,))))
        first, last = (pixel(x, 1.0)[0] for x in span)
        edge = pixel(0.0, 1.0 + 0.2 * side)[1]
        middle = slice(int(min(edge, edge - 40 * side)), int(max(edge, edge - 40 * side)))
        columns = np.flatnonzero((picture != without).any(axis=2)[middle].any(axis=0))
        assert columns[0] == pytest.approx(first, abs=1.0)
        assert columns[-1] + 1 == pytest.approx(last, abs=1.0)
        rotor_rows = slice(math.ceil(pixel(0.0, 1.2)[1]), int(pixel(0.0, 0.8)[1]))
        np.testing.assert_array_equal(picture[rotor_rows], without[rotor_rows])

    @pytest.mark.parametrize("index", [0, 1, 2])
    def test_a_delivery_changes_its_exit_s_label_and_the_head_alone(self, empty, pixel, index):
        counts = [0, 0, 0]
        counts[index] = 7
        before, after = draw(empty), draw(with_traffic(empty, delivered=tuple(counts)))
        head = int(pixel(0.0, HIGHEST)[1]) - 40
        assert (after[:head] != before[:head]).any()
        left, right, _, _ = differing(after[head:], before[head:])
        mark = EXITS[index]
        first, last = (6.6, 8.0) if mark.side == 0 else (mark.first, mark.last)
        assert pixel(first, 0.0)[0] <= left < right <= pixel(last, 0.0)[0]

    def test_the_queue_is_counted_at_the_entry(self, empty, pixel):
        none = draw(empty)
        pictures = [draw(with_traffic(empty, waiting=count)) for count in (1, 3, 120)]
        for picture in pictures:
            _, right, _, _ = differing(picture, none)
            assert right <= pixel(0.0, 0.0)[0]
        assert (pictures[1] != pictures[2]).any()

    def test_missorted_parcels_are_counted_in_red(self, empty, pixel):
        head = int(pixel(0.0, HIGHEST)[1]) - 40

        def red(scene):
            return (draw(scene)[:head] == GOAL).all(axis=2).sum()

        assert red(empty) == 0
        assert red(with_traffic(empty, missorted=3)) > 10

    def test_many_and_long_readings_stay_within_the_head(self, busy, pixel):
        head = int(pixel(0.0, HIGHEST)[1]) - 40
        readings = tuple((f"reading {k}", "12345.678 m/s") for k in range(12))
        picture, plain = draw(replace(busy, readings=readings)), draw(busy)
        assert (picture[:head] != plain[:head]).any()
        np.testing.assert_array_equal(picture[head:], plain[head:])

    def test_exits_beyond_the_colours_repeat_them_and_the_legend_ends_in_time(self, empty):
        exits = tuple(ExitMark(f"chute {k}", 1, 0.5 * k, 0.5 * k + 0.45) for k in range(12))
        picture = draw(replace(empty, traffic=Traffic(exits, (0,) * 12), tilt=-0.05), 960)
        assert exit_colour(7) == exit_colour(0)
        assert (picture[-40:, -24:] == 255).all()

    def test_a_surface_without_rotors_and_one_full_of_them_are_drawn(self, empty):
        bare = replace(empty, rotor=np.zeros((20, 66), bool))
        full = replace(empty, rotor=np.ones((20, 66), bool))
        assert draw(bare).shape == draw(full).shape
        assert (draw(bare) == PLATE).all(axis=2).mean() > 0.2

    @pytest.mark.parametrize("pitch", [(0.1, 0.2), (0.2, 0.1)])
    def test_elements_that_are_not_square_keep_the_scale(self, empty, pitch):
        oblong = replace(
            empty,
            pitch=pitch,
            origin=(0.5 * pitch[0], 0.5 * pitch[1]),
            traffic=Traffic(EXITS[:1], (0,)),
        )
        parcel = SceneParcel(SMALL, (3.0, 10.0 * pitch[1], 0.0), 0)
        left, right, top, bottom = changed(with_parcels(oblong, parcel), oblong)
        assert right - left == pytest.approx(bottom - top, abs=2.0)

    def test_a_line_too_long_for_the_width_is_refused_with_the_width_it_needs(self):
        long = Scene(np.zeros((4, 150)), np.ones((4, 150), bool), traffic=NO_EXITS)
        with pytest.raises(ValueError, match="width must be at least 992 for 150 columns"):
            draw(long, 640)
        assert draw(long, 1280).shape[1] == 1280


class TestParcels:
    @pytest.mark.parametrize("place", [(0.5, 1.0), (1.5, 1.4), (4.13, 0.777), (5.5, 1.1)])
    def test_one_is_drawn_where_it_is_with_y_upwards(self, empty, pixel, place):
        parcel = SceneParcel(SMALL, (*place, 0.0), 0)
        left, right, top, bottom = changed(with_parcels(empty, parcel), empty)
        middle = (0.5 * (left + right), 0.5 * (top + bottom))
        np.testing.assert_allclose(middle, pixel(*place), atol=1.0)

    def test_a_turned_one_is_drawn_to_scale(self, empty, pixel):
        parcel = SceneParcel(LONG, (5.0, 1.0, math.pi / 2), 0)
        left, right, top, bottom = changed(with_parcels(empty, parcel), empty)
        a_metre = pixel(1.0, 0.0)[0] - pixel(0.0, 0.0)[0]
        assert bottom - top == pytest.approx(0.45 * a_metre, abs=3.0)
        assert right - left == pytest.approx(0.25 * a_metre, abs=3.0)

    @pytest.mark.parametrize("index", [0, 1, 2])
    def test_one_shows_its_exit_s_colour_and_the_modules_under_it(self, empty, pixel, index):
        centre = (5.0, 1.0)
        parcel = SceneParcel(sg.Rectangle(0.45, 0.45).outline, (*centre, 0.0), index)
        picture = draw(with_parcels(empty, parcel))
        assert at(picture, pixel(centre[0] - 0.205, centre[1] - 0.05)) == exit_colour(index)
        below = pixel(centre[0] - 0.08, centre[1] + 0.15)  # beside a module's bar
        mixed = 0.55 * np.array(exit_colour(index)) + 0.45 * np.array(axis_colour(math.pi / 2))
        np.testing.assert_allclose(at(picture, below), mixed, atol=2.0)

    @pytest.mark.parametrize("degrees", [0, 45, 90, 200])
    def test_a_mark_shows_its_front(self, empty, degrees):
        outline, theta = sg.Rectangle(0.45, 0.45).outline, math.radians(degrees)
        traffic = Traffic((ExitMark("", 0, 6.0, 6.6),), (0,))
        bare = replace(empty, rotor=np.zeros((20, 66), bool), traffic=traffic)
        picture, turned = (
            draw(with_parcels(bare, SceneParcel(outline, (3.0, 1.0, angle), 0))).astype(int)
            for angle in (theta, theta + math.pi)
        )
        change = (picture - turned).sum(axis=2)
        (rows, columns), (back_rows, back_columns) = map(np.nonzero, (change < -60, change > 60))
        across, up = columns.mean() - back_columns.mean(), back_rows.mean() - rows.mean()
        assert math.degrees(math.atan2(up, across)) % 360 == pytest.approx(degrees, abs=6.0)

    def test_a_label_is_written_where_it_has_room_by_default_the_exit_s_name(self, empty):
        def drawn(outline, label):
            return draw(with_parcels(empty, SceneParcel(outline, (3.0, 1.0, 0.0), 0, label=label)))

        np.testing.assert_array_equal(drawn(SMALL, ""), drawn(SMALL, "A"))
        assert (drawn(SMALL, "B") != drawn(SMALL, "A")).any()
        np.testing.assert_array_equal(drawn(SMALL, "B" * 20), drawn(SMALL, "C" * 20))
        tiny = sg.Rectangle(0.1, 0.1).outline
        np.testing.assert_array_equal(drawn(tiny, "A"), drawn(tiny, "B"))

    def test_one_without_an_exit_is_grey(self, empty, pixel):
        bare = replace(empty, rotor=np.zeros((20, 66), bool), traffic=NO_EXITS)
        picture = draw(with_parcels(bare, SceneParcel(LONG, (3.0, 1.0, 0.0))))
        red, green, blue = at(picture, pixel(2.9, 1.1))
        assert max(red, green, blue) - min(red, green, blue) < 12

    def test_one_that_leaves_the_rows_shown_is_not_drawn_over_the_strips(self, empty, pixel):
        _, _, top, _ = changed(
            with_parcels(empty, SceneParcel(LONG, (2.5, HIGHEST, 0.3), 0)), empty
        )
        assert top == round(pixel(0.0, HIGHEST)[1])
        _, right, _, _ = changed(with_parcels(empty, SceneParcel(LONG, (6.6, 1.0, 0.0), 2)), empty)
        assert right == round(pixel(6.6, 0.0)[0])

    def test_outlines_of_other_shapes_and_orders_are_drawn_alike(self, empty):
        def drawn(outline):
            return draw(with_parcels(empty, SceneParcel(outline, (3.0, 1.0, 0.4), 0)))

        clockwise, given = drawn(SMALL[::-1]).astype(int), drawn(SMALL).astype(int)
        assert (np.abs(clockwise - given).max(axis=2) > 40).mean() < 1e-5
        angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        disc = 0.15 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        notched = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [0.0, 0.05], [-0.2, 0.2]])
        for outline in (disc, notched):
            assert (drawn(outline) != draw(empty)).any()

    @pytest.mark.parametrize("turn", [1, -1])
    def test_an_inset_square_is_smaller_all_round(self, turn):
        square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
        smaller = np.array([[2.0, 2.0], [8.0, 2.0], [8.0, 8.0], [2.0, 8.0]])
        np.testing.assert_allclose(inset(square[::turn], 2.0), smaller[::turn])

    def test_a_trail_runs_where_the_parcel_has_been(self, empty, pixel):
        trail = np.stack([np.linspace(4.0, 5.0, 40), np.full(40, 0.95)], axis=-1)
        parcel = SceneParcel(SMALL, (5.0, 0.95, 0.0), 1)
        without = draw(with_parcels(empty, parcel))
        picture = draw(with_parcels(empty, replace(parcel, trail=trail)))
        left, right, top, bottom = differing(picture, without)
        assert left == pytest.approx(pixel(4.0, 0.0)[0], abs=2.0)
        assert right <= pixel(5.0, 0.0)[0] + 2.0
        assert 0.5 * (top + bottom) == pytest.approx(pixel(0.0, 0.95)[1], abs=1.0)
        assert bottom - top < 10
        assert at(picture, pixel(4.8, 0.95)) == exit_colour(1)
        one = replace(parcel, trail=trail[:1])
        np.testing.assert_array_equal(draw(with_parcels(empty, one)), without)

    def test_the_pose_that_the_sensors_see_is_dashed_and_in_the_legend(self, empty, pixel):
        parcel = SceneParcel(SMALL, (5.0, 1.0, 0.0), 1)
        without = draw(with_parcels(empty, parcel))
        picture = draw(with_parcels(empty, replace(parcel, sensed_pose=(5.5, 1.0, 0.0))))
        foot = round(pixel(0.0, LOWEST)[1]) + 40
        left, right, top, bottom = differing(picture[:foot], without[:foot])
        middle = (0.5 * (left + right), 0.5 * (top + bottom))
        np.testing.assert_allclose(middle, pixel(5.5, 1.0), atol=1.0)
        assert (picture[foot:] != without[foot:]).any()


class TestTouches:
    def test_a_flash_marks_where_two_parcels_touch(self, empty, pixel):
        pair = (SceneParcel(LONG, (3.0, 1.0, 0.0), 0), SceneParcel(SMALL, (3.355, 1.05, 0.0), 1))
        apart = draw(with_parcels(empty, *pair))
        picture = draw(replace(empty, parcels=pair, touching=((0, 1),)))
        left, right, top, bottom = differing(picture, apart)
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
    def test_parcels_meet_in_the_middle_of_the_region_that_touches(self, pose, where):
        first, second = SceneParcel(LONG, (0.0, 0.0, 0.0)), SceneParcel(SMALL, pose)
        np.testing.assert_allclose(contact_point(first, second), where, atol=0.01)
        np.testing.assert_allclose(contact_point(second, first), where, atol=0.01)
