"""Orient: starts, ends, reward and what is seen."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.tasks import Orient
from surface_gym.tasks.start import Start
from tests.environments import PLUS_45, ROLL, bare
from tests.tasks import assert_laws, assert_observed, assert_uniform, draws, play

ORIENT = "SmartSurface/Orient-v0"
BOX = sg.layouts.box("S")
TWO_DEGREES = math.radians(2.0)

# A layout that turns the S-box: the row of y > 0 at 45 deg in five columns, the rest rolls.
TURNING = np.full((4, 16), ROLL)
TURNING[2, 4:9] = PLUS_45


def yielded() -> float:
    """[rad] theta with which that layout lets the S-box go, by the simulator alone."""
    axis = np.full((2, 16), math.pi / 2)
    axis[1, 4:9] = math.pi / 4
    start = sg.layouts.start("S")
    run = sg.simulate(sg.layouts.line(axis, "S", 30), BOX, start, (1.5, 0.0, 0.0), 4.0)
    theta = run.pose[:, 2]
    rear = run.pose[:, 0] - 0.125 * (np.abs(np.cos(theta)) + np.abs(np.sin(theta)))
    return float(theta[np.argmax(rear > 1.9)])


class TestStarts:
    def test_obey_their_laws(self):
        starts = draws(Orient())
        assert_laws(starts, 1.3, 1.7)
        assert_uniform([start.goal[0] for start in starts], -math.pi / 4, math.pi / 4)


class TestEnds:
    @pytest.mark.parametrize(
        ("off", "outcome"),
        [(0.0, "success"), (0.99, "success"), (-0.99, "success"), (1.01, "missed"),
         (-1.01, "missed"), (9.0, "missed")],
    )  # fmt: skip
    def test_of_a_layout_that_turns(self, off, outcome):
        angle, off = yielded(), off * TWO_DEGREES
        assert angle > 0.2
        options = {"speed": 1.5, "parcel": "S", "angle": angle + off}
        episode = play(bare(ORIENT), options, TURNING.ravel())
        assert episode.end["outcome"] == outcome
        assert episode.end["angle_error"] == pytest.approx(-off, abs=1e-9)
        assert episode.total("success") == (outcome == "success")
        assert episode.total("failure") == -1.0 * (outcome != "success")
        precision = math.exp(-abs(off) / math.radians(1.0))
        assert episode.total("precision") == pytest.approx(precision, abs=1e-6)


class TestReward:
    @pytest.mark.parametrize("seed", range(3))
    def test_turn_telescopes_and_the_error_is_reported_all_along(self, seed):
        episode = play(bare(ORIENT), {"angle": 0.05}, seed=seed)
        nearer = 0.05 - abs(episode.end["pose"][2] - 0.05)
        assert episode.total("turn") == pytest.approx(nearer, abs=1e-9)
        for info in (episode.start, *episode.infos):
            assert info["angle_error"] == pytest.approx(info["pose"][2] - 0.05, abs=1e-12)


class TestSeen:
    def test_features_of_a_state(self):
        x, theta = 0.83, -0.2
        start = Start(BOX, (x, 1.03, theta), (1.4, 0.1, 0.3), (-0.23,))
        half_extent = 0.125 * (math.cos(0.2) + math.sin(0.2))
        wanted = {
            "front in zone": (x + half_extent - 0.3) / 0.5,
            "rear to go": (1.9 - x + half_extent) / 0.5,
            "asked angle": -0.23,
            "angle to turn": -0.03 / 0.2,
            "angle to turn, near": math.tanh(-0.03 / TWO_DEGREES),
        }
        assert_observed(Orient(), start, wanted)
