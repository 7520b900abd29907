import math
from dataclasses import replace

import numpy as np
import pygame
import pytest

from surface_gym.rendering import ExitMark, FlowPainter, FlowParcel, FlowScene, draw_flow
from surface_gym.rendering.palette import GOAL, PLATE, exit_colour
from tests.rendering.flow_lines import (
    EXITS,
    HIGHEST,
    LOWEST,
    SMALL,
    at,
    busy_line,
    changed,
    empty_line,
    pixel_finder,
)


@pytest.fixture
def empty():
    return empty_line()


@pytest.fixture
def busy():
    return busy_line()


@pytest.fixture(scope="module")
def pixel():
    return pixel_finder()


@pytest.mark.parametrize("width", [640, 960, 1280])
def test_a_picture_is_a_wide_strip_of_even_height(busy, width):
    picture = draw_flow(busy, width)
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (width, 3)
    assert picture.shape[0] % 2 == 0
    assert picture.flags.writeable
    assert 2.5 < width / picture.shape[0] < 3.5


def test_all_scenes_of_a_line_have_one_size(busy, empty):
    full = replace(busy, zone=(8, 4, 10, 20), tilt=0.1, title="A" * 200)
    without = replace(empty, exits=(), delivered=())
    assert draw_flow(full).shape == draw_flow(empty).shape == draw_flow(without).shape


def test_the_surface_is_drawn_to_scale(pixel):
    (left, top), (right, bottom) = pixel(0.0, HIGHEST), pixel(6.6, LOWEST)
    assert (bottom - top) / (HIGHEST - LOWEST) == (right - left) / 6.6


def test_a_kept_painter_draws_as_a_fresh_one(busy, empty):
    painter = FlowPainter()
    other = replace(busy, exits=(EXITS[0], ExitMark("C", -1, 2.0, 2.5), EXITS[2]))
    wide = np.zeros((20, 66), bool)
    wide[6:14] = True
    scenes = [busy, empty, other, replace(busy, zone=(8, 4, 0, 30)), replace(busy, rotor=wide)]
    for scene in (*scenes, busy):
        np.testing.assert_array_equal(painter.draw(scene), draw_flow(scene))


def test_chutes_have_their_exit_s_colour_on_their_side(empty, pixel):
    picture = draw_flow(empty)
    cell = pixel(0.1, 0.0)[0] - pixel(0.0, 0.0)[0]
    (x, top), (y, bottom) = pixel(1.1, HIGHEST), pixel(3.1, LOWEST)
    assert at(picture, (x, top - 0.5 * cell)) == exit_colour(0)
    assert at(picture, (y, bottom + 0.5 * cell)) == exit_colour(1)
    beyond, middle = pixel(6.65, 1.0)
    assert at(picture, (beyond, middle)) == exit_colour(2)


@pytest.mark.parametrize(("place", "side", "span"), [(0, 1, (1.0, 2.0)), (1, -1, (3.0, 4.0))])
def test_a_chute_s_mouth_takes_its_span_beside_the_rotor_rows(empty, pixel, place, side, span):
    without = draw_flow(replace(empty, exits=(), delivered=()))
    exits, delivered = (EXITS[place],), (0,)
    picture = draw_flow(replace(empty, exits=exits, delivered=delivered))
    first, last = (pixel(x, 1.0)[0] for x in span)
    edge = pixel(0.0, 1.0 + 0.2 * side)[1]
    middle = slice(int(min(edge, edge - 40 * side)), int(max(edge, edge - 40 * side)))
    columns = np.flatnonzero((picture != without).any(axis=2)[middle].any(axis=0))
    assert columns[0] == pytest.approx(first, abs=1.0)
    assert columns[-1] + 1 == pytest.approx(last, abs=1.0)
    rotor_rows = slice(math.ceil(pixel(0.0, 1.2)[1]), int(pixel(0.0, 0.8)[1]))
    np.testing.assert_array_equal(picture[rotor_rows], without[rotor_rows])


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_delivery_changes_its_exit_s_label_and_the_head_alone(empty, pixel, place):
    before = draw_flow(empty)
    counts = [0, 0, 0]
    counts[place] = 7
    after = draw_flow(replace(empty, delivered=tuple(counts)))
    head = int(pixel(0.0, HIGHEST)[1]) - 40
    assert (after[:head] != before[:head]).any()
    left, right, _, _ = changed(after[head:], before[head:])
    mark = EXITS[place]
    first, last = (6.6, 8.0) if mark.side == 0 else (mark.first, mark.last)
    assert pixel(first, 0.0)[0] <= left < right <= pixel(last, 0.0)[0]


def test_the_queue_is_counted_at_the_entry(empty, pixel):
    none = draw_flow(empty)
    pictures = [draw_flow(replace(empty, waiting=count)) for count in (1, 3, 120)]
    for picture in pictures:
        _, right, _, _ = changed(picture, none)
        assert right <= pixel(0.0, 0.0)[0]
    assert (pictures[1] != pictures[2]).any()


def test_parcels_gone_astray_are_told_in_red(empty, pixel):
    head = int(pixel(0.0, HIGHEST)[1]) - 40

    def red(scene):
        return (draw_flow(scene)[:head] == GOAL).all(axis=2).sum()

    assert red(empty) == 0
    assert red(replace(empty, missorted=3)) > 10


def test_many_and_long_readings_stay_within_the_head(busy, pixel):
    head = int(pixel(0.0, HIGHEST)[1]) - 40
    readings = tuple((f"reading {k}", "12345.678 m/s") for k in range(12))
    picture, plain = draw_flow(replace(busy, readings=readings)), draw_flow(busy)
    assert (picture[:head] != plain[:head]).any()
    np.testing.assert_array_equal(picture[head:], plain[head:])


def test_exits_beyond_the_colours_take_them_again_and_the_legend_ends_in_time(empty):
    exits = tuple(ExitMark(f"chute {k}", 1, 0.5 * k, 0.5 * k + 0.45) for k in range(12))
    picture = draw_flow(replace(empty, exits=exits, delivered=(0,) * 12, tilt=-0.05), 960)
    assert exit_colour(7) == exit_colour(0)
    margin = picture[-40:, -24:]
    assert (margin == 255).all()


def test_a_surface_without_rotors_and_one_full_of_them_are_drawn(empty):
    bare = replace(empty, rotor=np.zeros((20, 66), bool))
    full = replace(empty, rotor=np.ones((20, 66), bool))
    assert draw_flow(bare).shape == draw_flow(full).shape
    assert (draw_flow(bare) == PLATE).all(axis=2).mean() > 0.2


@pytest.mark.parametrize("pitch", [(0.1, 0.2), (0.2, 0.1)])
def test_elements_that_are_not_square_keep_the_scale(empty, pitch):
    exits = (ExitMark("A", 1, 1.0, 2.0),)
    parcel = FlowParcel(SMALL, (3.0, 10.0 * pitch[1], 0.0), 0)
    oblong = replace(
        empty, pitch=pitch, origin=(0.5 * pitch[0], 0.5 * pitch[1]), exits=exits, delivered=(0,)
    )
    left, right, top, bottom = changed(
        draw_flow(replace(oblong, parcels=(parcel,))), draw_flow(oblong)
    )
    assert right - left == pytest.approx(bottom - top, abs=2.0)


@pytest.mark.parametrize(
    ("width", "message"),
    [
        (639, "width must be a whole number of at least 640"),
        (1281, "width must be even"),
    ],
)
def test_a_width_that_does_not_do_is_refused(empty, width, message):
    with pytest.raises(ValueError, match=message):
        draw_flow(empty, width)


def test_a_line_too_long_for_the_width_is_refused_with_the_width_it_needs():
    rotor = np.ones((4, 150), bool)
    long = FlowScene(np.zeros((4, 150)), rotor, exits=(), delivered=())
    with pytest.raises(ValueError, match="width must be at least 992 for 150 columns"):
        draw_flow(long, 640)
    assert draw_flow(long, 1280).shape[1] == 1280


def test_drawing_needs_no_display_and_outlives_pygame_quit(busy):
    painter = FlowPainter()
    first = painter.draw(busy)
    assert not pygame.display.get_init()
    pygame.quit()
    np.testing.assert_array_equal(painter.draw(busy), first)
