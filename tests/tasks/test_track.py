"""Track: starts, ends, reward and what is seen."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.tasks import Track
from surface_gym.tasks.paths import LaneChange, Polyline, Sine
from surface_gym.tasks.start import Start
from tests import tasks
from tests.environments import MINUS_45, ROLL, TRIANGLE, bare, terms

TRACK = "SmartSurface/Track-v0"
BOX = sg.layouts.box("S")
AHEAD = ((0.5, 1.0), (2.5, 1.0))  # straight along x
SLOPE = 0.05
RISING = ((0.5, 1.0), (4.5, 1.0 + 4.0 * SLOPE))
LEVEL = {"path": AHEAD, "speed": 1.0, "tilt": 0.0, "parcel": "S"}


class TestStarts:
    def test_obey_their_laws(self):
        starts = tasks.draws(Track())
        tasks.assert_laws(starts, 0.6, 1.0)
        tasks.assert_uniform([start.tilt for start in starts], 0.0, math.radians(15.0))
        for start in starts:
            assert math.hypot(*start.velocity[:2]) == pytest.approx(start.goal[0])
            assert start.pose == (0.4, start.path[0], 0.0)
            assert start.goal[1] + 255 * start.goal[2] == pytest.approx(5.6)
            assert np.abs(start.path - 1.0).max() < 0.5

    @pytest.mark.parametrize("kind", Track().kinds)
    def test_kinds_may_be_chosen(self, kind):
        """Each by itself: the paths of two kinds are never the same."""
        other = next(name for name in Track().kinds if name != kind)
        drawn = [tasks.draws(Track(kinds=kinds), 10) for kinds in ((kind,), (kind, kind), (other,))]
        for first, second, third in zip(*drawn, strict=True):
            np.testing.assert_array_equal(first.path, second.path)
            assert (first.path != third.path).any()

    def test_the_centre_starts_along_the_path(self):
        _, info = bare(TRACK).reset(options=LEVEL | {"path": RISING, "parcel": TRIANGLE})
        np.testing.assert_allclose(info["pose"], [0.5, 1.0, 0.0], rtol=0, atol=1e-12)
        along = np.array([1.0, SLOPE]) / math.hypot(1.0, SLOPE)
        np.testing.assert_allclose(info["velocity"][:2], along, rtol=0, atol=1e-12)


class TestEnds:
    def test_rolling_along_a_straight_path_succeeds(self):
        episode = tasks.play(bare(TRACK), LEVEL, ROLL)
        assert episode.end["outcome"] == "success"
        assert 2.5 < episode.end["pose"][0] < 2.5 + 0.04
        assert episode.end["rms_error"] < 1e-9
        left = math.sqrt(1.0 - 2.0 * tasks.ROLL_LOSS * (episode.end["pose"][0] - 0.5))
        assert episode.end["velocity"][0] == pytest.approx(left, abs=1e-3)
        assert (episode.total("success"), episode.total("failure")) == (2.0, 0.0)
        way = episode.end["pose"][0] - 0.5
        assert episode.total("distance") == pytest.approx(0.3 * way)
        assert episode.total("precision") == pytest.approx(way)

    @pytest.mark.parametrize("tilt", [0.0, 0.1, 0.25])
    def test_it_runs_downhill(self, tilt):
        """Rolling, it gains what gravity does and loses what friction takes, a second."""
        episode = tasks.play(bare(TRACK), LEVEL | {"tilt": tilt}, ROLL, longest=10)
        gain = 9.81 * (math.sin(tilt) - 0.01 * math.cos(tilt))
        assert episode.end["velocity"][0] == pytest.approx(1.0 + 0.4 * gain, abs=1e-9)

    def test_straight_on_where_the_path_bends_is_off_the_path(self):
        path = [(0.5, 1.0), (1.0, 1.0), (2.0, 1.5), (3.0, 1.5)]
        episode = tasks.play(bare(TRACK), LEVEL | {"path": path}, ROLL)
        assert episode.end["outcome"] == "off the path"
        assert episode.end["cross_error"] <= -0.15  # to the right of a path that goes left
        assert episode.infos[-2]["cross_error"] > -0.15
        assert (episode.total("success"), episode.total("failure")) == (0.0, -2.0)

    def test_ends_of_braking_and_of_a_push_towards_the_edge(self):
        episode = tasks.play(bare(TRACK), LEVEL, tasks.BRAKE)
        assert episode.end["outcome"] == "stalled"
        assert abs(episode.end["velocity"][0]) < 0.05
        # A push towards the edge from beside it.
        goal = (1.0, 0.5, 2.0 / 255)
        start = Start(BOX, (1.0, 0.1, 0.0), (0.0, -5.0, 0.0), goal, 0.0, np.full(256, 0.1))
        assert tasks.advanced(Track(), start, ROLL)[0] == "off the surface"


class TestFigures:
    """They equal what follows from the poses and velocities that are reported."""

    @pytest.mark.parametrize(
        "path", [AHEAD, RISING, Sine(0.1, 3.0), LaneChange(0.2, 2.0)], ids=lambda path: str(path)
    )
    def test_of_a_random_walk_about_a_path(self, path):
        options = LEVEL | {"path": path, "tilt": 0.1}
        episode = tasks.play(bare(TRACK), options, seed=1, longest=25)
        if isinstance(path, tuple):
            path = Polyline(path)

        def curve(x: float) -> float:
            return float(path.y(np.array([x]))[0])

        crosses, speeds = [], []
        for info in episode.infos:
            (x, y, _), (vx, vy, _) = info["pose"], info["velocity"]
            slope = (curve(x + 1e-5) - curve(x - 1e-5)) / 2e-5
            length = math.hypot(1.0, slope)
            crosses.append((y - curve(x)) / length)
            speeds.append((vx + slope * vy) / length - 1.0)
            # A curve is kept as 256 points, a straight line exactly.
            assert info["cross_error"] == pytest.approx(crosses[-1], abs=2e-4)
            cross, speed = (np.sqrt(np.mean(np.square(each))) for each in (crosses, speeds))
            assert info["rms_error"] == pytest.approx(cross, abs=2e-4)
            assert info["speed_error"] == pytest.approx(speed, abs=5e-3)
        assert np.abs(crosses).max() > 0.001


class TestReward:
    def test_every_term_is_paid_a_metre(self):
        episode = tasks.play(bare(TRACK), LEVEL | {"path": RISING, "tilt": 0.1}, MINUS_45)
        x = episode.start["pose"][0]
        length = math.hypot(1.0, SLOPE)
        for info in episode.infos:
            gained = max(0.0, info["pose"][0] - x)
            x, y, _ = info["pose"]
            cross = abs(y - 1.0 - SLOPE * (x - 0.5)) / length
            speed = (info["velocity"][0] + SLOPE * info["velocity"][1]) / length
            found = terms(info)
            assert found["distance"] == pytest.approx(0.3 * gained, abs=1e-12)
            precision = gained * math.exp(-cross / 0.005)
            assert found["precision"] == pytest.approx(precision, abs=1e-12)
            assert found["cross_error"] == pytest.approx(-8.0 * gained * cross, abs=1e-12)
            off = -2.0 * gained * abs(speed - 1.0)
            assert found["speed_error"] == pytest.approx(off, abs=1e-12)


class TestSeen:
    def test_features_of_a_state(self):
        """Over a polyline: x at 0.95 m, 5 cm before it bends from level to a slope of 0.5."""
        step = 2.55 / 255
        x = 0.5 + step * np.arange(256)
        path = 1.0 + 0.5 * np.maximum(0.0, x - 1.0)
        pose, velocity = (0.95, 1.02, 0.3), (0.7, -0.1, 0.6)
        start = Start(BOX, pose, velocity, (0.9, 0.5, step), 0.2, path)
        turn = 2.0 * math.pi / 0.1
        wanted = {
            "cross error": 0.4, "fine cross error": math.tanh(4.0), "speed error": -1.0,
            "lateral speed": -1.0, "asked speed": 0.1, "slope 0 m ahead": 0.0,
            "slope 0.1 m ahead": 0.5, "slope 0.2 m ahead": 0.5, "slope 0.35 m ahead": 0.5,
            "tilt": math.sin(0.2) / 0.2, "sine of theta": math.sin(0.3),
            "cosine of theta": math.cos(0.3), "turning speed": 0.2, "size": -1.0,
            "sine of phase x": math.sin(turn * 0.90), "cosine of phase x": math.cos(turn * 0.90),
            "sine of phase y": math.sin(turn * 0.97), "cosine of phase y": math.cos(turn * 0.97),
        }  # fmt: skip
        assert tasks.features_of(Track(), start) == pytest.approx(wanted, abs=1e-6)

    def test_errors_are_square_to_a_slope(self):
        """On a path at 45 deg: 1 cm above it in y is 1 cm / sqrt(2) off it, to its left."""
        step = 1.0 / 255
        path = 0.8 + step * np.arange(256)
        start = Start(BOX, (1.0, 1.31, 0.0), (0.6, 0.4, 0.0), (0.8, 0.5, step), 0.0, path)
        seen = tasks.features_of(Track(), start)
        assert seen["cross error"] == pytest.approx(0.01 / math.sqrt(2.0) / 0.05, abs=1e-6)
        assert seen["speed error"] == pytest.approx((1.0 / math.sqrt(2.0) - 0.8) / 0.2, abs=1e-6)
        assert seen["lateral speed"] == pytest.approx(-0.2 / math.sqrt(2.0) / 0.1, abs=1e-6)
