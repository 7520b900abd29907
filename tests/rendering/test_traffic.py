"""Pictures of streams: exits, queue, counts and the parcels in the colours of their exits."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.rendering import ExitMark, InletMark, SceneParcel, Traffic, draw
from surface_gym.rendering.ink import FAINT_INK, GOAL, PLATE, RUNS, STANDS, axis_colour, exit_colour
from surface_gym.rendering.marks import contact_point
from tests.rendering.conftest import EXITS, HIGHEST, LONG, LOWEST, SMALL, Plate, differing, middle

NO_EXITS = Traffic((), ())


def with_traffic(scene, **fields):
    return replace(scene, traffic=replace(scene.traffic, **fields))


def with_parcels(scene, *parcels):
    return replace(scene, parcels=parcels)


@pytest.fixture
def plate(empty):
    return Plate(empty)


@pytest.fixture
def head(plate):
    """[px] above the chutes' labels."""
    return plate.top - 40


def at(picture, place):
    """The colour at fractions of a pixel (column, row)."""
    return tuple(picture[int(place[1]), int(place[0])].tolist())


class TestLine:
    def test_a_picture_is_a_wide_strip_to_scale(self, busy, plate):
        height, width, _ = draw(busy).shape
        assert width == 1280
        assert 2.5 < width / height < 3.5
        across = (plate.bottom - plate.top) / (HIGHEST - LOWEST)
        assert across == pytest.approx(10.0 * plate.cell)

    def test_chutes_have_their_exit_s_colour_on_their_side(self, empty, plate):
        picture = draw(empty)
        (x, top), (y, bottom) = plate.pixel(1.1, HIGHEST), plate.pixel(3.1, LOWEST)
        assert at(picture, (x, top - 0.5 * plate.cell)) == exit_colour(0)
        assert at(picture, (y, bottom + 0.5 * plate.cell)) == exit_colour(1)
        assert at(picture, plate.pixel(6.65, 1.0)) == exit_colour(2)

    @pytest.mark.parametrize("mark", EXITS[:2])
    def test_a_chute_takes_its_span_beside_the_rotor_rows(self, empty, plate, mark):
        without = draw(replace(empty, traffic=NO_EXITS))
        picture = draw(replace(empty, traffic=Traffic((mark,), (0,))))
        edge = plate.pixel(0.0, 1.0 + 0.2 * mark.side)[1]
        beside = slice(*sorted(int(row) for row in (edge, edge - 40 * mark.side)))
        columns = np.flatnonzero((picture != without).any(axis=2)[beside].any(axis=0))
        for column, x in ((columns[0], mark.first), (columns[-1] + 1, mark.last)):
            assert column == pytest.approx(plate.pixel(x, 1.0)[0], abs=1.0)
        rotor_rows = slice(math.ceil(plate.pixel(0.0, 1.2)[1]), int(plate.pixel(0.0, 0.8)[1]))
        np.testing.assert_array_equal(picture[rotor_rows], without[rotor_rows])

    @pytest.mark.parametrize("index", [0, 1, 2])
    def test_a_delivery_changes_its_exit_s_label_and_the_head(self, empty, plate, head, index):
        counts = tuple(7 * (k == index) for k in range(3))
        before, after = draw(empty), draw(with_traffic(empty, delivered=counts))
        assert (after[:head] != before[:head]).any()
        left, right, _, _ = differing(after[head:], before[head:])
        mark = EXITS[index]
        first, last = (6.6, 8.0) if mark.side == 0 else (mark.first, mark.last)
        assert plate.pixel(first, 0.0)[0] <= left < right <= plate.pixel(last, 0.0)[0]

    def test_the_queue_and_missorted_parcels_are_counted(self, empty, plate, head):
        none = draw(empty)
        pictures = [draw(with_traffic(empty, waiting=count)) for count in (1, 3, 120)]
        assert all(differing(picture, none)[1] <= plate.left for picture in pictures)
        assert (pictures[1] != pictures[2]).any()
        for count, least, most in ((0, 0, 0), (3, 11, 1000)):
            picture = draw(with_traffic(empty, missorted=count))[:head]
            assert least <= (picture == GOAL).all(axis=2).sum() <= most

    def test_many_and_long_readings_stay_within_the_head(self, busy, head):
        readings = tuple((f"reading {k}", "12345.678 m/s") for k in range(12))
        picture, plain = draw(replace(busy, readings=readings)), draw(busy)
        assert (picture[:head] != plain[:head]).any()
        np.testing.assert_array_equal(picture[head:], plain[head:])

    def test_exits_beyond_the_colours_repeat_them_and_the_legend_ends_in_time(self, empty):
        exits = tuple(ExitMark(f"chute {k}", 1, 0.5 * k, 0.5 * k + 0.45) for k in range(12))
        picture = draw(replace(empty, traffic=Traffic(exits, (0,) * 12), tilt=-0.05), 960)
        assert (picture[-40:, -24:] == 255).all()

    def test_a_surface_without_rotors_and_one_full_of_them_are_drawn(self, empty):
        bare, full = (draw(replace(empty, rotor=np.full((20, 66), each))) for each in (False, True))
        assert bare.shape == full.shape
        assert (bare == PLATE).all(axis=2).mean() > 0.2

    @pytest.mark.parametrize("pitch", [(0.1, 0.2), (0.2, 0.1)])
    def test_elements_that_are_not_square_keep_the_scale(self, empty, pitch):
        origin = (0.5 * pitch[0], 0.5 * pitch[1])
        oblong = replace(empty, pitch=pitch, origin=origin, traffic=Traffic(EXITS[:1], (0,)))
        parcel = SceneParcel(SMALL, (3.0, 10.0 * pitch[1], 0.0), 0)
        left, right, top, bottom = differing(draw(with_parcels(oblong, parcel)), draw(oblong))
        assert right - left == pytest.approx(bottom - top, abs=2.0)


class TestSlope:
    """What the tasks with a take-away draw beside."""

    MOUTH = ExitMark("mouth", 0, 6.0, 6.6, (0.9, 1.1))

    def test_a_bar_closes_the_end_beside_a_mouth(self, empty, plate):
        picture = draw(replace(empty, traffic=Traffic((self.MOUTH,), (0,))))
        for y, closed in ((0.85, True), (0.95, False), (1.05, False), (1.15, True), (1.25, False)):
            assert (at(picture, plate.pixel(6.015, y)) == FAINT_INK) == closed
        whole = draw(replace(empty, traffic=Traffic((replace(self.MOUTH, span=None),), (0,))))
        assert at(whole, plate.pixel(6.015, 0.85)) != FAINT_INK

    def test_exits_have_the_colour_of_the_take_away(self, empty, plate):
        for runs, colour in ((True, RUNS), (False, STANDS), (None, exit_colour(0))):
            traffic = Traffic((self.MOUTH,), (0,), runs=runs)
            picture = draw(replace(empty, traffic=traffic))
            assert at(picture, plate.pixel(6.65, 1.0)) == colour

    @pytest.mark.parametrize("side", [0, 1, -1])
    def test_inlets_are_marked_with_their_queues(self, empty, plate, side):
        span = (0.85, 1.15) if side == 0 else (1.0, 2.0)
        traffic = Traffic(EXITS[2:], (0,), inlets=(InletMark("in", side, *span),), queues=(3,))
        none = replace(traffic, inlets=(), queues=())
        picture, more, without = (
            draw(replace(empty, traffic=each))
            for each in (traffic, replace(traffic, queues=(4,)), none)
        )
        assert (picture != more).any()
        rows = {0: slice(None), 1: slice(0, plate.top), -1: slice(plate.bottom, None)}[side]
        columns = slice(0, plate.left) if side == 0 else slice(plate.left, None)
        left, right, _, _ = differing(picture[rows, columns], without[rows, columns])
        if side:
            assert right - left == pytest.approx(10.0 * plate.cell, abs=1.0)

    def test_the_queue_is_within_a_picture_full_of_rotors(self, empty):
        full = replace(empty, rotor=np.ones((20, 66), bool), traffic=NO_EXITS)
        pictures = (draw(with_traffic(full, waiting=count)) for count in (0, 3))
        _, _, top, bottom = differing(*pictures)
        assert top > 0.4 * bottom

    def test_groups_have_colours_and_one_that_is_wrong_a_border(self, empty, plate):
        parcel = SceneParcel(sg.Rectangle(0.45, 0.45).outline, (5.0, 1.0, 0.0), group=1)
        picture = draw(with_parcels(empty, parcel))
        assert at(picture, plate.pixel(4.795, 0.95)) == exit_colour(1)
        assert not (picture == GOAL).all(axis=2).any()
        wrong = draw(with_parcels(empty, replace(parcel, wrong=True)))
        assert (wrong == GOAL).all(axis=2).sum() > 200
        for label in ("", "12"):
            other = draw(with_parcels(empty, replace(parcel, label=label)))
            assert (other == picture).all() == (label == "")


class TestParcels:
    @pytest.mark.parametrize("index", [0, 1, 2])
    def test_one_shows_its_exit_s_colour_and_the_modules_under_it(self, empty, plate, index):
        parcel = SceneParcel(sg.Rectangle(0.45, 0.45).outline, (5.0, 1.0, 0.0), index)
        picture = draw(with_parcels(empty, parcel))
        assert at(picture, plate.pixel(4.795, 0.95)) == exit_colour(index)
        below = plate.pixel(4.92, 1.15)  # beside a module's bar
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

    def test_one_without_an_exit_is_grey(self, empty, plate):
        bare = replace(empty, rotor=np.zeros((20, 66), bool), traffic=NO_EXITS)
        picture = draw(with_parcels(bare, SceneParcel(LONG, (3.0, 1.0, 0.0))))
        assert np.ptp(at(picture, plate.pixel(2.9, 1.1))) < 12

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

    def test_a_trail_has_the_exit_s_colour(self, empty, plate):
        trail = np.stack([np.linspace(4.0, 5.0, 40), np.full(40, 0.95)], axis=-1)
        parcel = SceneParcel(SMALL, (5.0, 0.95, 0.0), 1)
        parcels = (replace(parcel, trail=trail[:length]) for length in (0, 1, 40))
        without, one, whole = (draw(with_parcels(empty, each)) for each in parcels)
        assert at(whole, plate.pixel(4.8, 0.95)) == exit_colour(1)
        np.testing.assert_array_equal(one, without)


class TestTouches:
    def test_a_flash_marks_where_two_parcels_touch(self, empty, plate):
        pair = (SceneParcel(LONG, (3.0, 1.0, 0.0), 0), SceneParcel(SMALL, (3.355, 1.05, 0.0), 1))
        apart = draw(with_parcels(empty, *pair))
        picture = draw(replace(empty, parcels=pair, touching=((0, 1),)))
        left, right, top, bottom = box = differing(picture, apart)
        np.testing.assert_allclose(middle(box), plate.pixel(3.2275, 1.025), atol=2.0)
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
