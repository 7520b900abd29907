"""The canvas: a pixel's share of a shape is the area that a fine grid of points finds."""

import math

import numpy as np
import pytest

from surface_gym import canvas as cv
from surface_gym.canvas import Canvas, Image, Viewport
from surface_gym.physics.types import make_scratch

HEIGHT, WIDTH, SCALE = 9, 12, 4.0  # [px], [px], [px/m]
NONE = np.zeros((0, 2), dtype=np.int64), np.zeros(0)


def blank(channels: int = 1) -> Canvas:
    """A black canvas whose lower left corner is at (1, 2) m."""
    paints = np.tile([[10.0], [100.0], [255.0], [50.0]], channels)
    viewport = Viewport(
        1.0, 2.0 + HEIGHT / SCALE, SCALE, paints, np.zeros((3, channels)), *NONE, *NONE
    )
    pixels = np.zeros((HEIGHT, WIDTH * channels), dtype=np.uint8)
    return Canvas(pixels, viewport, make_scratch().table)


def fill(canvas: Canvas, corners: np.ndarray, paint: int = cv.PARCEL) -> None:
    for k, (x, y) in enumerate(corners.tolist()):
        cv.put_corner(canvas, k, x, y)
    cv.fill(canvas, len(corners), paint)


def points(fine: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y [m] of the points of a grid, `fine` x `fine` in every pixel."""
    u, v = (np.arange(fine * count) + 0.5 for count in (WIDTH, HEIGHT))
    x, y = 1.0 + u / fine / SCALE, 2.0 + (HEIGHT - v / fine) / SCALE
    return np.broadcast_to(x, (len(y), len(x))), np.broadcast_to(y[:, np.newaxis], (len(y), len(x)))


def share(inside: np.ndarray, fine: int) -> np.ndarray:
    return inside.reshape(HEIGHT, fine, WIDTH, fine).mean(axis=(1, 3))


def test_the_share_of_a_pixel_is_the_area_within_any_triangle():
    rng, fine = np.random.default_rng(0), 40
    x, y = points(fine)
    for _ in range(20):  # some reach beyond the picture, and are turned both ways
        corners = rng.uniform((0.5, 1.5), (4.5, 4.7), (3, 2))
        ends = np.roll(corners, -1, axis=0)
        turns = [
            (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            for a, b in zip(corners, ends, strict=True)
        ]
        inside = np.all([turn > 0 for turn in turns], axis=0)
        inside |= np.all([turn < 0 for turn in turns], axis=0)
        canvas = blank()
        fill(canvas, corners)
        apart = canvas.pixels / 255.0 - share(inside, fine)
        assert np.abs(apart).max() < 0.02
        assert abs(apart.mean()) < 1e-3


def test_a_shape_on_the_edges_of_pixels_leaves_no_trace_beside_it():
    canvas = blank(channels=3)
    left, right, low, high = 1.5, 2.5, 3.0, 3.5  # [m] 4 x 2 pixels
    fill(canvas, np.array([(left, low), (right, low), (right, high), (left, high)]), cv.GOAL)
    pixels = canvas.pixels.reshape(HEIGHT, WIDTH, 3)
    assert (pixels[3:5, 2:6] == 100).all()
    assert pixels.astype(int).sum() == 8 * 3 * 100


@pytest.mark.parametrize("corner", [math.nan, math.inf, -1e300])
def test_a_shape_that_is_nowhere_leaves_the_picture_as_it_was(corner):
    canvas = blank()
    fill(canvas, np.array([(corner, corner), (corner, 3.0), (corner, 2.5)]))
    assert not canvas.pixels.any()


@pytest.mark.parametrize(("width", "drawn"), [(0.5, 2.0), (0.01, 1.5)])
def test_a_line_has_its_width_but_at_least_that_of_its_kind(width, drawn):
    """[px] that are drawn."""
    canvas = blank()
    cv.draw_line(canvas, (1.75, 3.0), (3.0, 4.0), width)
    length = SCALE * math.hypot(1.25, 1.0)
    assert canvas.pixels.sum() / 100.0 == pytest.approx(length * drawn, rel=0.02)


class TestImage:
    def test_what_is_given_is_kept_in_plain_types(self):
        image = Image(np.int64(48), 64, 3, area=np.array([0, 2, 0.5, 1.5]))
        assert image == Image(48, 64, 3, (0.0, 2.0, 0.5, 1.5))
        assert image.shape == (48, 64, 3)
        assert type(image.height) is int
        assert hash(image) == hash(Image(48, 64, 3, (0.0, 2.0, 0.5, 1.5)))

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"height": 7}, "height must be a whole number of at least 8, got 7"),
            ({"width": 1025}, "width must be a whole number of at most 1024, got 1025"),
            ({"width": 64.0}, "width must be a whole number of at least 8, got 64.0"),
            ({"channels": 4}, "channels must be one of 1, 3, got 4"),
            ({"area": (0.0, 1.0)}, r"area must have the shape \(4\), got \(2,\)"),
            ({"area": (1.0, 0.0, 0.0, 1.0)}, "area must be the least and greatest x"),
            ({"area": (0.0, 1e5, 0.0, 1.0)}, "area must be between -10000 and 10000"),
            ({"area": (0.0, math.nan, 0.0, 1.0)}, "area must be"),
        ],
    )
    def test_bad_values_are_named(self, given, message):
        with pytest.raises(ValueError, match=f"^{message}"):
            Image(**given)
