"""Slow: starts, ends, reward and what is seen."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.tasks import Slow
from surface_gym.tasks.start import Start
from tests.environments import ROLL, bare
from tests.tasks import ROLL_LOSS, assert_laws, assert_observed, assert_uniform, draws, play

SLOW = "SmartSurface/Slow-v0"
BOX = sg.layouts.box("S")
ZONE_START, ZONE_END = 0.3, 1.9  # [m] of the S-box


def rolled(speed: float, way: float) -> float:
    """[m/s] left of a speed after a way of rolling, by the work of friction."""
    return math.sqrt(speed**2 - 2.0 * ROLL_LOSS * way)


def excess(info: dict, speed: float, ratio: float) -> float:
    """[-] as the reward has it, for the S-box, from what is reported."""
    x, _, theta = info["pose"]
    half_extent = 0.125 * (abs(math.cos(theta)) + abs(math.sin(theta)))
    to_go = max(0.0, ZONE_END - x + half_extent)
    needed = math.sqrt((ratio * speed) ** 2 + 2.0 * ROLL_LOSS * to_go)
    return abs(math.hypot(*info["velocity"][:2]) - needed) / speed


class TestStarts:
    def test_obey_their_laws(self):
        starts = draws(Slow())
        assert_laws(starts, 0.9, 2.7)
        for start in starts:
            ratio, speed = start.goal
            assert start.velocity[0] == speed
            assert 0.15 <= ratio <= 0.8
            end = ZONE_END if start.parcel is BOX else 2.1
            assert ratio * speed < rolled(speed, end)

    def test_ratios_are_uniform_up_to_what_rolling_leaves_in_the_zone(self):
        assert_uniform([start.goal[0] for start in draws(Slow(), speed=2.0)], 0.15, 0.8)
        starts = draws(Slow(ratios=(0.1, 1.0)), zone=(5, 6), speed=1.0, parcel="S")
        assert_uniform([start.goal[0] for start in starts], 0.1, 0.98 * rolled(1.0, 0.7))


class TestEnds:
    @pytest.mark.parametrize(
        ("off", "outcome"),
        [(0.0, "success"), (0.008, "success"), (-0.012, "missed"), (0.012, "missed")],
    )
    def test_rolling_leaves_what_friction_lets_it(self, off, outcome):
        ratio = rolled(2.0, ZONE_END) / 2.0 + off
        episode = play(bare(SLOW), {"speed": 2.0, "parcel": "S", "ratio": ratio}, ROLL)
        assert episode.end["outcome"] == outcome
        assert episode.end["ratio_error"] == pytest.approx(-off, abs=1e-3)
        assert episode.total("success") == (outcome == "success")
        assert episode.total("failure") == 0.0  # it did leave the zone
        past = episode.end["pose"][0] - 0.125 - ZONE_END
        assert 0.0 < past <= 0.005 * episode.end["velocity"][0]  # within the physics step

    def test_a_zone_that_no_parcel_can_leave_is_refused(self):
        # With its rear at 2.9 m, where this ends, the B-box's centre is off the surface.
        with pytest.raises(ValueError, match=r"^zone must end at column 26 or before"):
            bare(SLOW, zone=(3, 28))


class TestReward:
    @pytest.mark.parametrize("seed", range(3))
    def test_excess_telescopes_and_the_error_is_reported_all_along(self, seed):
        options = {"speed": 1.7, "parcel": "S", "ratio": 0.4}
        episode = play(bare(SLOW), options, seed=seed)
        shrunk = excess(episode.start, 1.7, 0.4) - excess(episode.end, 1.7, 0.4)
        assert episode.total("excess") == pytest.approx(shrunk, abs=1e-9)
        for info in (episode.start, *episode.infos):
            error = np.hypot(*info["velocity"][:2]) / 1.7 - 0.4
            assert info["ratio_error"] == pytest.approx(error, abs=1e-12)

    def test_rolling_keeps_the_excess_and_precision_falls_with_the_error(self):
        """What it would roll out with does not change while it rolls, but for the step's error."""
        episode = play(bare(SLOW), {"speed": 2.0, "parcel": "S", "ratio": 0.93}, ROLL)
        assert episode.total("excess") == pytest.approx(0.0, abs=0.01)
        error = np.hypot(*episode.end["velocity"][:2]) / 2.0 - 0.93
        assert episode.total("precision") == pytest.approx(math.exp(-abs(error) / 0.01))


class TestSeen:
    @pytest.mark.parametrize("parcel", [BOX, sg.Parcel(sg.Disc(0.125))], ids=["box", "disc"])
    def test_features_of_a_state(self, parcel):
        x, theta, vx, vy = 0.83, 0.3, 1.4, -0.25
        start = Start(parcel, (x, 0.96, theta), (vx, vy, 0.6), (0.4, 2.2))
        half_extent = 0.125 * (math.cos(theta) + math.sin(theta) if parcel is BOX else 1.0)
        to_go = ZONE_END - x + half_extent
        over = math.hypot(vx, vy) - math.sqrt((0.4 * 2.2) ** 2 + 2.0 * ROLL_LOSS * to_go)
        wanted = {
            "front in zone": (x + half_extent - ZONE_START) / 0.5,
            "rear to go": to_go / 0.5,
            "entry speed": 0.7,
            "asked ratio": 0.4,
            "excess of speed": over / 0.2,
            "fine excess": math.tanh(over / 0.02),
        }
        assert_observed(Slow(), start, wanted)
