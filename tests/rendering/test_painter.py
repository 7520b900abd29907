"""Pictures of one parcel or a stream, side by side and in a window; scenes, and colours."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pygame
import pytest

from surface_gym.rendering import (
    Painter,
    Scene,
    SceneParcel,
    Traffic,
    Window,
    draw,
    ink,
    side_by_side,
)
from surface_gym.rendering.ink import (
    GOAL,
    INK,
    PAPER,
    axis_colour,
    axis_colours,
    exit_colour,
    text_on,
)
from surface_gym.rendering.scene import ExitMark, ExitSide, ExitSpeed, Heading, Path, StopLine
from tests.rendering.conftest import EXITS, LONG, SMALL, Plate, differing, middle

GOALS = (
    None, ExitSide(1), ExitSide(0), StopLine(1.5), ExitSpeed(0.5, 0.75),
    Path([[0.5, 1.0], [1.5, 1.2], [3.0, 0.8]]), Path([[0.5, 1.0], [0.5, 1.0]]), Heading(1.2),
)  # fmt: skip


@pytest.fixture(params=["alone", "a stream"])
def ground(request, bare, empty):
    """A surface without parcels, by itself or as a line with exits."""
    return replace(bare, parcels=()) if request.param == "alone" else empty


def with_parcel(scene, outline=SMALL, pose=(2.0, 1.0, 0.0), **fields):
    place = None if scene.traffic is None else 0
    return replace(scene, parcels=(SceneParcel(outline, pose, place, **fields),))


def changed(scene, **parcel):
    """(left, right, top, bottom) [px] of what a parcel changes in a picture."""
    return differing(draw(with_parcel(scene, **parcel)), draw(scene))


def red(picture):
    return (picture == GOAL).all(axis=2)


class TestPicture:
    @pytest.mark.parametrize("width", [640, 960, 1280])
    def test_it_has_the_width_asked_and_an_even_height(self, sorting, busy, width):
        for picture in (draw(sorting.scene(50), width), draw(busy, width)):
            assert picture.dtype == np.uint8
            assert picture.shape[1:] == (width, 3)
            assert picture.shape[0] % 2 == 0
            assert picture.flags.writeable

    @pytest.mark.parametrize(
        ("columns", "traffic", "width", "message"),
        [
            (40, None, 639, "width must be a whole number of at least 640"),
            (40, None, 960.0, "width must be a whole number"),
            (40, None, 961, "width must be even"),
            (200, None, 960, "width must be at least 1248 for 200 columns"),
            (150, Traffic((), ()), 640, "width must be at least 992 for 150 columns"),
        ],
    )
    def test_a_width_that_does_not_do_is_refused(self, columns, traffic, width, message):
        scene = Scene(np.zeros((4, columns)), np.ones((4, columns), bool), traffic=traffic)
        with pytest.raises(ValueError, match=message):
            draw(scene, width)
        assert draw(scene, 1280).shape[1] == 1280

    def test_all_scenes_of_a_surface_have_one_size(self, sorting, bare, busy, empty):
        others = {"tilt": 0.1, "title": "A" * 200}
        scenes = (sorting.scene(80, goal=g, sensed_pose=(0.5, 1.0, 0.1), **others) for g in GOALS)
        sizes = {draw(scene).shape for scene in scenes}
        assert sizes == {draw(bare).shape}
        full = replace(busy, zone=(8, 4, 10, 20), **others)
        without = replace(empty, traffic=Traffic((), ()))
        assert draw(full).shape == draw(empty).shape == draw(without).shape

    def test_a_kept_painter_draws_as_a_fresh_one(self, sorting, bare, busy, empty):
        small = replace(bare, axis=np.ones((5, 12)), rotor=np.ones((5, 12), bool))
        exits = (*EXITS[:2], ExitMark("C", -1, 2.0, 2.5))
        scenes = [
            bare, sorting.scene(60), sorting.scene(60, zone=(9, 2, 5, 10)),
            sorting.scene(60, zone=None, goal=None), small, replace(small, pitch=0.2), busy, empty,
            replace(busy, zone=(8, 4, 0, 30)), replace(busy, rotor=np.ones((20, 66), bool)),
            replace(busy, traffic=Traffic(exits, (0, 0, 0))), bare,
        ]  # fmt: skip
        painter = Painter()
        for scene in scenes:
            np.testing.assert_array_equal(painter.draw(scene), draw(scene))

    @pytest.mark.parametrize("degrees", [0, 45, -45, 90, 17, 135, 225])
    def test_a_module_has_its_axis_s_colour_and_a_bar_along_it(self, degrees):
        angle = math.radians(degrees)
        scene = Scene(np.full((4, 4), angle), np.ones((4, 4), bool))
        picture, plate = draw(scene, 640).astype(int), Plate(scene, 640)
        x, y = plate.pixel(0.25, 0.25)

        def at(direction):
            column = x + 0.25 * plate.cell * math.cos(direction)
            return picture[int(y - 0.25 * plate.cell * math.sin(direction)), int(column)]

        np.testing.assert_array_equal(at(angle + math.pi / 2), axis_colour(angle))
        assert at(angle).min() > 250
        assert at(angle + math.pi).min() > 250

    def test_modules_that_do_not_obey_are_paler(self, sorting):
        scene = sorting.scene(0, goal=None)
        plate, whole, zoned = Plate(scene), draw(replace(scene, zone=None)), draw(scene)

        def contrast(picture, first, last):
            left, low = map(int, plate.pixel(first, 0.91))
            right, high = map(int, plate.pixel(last, 1.09))
            return np.ptp(picture[high:low, left:right].astype(int), axis=(0, 1)).sum()

        assert contrast(zoned, 2.0, 3.9) < 0.6 * contrast(whole, 2.0, 3.9)
        assert contrast(zoned, 0.5, 1.8) == contrast(whole, 0.5, 1.8)

    def test_the_scale_the_tilt_and_the_readings_are_written(self, bare, sorting):
        plate = Plate(bare)
        bar = (draw(bare)[plate.bottom :] == INK).all(axis=2).sum(axis=1).max()
        assert bar == pytest.approx(5.0 * plate.cell, abs=1.0)
        scene = sorting.scene(50)
        flat, plate = draw(scene), Plate(scene)
        tilted, uphill = (draw(replace(scene, tilt=tilt)) for tilt in (0.09, -0.09))
        np.testing.assert_array_equal(tilted[: plate.bottom], flat[: plate.bottom])
        for other in (flat, uphill):
            assert (tilted[plate.bottom :] != other[plate.bottom :]).any()
        later = draw(replace(scene, readings=(("time", "0.26 s"),)))
        assert (later[: plate.top] != flat[: plate.top]).any()
        np.testing.assert_array_equal(later[plate.top :], flat[plate.top :])

    def test_the_arrow_points_downhill(self, bare):
        plate, flat = Plate(bare), draw(bare)

        def arrow(tilt, direction):
            """The picture; width, height [px] of the arrow, and its centroid off the middle."""
            picture = draw(replace(bare, tilt=tilt, tilt_direction=direction))
            drawn = (picture[plate.bottom :] != flat[plate.bottom :]).any(axis=2)
            columns = np.flatnonzero(drawn.any(axis=0))
            words = columns[np.argmax(np.diff(columns) > 4) + 1]  # after the arrow comes its text
            rows, columns = np.nonzero(drawn[:, :words])
            # To the right and upwards: the head has most of the pixels.
            right, up = (
                places.mean() - 0.5 * (places.min() + places.max()) for places in (columns, -rows)
            )
            return picture, np.ptp(columns), np.ptp(rows), (right, up)

        towards_x, width, height, head = arrow(0.09, 0.0)
        assert width > 2 * height
        assert head[0] > 0.5
        back, _, _, head = arrow(0.09, math.pi)
        assert head[0] < -0.5
        np.testing.assert_array_equal(back, arrow(-0.09, 0.0)[0])
        for direction, way in ((math.pi / 2, 1.0), (-math.pi / 2, -1.0)):
            _, width, height, head = arrow(0.09, direction)
            assert height > 2 * width
            assert way * head[1] > 0.5
        assert (towards_x != back).any()

    def test_texts_may_be_larger_beside_the_same_surface(self, sorting):
        usual, large = (Painter(960, text).draw(sorting.scene(40)) for text in (1.0, 1.5))
        assert large.shape[1] == usual.shape[1]
        assert (large == INK).all(axis=2)[:60].sum() > 1.5 * (usual == INK).all(axis=2)[:60].sum()
        with pytest.raises(ValueError, match="text must be greater than 0, got 0"):
            Painter(text=0)

    def test_drawing_needs_no_display_and_outlives_pygame_quit(self, sorting):
        painter = Painter()
        first = painter.draw(sorting.scene(40))
        assert not pygame.display.get_init()
        pygame.quit()
        np.testing.assert_array_equal(painter.draw(sorting.scene(40)), first)

    def test_the_import_prints_nothing(self):
        code = "import surface_gym.rendering"
        done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        assert done.stdout == done.stderr == b""


class TestParcel:
    @pytest.mark.parametrize("place", [(0.5, 1.0), (2.0, 1.4), (3.313, 0.677)])
    def test_it_is_drawn_where_it_is_with_y_upwards(self, ground, place):
        seen = changed(ground, pose=(*place, 0.0))
        np.testing.assert_allclose(middle(seen), Plate(ground).pixel(*place), atol=1.0)

    def test_turned_it_is_drawn_to_scale(self, ground):
        left, right, top, bottom = changed(ground, outline=LONG, pose=(2.0, 1.0, math.pi / 2))
        cell = Plate(ground).cell
        assert bottom - top == pytest.approx(4.5 * cell, abs=3.0)
        assert right - left == pytest.approx(2.5 * cell, abs=3.0)

    def test_one_that_leaves_is_not_drawn_over_the_strips(self, ground):
        plate = Plate(ground)
        _, _, top, _ = changed(ground, outline=LONG, pose=(2.5, plate.high, 0.3))
        assert top == plate.top
        if plate.stream:  # beyond its end lies an exit
            _, right, _, _ = changed(ground, outline=LONG, pose=(plate.length, 1.0, 0.0))
            assert right == plate.right

    def test_a_trail_follows_it(self, sorting):
        step = 100
        scene = sorting.scene(step, goal=None)
        bare = sorting.scene(step, goal=None, trail=np.zeros((0, 2)))
        plate, with_trail, without = Plate(scene), draw(scene), draw(bare)
        rows, columns = np.nonzero((with_trail != without).any(axis=2))
        column, row = plate.pixel(0.0, 0.0)
        x, y = 0.1 * (columns + 0.5 - column) / plate.cell, 0.1 * (row - rows - 0.5) / plate.cell
        passed = sorting.trajectory.pose[: step + 1, :2]
        away = np.hypot(x[:, None] - passed[:, 0], y[:, None] - passed[:, 1]).min(axis=1)
        assert away.max() < 0.02
        assert x.min() < passed[0, 0] + 0.02
        assert x.max() > passed[-1, 0] - 0.02

    def test_the_pose_that_the_sensors_see_is_dashed_and_in_the_legend(self, ground):
        without = draw(with_parcel(ground))
        picture = draw(with_parcel(ground, sensed_pose=(3.0, 1.2, 0.0)))
        plate = Plate(ground)
        foot = plate.bottom + (40 if plate.stream else 0)  # chutes have labels below
        seen = differing(picture[:foot], without[:foot])
        np.testing.assert_allclose(middle(seen), plate.pixel(3.0, 1.2), atol=1.0)
        assert (picture[foot:] != without[foot:]).any()


class TestGoal:
    def test_a_stop_line_is_drawn_at_its_x(self, sorting):
        scene = sorting.scene(0, goal=StopLine(1.7), zone=None)
        plate = Plate(scene)
        columns = np.nonzero(red(draw(scene)[plate.top : plate.bottom]))[1]
        assert columns.mean() + 0.5 == pytest.approx(plate.pixel(1.7, 1.0)[0], abs=2.0)

    @pytest.mark.parametrize("x", [0.0, 2.0, 4.0])
    def test_a_label_is_whole_even_where_the_line_fills_the_surface(self, sorting, bare, x):
        line = replace(bare, rotor=sorting.surface.rotor, parcels=(), goal=StopLine(x))
        plate = Plate(bare)
        at_line = round(plate.pixel(x, 0.0)[0])

        def letters(scene):
            asked = red(draw(scene))
            asked[:, at_line - 4 : at_line + 4] = False
            return asked[plate.top : plate.bottom, plate.left : plate.right].sum()

        assert letters(replace(line, rotor=np.ones((20, 40), bool))) == letters(line) > 40

    @pytest.mark.parametrize("side", [-1, 1])
    def test_an_exit_is_drawn_on_its_side(self, sorting, side):
        scene = sorting.scene(0, goal=ExitSide(side))
        plate = Plate(scene)
        rows = np.nonzero(red(draw(scene)[plate.top : plate.bottom]))[0] + plate.top
        assert side * (plate.pixel(0.0, 1.0)[1] - rows.mean()) > 10

    def test_a_path_is_drawn_where_it_runs(self, bare):
        points = np.array([[0.5, 0.4], [3.5, 1.6]])
        scene = replace(bare, parcels=(), goal=Path(points))
        plate = Plate(scene)
        rows, columns = np.nonzero(red(draw(scene)[plate.top : plate.bottom]))
        (x0, y0), (x1, y1) = (plate.pixel(*point) for point in points)
        expected = y0 + (y1 - y0) * (columns + 0.5 - x0) / (x1 - x0)
        assert len(rows) > 100
        # The dot at its end is the widest.
        assert np.abs(rows + plate.top + 0.5 - expected).max() < 6.0


class TestTiles:
    @pytest.mark.parametrize("count", [1, 2, 5, 16, 64])
    def test_any_number_fits_a_picture_of_a_useful_shape(self, sorting, busy, count):
        for picture in (draw(sorting.scene(3)), draw(busy)):
            height, width, colours = side_by_side([picture] * count).shape
            assert (width, colours) == (1280, 3)
            assert height % 2 == 0
            assert 0.3 < width / height < 4.0

    def test_a_picture_changes_its_own_tile_alone(self, sorting):
        picture, other = draw(sorting.scene(20)), draw(sorting.scene(80))
        before, boxes = side_by_side([picture] * 4), []
        for k in range(4):
            pictures = [picture] * 4
            pictures[k] = other
            boxes.append(differing(side_by_side(pictures), before))
        first, second, third, fourth = boxes
        for upper, lower in ((first, third), (second, fourth)):
            assert upper[3] <= lower[2]  # a row of two above a row of two
        for left, right in ((first, second), (third, fourth)):
            assert left[1] <= right[0]


class TestWindow:
    @pytest.fixture(autouse=True)
    def _dummy_display(self, monkeypatch):
        monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
        yield
        pygame.display.quit()

    @pytest.fixture
    def picture(self):
        return np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)

    @pytest.fixture
    def window(self, picture):
        window = Window("Sort", frame_rate=1000.0)
        window.show(picture)
        return window

    def test_it_shows_the_picture_in_its_size(self, window, picture):
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        np.testing.assert_array_equal(shown, picture)
        assert pygame.display.get_caption()[0] == "Sort"
        window.show(picture[:20])
        assert pygame.display.get_surface().get_size() == (64, 20)

    def test_closed_by_the_user_it_stays_closed(self, window, picture):
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        for _ in range(2):
            window.show(picture)
            assert window.closed
            assert not pygame.display.get_init()

    def test_closing_twice_does_no_harm_nor_closing_one_never_opened(self, window, picture):
        Window().close()
        window.show(picture)
        assert pygame.display.get_surface() is not None
        window.close()
        window.close()
        assert window.closed

    def test_it_waits_for_the_next_picture_s_time(self, picture, monkeypatch):
        asked = []
        window = Window(frame_rate=25.0)
        clock = type("Clock", (), {"tick": lambda _, rate: asked.append(rate)})()
        monkeypatch.setattr(window, "_clock", clock)
        window.show(picture)
        assert asked == [25.0]

    def test_without_a_driver_or_a_picture_the_error_says_so(self, picture, monkeypatch):
        for wrong in (picture[:, :, 0], picture / 255.0):
            with pytest.raises(ValueError, match="picture must be an array of uint8"):
                Window().show(wrong)
        with pytest.raises(ValueError, match="frame_rate must be greater than 0"):
            Window(frame_rate=0.0)
        monkeypatch.setenv("SDL_VIDEODRIVER", "no such driver")
        with pytest.raises(RuntimeError, match="a window needs a display"):
            Window().show(picture)

    @pytest.mark.usefixtures("screen")
    def test_without_a_display_it_draws_off_screen(self, picture, monkeypatch):
        pygame.display.init()
        monkeypatch.delenv("SDL_VIDEODRIVER")  # SDL's choice, unasked
        window = Window()
        with pytest.warns(UserWarning, match="there is no display: the window is drawn off screen"):
            window.show(picture)
        window.close()


@pytest.mark.parametrize(
    ("kind", "wrong", "message"),
    [
        (ExitSide, {"side": 2}, "side must be one of -1, 0, 1"),
        (StopLine, {"x": np.nan}, "x must be a finite number"),
        (ExitSpeed, {"ratio": -0.1, "speed": 1.0}, "ratio must be at least 0"),
        (ExitSpeed, {"ratio": 0.5, "speed": -1.0}, "speed must be at least 0"),
        (Path, {"points": [[0.0, 1.0]]}, "points must be at least 2"),
        (Heading, {"angle": "left"}, "angle must be a finite number"),
    ],
)
def test_a_goal_that_cannot_be_is_refused(kind, wrong, message):
    with pytest.raises(ValueError, match=message):
        kind(**wrong)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"goal": "sort"}, "goal must be one of the goals or None, got 'sort'"),
        ({"readings": (("time", 1.0),)}, "readings must be pairs of label and text"),
        ({"readings": (("time", "1", "s"),)}, "readings must be pairs of label and text"),
    ],
)
def test_what_a_task_gives_a_scene_is_checked(bare, wrong, message):
    with pytest.raises(ValueError, match=message):
        replace(bare, **wrong)


def test_a_scene_keeps_copies_and_its_zone_obeys(busy, bare):
    axis = np.zeros((20, 66))
    kept = replace(busy, axis=axis)
    axis[:] = 1.0
    assert not kept.axis.any()
    zoned = replace(bare, zone=(9, 2, 3, 16))
    assert zoned.obeys.sum() == 2 * 16
    assert zoned.obeys[9:11, 3:19].all()
    assert bare.obeys.all()


FOUR = np.radians([0.0, 45.0, -45.0, 90.0])

# What a dichromat sees of linear RGB: Vienot, Brettel and Mollon (1999), Color Res. Appl. 24:243.
RGB_TO_LMS = np.array(
    [[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]]
)
SEEN = {
    "all colours": np.eye(3),
    "no red": np.array([[0.0, 2.02344, -2.52581], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "no green": np.array([[1.0, 0.0, 0.0], [0.494207, 0.0, 1.24827], [0.0, 0.0, 1.0]]),
}
RGB_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)


def cielab(srgb, cones):
    """CIELAB of colours as an eye with these cones sees them."""
    part = np.asarray(srgb) / 255.0
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    seen = linear @ (np.linalg.inv(RGB_TO_LMS) @ cones @ RGB_TO_LMS).T
    xyz = np.clip(seen, 0.0, 1.0) @ RGB_TO_XYZ.T / RGB_TO_XYZ.sum(axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def test_half_a_turn_is_the_same_colour_they_change_gradually_and_exits_take_them_again():
    angles = np.linspace(-np.pi, np.pi, 50)
    np.testing.assert_array_equal(axis_colours(angles), axis_colours(angles + np.pi))
    colours = axis_colours(np.radians(np.arange(0, 181))).astype(int)
    assert np.abs(np.diff(colours, axis=0)).max() <= 5
    assert [exit_colour(k) for k in range(len(ink.EXITS), 2 * len(ink.EXITS))] == list(ink.EXITS)


@pytest.mark.parametrize("eye", SEEN)
def test_the_four_orientations_and_the_exits_differ_clearly_to_every_eye(eye):
    lab = cielab(np.vstack([axis_colours(FOUR), ink.EXITS]), SEEN[eye])
    apart = np.linalg.norm(lab[:, np.newaxis] - lab, axis=-1) + 1e3 * np.eye(len(lab))
    assert apart[:4, :4].min() > 25.0  # 2.3 is a just noticeable difference
    assert apart.min() > (40.0 if eye == "all colours" else 20.0)


@pytest.mark.parametrize("place", range(len(ink.EXITS)))
def test_a_text_on_an_exit_s_colour_has_contrast(place):
    """At least 4.5 to 1, by https://www.w3.org/TR/WCAG21/#dfn-contrast-ratio."""

    def luminance(colour):
        part = np.array(colour) / 255.0
        linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    ground = exit_colour(place)
    low, high = sorted([luminance(ground), luminance(text_on(ground))])
    assert text_on(ground) in (INK, PAPER)
    assert (high + 0.05) / (low + 0.05) >= 4.5


@pytest.mark.parametrize("eye", SEEN)
def test_plots_tell_the_first_controllers_apart(eye):
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra `agents`, is missing")
    from matplotlib.colors import to_rgb

    from surface_gym.agents.evaluation.pictures import choose_colours

    chosen = list(choose_colours(map(str, range(11))).values())
    assert chosen[:10] == list(dict.fromkeys(chosen))
    lab = cielab(255.0 * np.array([to_rgb(colour) for colour in chosen[:3]]), SEEN[eye])
    apart = np.linalg.norm(lab[:, np.newaxis] - lab, axis=-1)
    assert apart[np.triu_indices(3, 1)].min() > 35.0
