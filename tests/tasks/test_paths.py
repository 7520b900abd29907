"""Paths: their values, their smoothness, and what is refused."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from surface_gym.tasks import paths
from surface_gym.tasks.paths import BasePath, LaneChange, Polyline, Sine, Spline

POINTS = ((0.5, 1.0), (1.5, 1.2), (2.0, 0.9), (4.0, 1.1))


def slopes(path: BasePath, x: np.ndarray) -> np.ndarray:
    return (path.y(x + 1e-6) - path.y(x - 1e-6)) / 2e-6


def drawn(kind: str, count: int = 300) -> list[BasePath]:
    rng = np.random.default_rng(0)
    return [paths.random_path(kind, rng.random(paths.DRAWS)) for _ in range(count)]


class TestValues:
    @pytest.mark.parametrize(
        ("path", "x", "expected"),
        [
            (Sine(0.2, 2.0, 0.5, 4.5, 1.1), [0.5, 1.0, 1.5, 2.0, 2.5], [1.1, 1.3, 1.1, 0.9, 1.1]),
            (LaneChange(0.4, 1.5, 2.0), [0.4, 2.0, 2.75, 3.5, 5.6], [0.8, 0.8, 1.0, 1.2, 1.2]),
            (Polyline(POINTS), [0.5, 1.0, 1.5, 1.75, 3.0], [1.0, 1.1, 1.2, 1.05, 1.0]),
            (Spline(((0.0, 1.0), (0.7, 1.35), (2.0, 2.0))), [0.0, 0.4, 1.5], [1.0, 1.2, 1.75]),
        ],
    )
    def test_along_x(self, path, x, expected):
        np.testing.assert_allclose(path.y(np.array(x)), expected, rtol=0, atol=1e-12)
        if isinstance(path, Polyline):
            assert (path.start, path.end) == (0.5, 4.0)

    def test_of_a_spline(self):
        """Through its points, with no curvature at its ends: scipy's natural spline."""
        path = Spline(POINTS)
        along, across = np.array(POINTS).T
        np.testing.assert_allclose(path.y(along), across, rtol=0, atol=1e-12)
        reference = CubicSpline(along, across, bc_type=((2, 0.0), (2, 0.0)))
        x = np.linspace(0.5, 4.0, 101)
        np.testing.assert_allclose(path.y(x), reference(x), rtol=0, atol=1e-12)


class TestSmoothness:
    @pytest.mark.parametrize("path", [LaneChange(), LaneChange(-0.6, 1.0), Sine(), Spline(POINTS)])
    def test_the_slope_has_no_jumps(self, path):
        x = np.linspace(path.start + 0.01, path.end - 0.01, 4001)
        assert np.abs(np.diff(slopes(path, x))).max() < 0.01

    def test_a_lane_change_has_neither_slope_nor_curvature_at_its_ends_and_a_polyline_jumps(self):
        path = LaneChange(offset=0.4, length=1.5, change=2.0)
        ends = np.array([2.0, 3.5])
        np.testing.assert_allclose(slopes(path, ends), 0.0, rtol=0, atol=1e-6)
        h = 1e-3  # the third derivative, 60 offset / length^3, makes second differences of order h
        curvature = (path.y(ends + h) - 2.0 * path.y(ends) + path.y(ends - h)) / h**2
        assert np.abs(curvature).max() < 60.0 * 0.4 / 1.5**3 * h
        assert path.y(np.array([2.4]))[0] > 0.8
        path = Polyline(POINTS)
        before, after = slopes(path, np.array([1.499, 1.501]))
        assert after - before == pytest.approx(-0.6 - 0.2, abs=1e-6)


class TestRandom:
    @pytest.mark.parametrize("kind", paths.KINDS)
    def test_lie_in_the_field_and_start_and_end_alike(self, kind):
        for path in drawn(kind):
            assert (path.start, path.end) == (0.4, 5.6)
            y = path.y(np.linspace(path.start, path.end, 200))
            assert np.abs(y - 1.0).max() < 0.45
            assert np.ptp(y) > 0.01

    def test_a_polyline_may_go_straight_on(self):
        straight = paths.random_path("polyline", np.full(paths.DRAWS, 0.5))
        np.testing.assert_allclose(straight.y(np.linspace(0.4, 5.6, 50)), 1.0)

    def test_sines_and_lane_changes(self):
        paths = drawn("sine")
        amplitude = np.array([path.amplitude for path in paths])
        wavelength = np.array([path.wavelength for path in paths])
        assert 0.1 <= np.abs(amplitude).min() < 0.11 < 0.19 < np.abs(amplitude).max() <= 0.2
        assert 1.8 <= wavelength.min() < 1.85 < 3.15 < wavelength.max() <= 3.2
        assert 0.4 < np.mean(amplitude > 0.0) < 0.6
        paths = drawn("lane change")
        offset = np.array([path.offset for path in paths])
        assert 0.2 <= np.abs(offset).min() < 0.22 < 0.58 < np.abs(offset).max() <= 0.6
        assert 0.4 < np.mean(offset > 0.0) < 0.6
        assert all(1.0 <= path.length <= 2.0 and 1.0 <= path.change <= 2.5 for path in paths)

    def test_polylines_run_level_or_at_45_deg(self):
        for path in drawn("polyline"):
            rise = np.diff(np.array(path.points), axis=0)
            slope = rise[:, 1] / rise[:, 0]
            np.testing.assert_allclose(slope * (np.abs(slope) - 1.0), 0.0, rtol=0, atol=1e-9)
            assert (np.abs(slope[1::2]) > 0.99).all()
            assert (rise[:-1:2, 0] >= 0.4 - 1e-12).all()
            assert np.abs(np.array(path.points)[:, 1] - 1.0).max() <= 0.3 + 1e-12

    def test_splines(self):
        for path in drawn("spline", 50):
            points = np.array(path.points)
            np.testing.assert_allclose(points[:, 0], np.linspace(0.4, 5.6, 6))
            assert points[0, 1] == 1.0
            assert np.abs(points[:, 1] - 1.0).max() <= 0.2


class TestRefused:
    @pytest.mark.parametrize(
        ("kind", "wrong"),
        [
            (Sine, {"wavelength": 0.0, "amplitude": math.nan, "middle": "middle", "end": math.inf}),
            (LaneChange, {"length": -1.0, "offset": None, "change": math.inf}),
        ],
    )
    def test_values(self, kind, wrong):
        for start, end in ((2.0, 1.0), (1.0, 1.0)):
            with pytest.raises(ValueError, match="start"):
                kind(start=start, end=end)
        for name, value in wrong.items():
            with pytest.raises(ValueError, match=name):
                kind(**{name: value})

    @pytest.mark.parametrize("kind", [Polyline, Spline])
    def test_points(self, kind):
        repeated = [(1.0, 1.0), (1.0, 2.0)]
        for points in (
            [], [(1.0, 1.0)], repeated, [(1.0, 1.0, 1.0)] * 2, [(1.0, math.nan)] * 2, 3,
        ):  # fmt: skip
            with pytest.raises(ValueError, match="points"):
                kind(points)

    def test_options_name_what_may_come(self):
        for value in ("sine", None, 3.0, [(1.0, 1.0)], Sine):
            named = "path must be a Sine, LaneChange, Polyline, Spline"
            with pytest.raises(ValueError, match=named):
                paths.path_option(value)
        assert paths.path_option(Sine()) == Sine()
        assert paths.path_option(np.array(POINTS)) == Polyline(POINTS)
