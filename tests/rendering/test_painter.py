"""Pictures of one parcel on a surface."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pygame
import pytest

import surface_gym as sg
from surface_gym.rendering import (
    ExitMark,
    ExitSide,
    ExitSpeed,
    Heading,
    Painter,
    Path,
    Scene,
    StopLine,
    Traffic,
    draw,
)
from surface_gym.rendering.ink import GOAL, INK, PLATE_EDGE, SENSED, axis_colour
from tests.rendering.conftest import EXITS

GOALS = {
    "none": None,
    "side": ExitSide(1),
    "end": ExitSide(0),
    "stop": StopLine(1.5),
    "slow": ExitSpeed(0.5, 0.75),
    "path": Path([[0.5, 1.0], [1.5, 1.2], [3.0, 0.8]]),
    "path of one point": Path([[0.5, 1.0], [0.5, 1.0]]),
    "turn": Heading(1.2),
}


def plate(picture):
    """(top, bottom, left, right) [px] of the surface within a picture, by its border."""
    border = (picture == PLATE_EDGE).all(axis=2)
    rows = np.flatnonzero(border.mean(axis=1) > 0.8)
    columns = np.flatnonzero(border.mean(axis=0) > 0.5)
    return rows[0], rows[-1] + 1, columns[0], columns[-1] + 1


def pixel_of(picture, scene, x, y):
    """Fractions of a pixel (column, row) of a point of the surface."""
    top, bottom, left, right = plate(picture)
    width, height = scene.columns * scene.pitch, scene.rows * scene.pitch
    return left + (right - left) * x / width, bottom - (bottom - top) * y / height


def with_parcel(scene, **fields):
    """A scene whose only parcel has other fields."""
    return replace(scene, parcels=(replace(scene.parcels[0], **fields),))


def middle_of(mask):
    """(column, row) of the mean of the pixels in a mask."""
    rows, columns = np.nonzero(mask)
    return columns.mean() + 0.5, rows.mean() + 0.5


@pytest.mark.parametrize("width", [640, 960, 1280])
def test_a_picture_has_the_width_asked_and_an_even_height(sorting, busy, width):
    assert draw(busy, width).shape[1:] == (width, 3)
    picture = draw(sorting.scene(50), width)
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (width, 3)
    assert picture.shape[0] % 2 == 0
    assert picture.flags.writeable


@pytest.mark.parametrize("goal", GOALS.values(), ids=GOALS)
def test_all_scenes_of_a_surface_have_one_size(sorting, bare, goal):
    full = sorting.scene(80, goal=goal, tilt=0.1, sensed_pose=(0.5, 1.0, 0.1), title="A" * 200)
    assert draw(full).shape == draw(bare).shape


def test_a_kept_painter_draws_as_a_fresh_one(sorting, bare, busy, empty):
    small = replace(bare, axis=np.ones((5, 12)), rotor=np.ones((5, 12), bool))
    scenes = [
        bare,
        sorting.scene(60),
        sorting.scene(60, zone=(9, 2, 5, 10)),
        sorting.scene(60, zone=None, goal=None),
        small,
        replace(small, pitch=0.2),
        busy,
        empty,
        replace(busy, zone=(8, 4, 0, 30)),
        replace(busy, rotor=np.ones((20, 66), bool)),
        replace(busy, traffic=Traffic((*EXITS[:2], ExitMark("C", -1, 2.0, 2.5)), (0, 0, 0))),
        bare,
    ]
    painter = Painter()
    for scene in scenes:
        np.testing.assert_array_equal(painter.draw(scene), draw(scene))


@pytest.mark.parametrize("place", [(2.0, 1.0), (0.7, 1.6), (3.313, 0.427)])
def test_a_parcel_is_drawn_where_it_is_with_y_upwards(bare, place):
    scene = with_parcel(bare, pose=(*place, 0.0))
    picture, empty = draw(scene), draw(replace(bare, parcels=()))
    there = (picture != empty).any(axis=2)
    np.testing.assert_allclose(middle_of(there), pixel_of(empty, scene, *place), atol=1.0)


def test_the_outline_is_drawn_to_scale(bare):
    empty = draw(replace(bare, parcels=()))
    outline = sg.Rectangle(0.6, 0.2).outline
    there = (draw(with_parcel(bare, outline=outline, pose=(2.0, 1.0, math.pi / 2))) != empty).any(
        axis=2
    )
    rows, columns = np.nonzero(there)
    a_metre = pixel_of(empty, bare, 1.0, 0.0)[0] - pixel_of(empty, bare, 0.0, 0.0)[0]
    assert np.ptp(rows) + 1 == pytest.approx(0.6 * a_metre, abs=4.0)
    assert np.ptp(columns) + 1 == pytest.approx(0.2 * a_metre, abs=4.0)


def test_a_parcel_off_the_surface_is_not_drawn_over_the_strips(bare):
    empty = draw(replace(bare, parcels=()))
    top, bottom, _, _ = plate(empty)
    above = draw(with_parcel(bare, pose=(2.0, 2.0, 0.3)))
    np.testing.assert_array_equal(above[:top], empty[:top])
    np.testing.assert_array_equal(above[bottom:], empty[bottom:])
    assert (above != empty).any()


@pytest.mark.parametrize("degrees", [0, 45, -45, 90, 17, 135, 225])
def test_a_module_has_its_axis_s_colour_and_a_bar_along_it(degrees):
    angle = math.radians(degrees)
    scene = Scene(np.full((4, 4), angle), np.ones((4, 4), bool))
    picture = draw(scene, 640).astype(int)
    x, y = pixel_of(picture, scene, 0.25, 0.25)
    cell = pixel_of(picture, scene, 0.1, 0.0)[0] - pixel_of(picture, scene, 0.0, 0.0)[0]

    def at(direction):
        column = x + 0.25 * cell * math.cos(direction)
        return picture[int(y - 0.25 * cell * math.sin(direction)), int(column)]

    np.testing.assert_array_equal(at(angle + math.pi / 2), axis_colour(angle))
    assert at(angle).min() > 250
    assert at(angle + math.pi).min() > 250


def test_modules_that_do_not_obey_are_paler(sorting):
    scene = sorting.scene(0, goal=None)
    whole, zoned = draw(replace(scene, zone=None)), draw(scene)

    def contrast(picture, first, last):
        left, low = (int(at) for at in pixel_of(whole, scene, first, 0.91))
        right, high = (int(at) for at in pixel_of(whole, scene, last, 1.09))
        return np.ptp(picture[high:low, left:right].astype(int), axis=(0, 1)).sum()

    assert contrast(zoned, 2.0, 3.9) < 0.6 * contrast(whole, 2.0, 3.9)
    assert contrast(zoned, 0.5, 1.8) == contrast(whole, 0.5, 1.8)


def red(picture):
    return (picture == GOAL).all(axis=2)


def test_a_stop_line_is_drawn_at_its_x(sorting):
    scene = sorting.scene(0, goal=StopLine(1.7), zone=None)
    picture = draw(replace(scene, goal=StopLine(1.7)))
    top, bottom, _, _ = plate(picture)
    middle, _ = middle_of(red(picture[top:bottom]))
    assert middle == pytest.approx(pixel_of(picture, scene, 1.7, 1.0)[0], abs=2.0)


@pytest.mark.parametrize("x", [0.0, 2.0, 4.0])
def test_a_label_is_whole_even_where_the_line_fills_the_surface(sorting, bare, x):
    surface = sorting.surface
    line = replace(bare, rotor=surface.rotor, parcels=(), goal=StopLine(x))
    full = replace(line, rotor=np.ones((20, 40), bool))
    top, bottom, left, right = plate(draw(bare))
    at_line = round(pixel_of(draw(bare), bare, x, 0.0)[0])

    def letters(picture):
        asked = red(picture)
        asked[:, at_line - 4 : at_line + 4] = False
        return asked[top:bottom, left:right].sum()

    assert letters(draw(full)) == letters(draw(line)) > 40


@pytest.mark.parametrize("side", [-1, 1])
def test_an_exit_is_drawn_on_its_side(sorting, side):
    scene = sorting.scene(0, goal=ExitSide(side))
    picture = draw(scene)
    top, bottom, _, _ = plate(picture)
    _, middle = middle_of(red(picture[top:bottom]))
    line = pixel_of(picture, scene, 0.0, 1.0)[1] - top
    assert side * (line - middle) > 10


def test_a_path_is_drawn_where_it_runs(bare):
    points = np.array([[0.5, 0.4], [3.5, 1.6]])
    picture = draw(replace(bare, parcels=(), goal=Path(points)))
    top, bottom, _, _ = plate(picture)
    rows, columns = np.nonzero(red(picture[top:bottom]))
    (x0, y0), (x1, y1) = (pixel_of(picture, bare, *point) for point in points)
    expected = y0 + (y1 - y0) * (columns + 0.5 - x0) / (x1 - x0)
    assert len(rows) > 100
    assert np.abs(rows + top + 0.5 - expected).max() < 6.0  # the dot at its end is the widest


def test_a_trail_follows_the_parcel(sorting):
    step = 100
    with_trail = draw(sorting.scene(step, goal=None))
    without = draw(sorting.scene(step, goal=None, trail=np.zeros((0, 2))))
    rows, columns = np.nonzero((with_trail != without).any(axis=2))
    scene = sorting.scene(step)
    column, row = pixel_of(draw(replace(scene, goal=None)), scene, 0.0, 0.0)
    cell = pixel_of(without, scene, 0.1, 0.0)[0] - column
    x, y = (columns + 0.5 - column) / cell * 0.1, (row - rows - 0.5) / cell * 0.1
    passed = sorting.trajectory.pose[: step + 1, :2]
    away = np.hypot(x[:, None] - passed[:, 0], y[:, None] - passed[:, 1]).min(axis=1)
    assert away.max() < 0.02
    assert x.min() < passed[0, 0] + 0.02
    assert x.max() > passed[-1, 0] - 0.02


def test_the_pose_that_the_sensors_see_is_dashed(bare):
    picture, without = draw(with_parcel(bare, sensed_pose=(3.0, 1.5, 0.0))), draw(bare)
    top, bottom, _, _ = plate(without)
    seen = (picture == SENSED).all(axis=2)[top:bottom]
    column, row = pixel_of(without, bare, 3.0, 1.5)
    np.testing.assert_allclose(middle_of(seen), (column, row - top), atol=2.0)


def test_the_scale_bar_is_half_a_metre(bare):
    picture = draw(bare)
    _, bottom, left, right = plate(picture)
    bar = (picture[bottom:] == INK).all(axis=2).sum(axis=1).max()
    assert bar == pytest.approx(0.5 / 4.0 * (right - left), abs=1.0)


def test_the_tilt_and_the_readings_are_written(sorting):
    scene = sorting.scene(50)
    flat = draw(scene)
    top, bottom, _, _ = plate(draw(replace(scene, goal=None)))
    tilted = draw(replace(scene, tilt=math.radians(5.0)))
    np.testing.assert_array_equal(tilted[:bottom], flat[:bottom])
    assert (tilted[bottom:] != flat[bottom:]).any()
    uphill = draw(replace(scene, tilt=math.radians(-5.0)))
    assert (tilted[bottom:] != uphill[bottom:]).any()
    later = draw(replace(scene, readings=(("time", "0.26 s"),)))
    assert (later[:top] != flat[:top]).any()
    np.testing.assert_array_equal(later[top:], flat[top:])


@pytest.mark.parametrize(
    ("width", "message"),
    [
        (639, "width must be a whole number of at least 640"),
        (960.0, "width must be a whole number"),
        (961, "width must be even"),
    ],
)
def test_a_width_that_does_not_do_is_refused(bare, width, message):
    with pytest.raises(ValueError, match=message):
        draw(bare, width)


def test_a_surface_too_long_for_the_width_is_refused_with_the_width_it_needs(bare):
    long = replace(bare, axis=np.zeros((2, 200)), rotor=np.ones((2, 200), bool))
    with pytest.raises(ValueError, match="width must be at least 1248 for 200 columns"):
        draw(long, 960)
    assert draw(long, 1280).shape[1] == 1280


def test_drawing_needs_no_display_and_outlives_pygame_quit(sorting):
    painter = Painter()
    first = painter.draw(sorting.scene(40))
    assert not pygame.display.get_init()
    pygame.quit()
    np.testing.assert_array_equal(painter.draw(sorting.scene(40)), first)


def test_the_simulator_does_not_import_pygame():
    code = "import sys, surface_gym; assert 'pygame' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_drawing_prints_nothing():
    code = "import surface_gym.rendering"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    assert done.stdout == done.stderr == b""
