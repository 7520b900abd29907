"""Stop: starts, ends, reward and what is seen."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.tasks import Stop
from surface_gym.tasks.start import Start
from tests.environments import ROLL, bare
from tests.tasks import BRAKE, ROLL_LOSS, assert_laws, assert_observed, assert_uniform, draws, play

STOP = "SmartSurface/Stop-v0"
BOX = sg.layouts.box("S")


def rest(size: str, speed: float) -> float:
    """[m] where a box rests if every module of the zone brakes, by the simulator alone."""
    layout = sg.layouts.slowing(size, 0.0, task_columns=16, columns=30)
    start = sg.layouts.start(size)
    run = sg.simulate(layout, sg.layouts.box(size), start, (speed, 0.0, 0.0), 5.0)
    assert np.abs(run.velocity[-1]).max() < 1e-6
    return float(run.pose[-1, 0])


class TestStarts:
    def test_obey_their_laws(self):
        starts = draws(Stop())
        assert_laws(starts, 0.5, 2.7)
        for start in starts:
            zone_end = 1.9 if start.parcel is BOX else 2.1
            assert start.goal[0] + start.parcel.rear <= zone_end + 1e-12

    @pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
    @pytest.mark.parametrize("size", ["S", "B"])
    @pytest.mark.parametrize("speed", [0.5, 1.2, 2.7])
    def test_every_asked_x_can_be_reached(self, size, speed):
        """Braking all the way it rests before it; rolling all the way it would get past it."""
        asked = [start.goal[0] for start in draws(Stop(), speed=speed, parcel=size)]
        assert rest(size, speed) <= min(asked)
        assert max(asked) < sg.layouts.start(size)[0] + speed**2 / (2.0 * ROLL_LOSS)
        assert max(asked) > min(asked)

    def test_asked_x_is_uniform_or_at_the_end_of_a_zone_too_short_to_brake_in(self):
        asked = [start.goal[0] for start in draws(Stop(), speed=1.0, parcel="S")]
        braking = 0.3 + 0.125 + 1.0 / 9.81  # brakes at 0.5 g, wholly in the zone
        assert_uniform(asked, braking, 1.9 - 0.125)
        for start in draws(Stop(), zone=(5, 8), speed=2.0, parcel="S"):
            assert start.goal == pytest.approx((0.9 - 0.125,))


class TestEnds:
    @pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
    @pytest.mark.parametrize(
        ("off", "outcome"),
        [(0.0, "success"), (0.004, "success"), (-0.004, "success"), (0.006, "missed"),
         (0.3, "missed"), (-0.05, "passed the asked x")],
    )  # fmt: skip
    @pytest.mark.parametrize("size", ["S", "B"])
    def test_braking(self, size, off, outcome):
        position = rest(size, 1.5) + off
        episode = play(bare(STOP), {"speed": 1.5, "parcel": size, "position": position}, BRAKE)
        assert episode.end["outcome"] == outcome
        assert episode.total("success") == (outcome == "success")
        assert episode.total("failure") == -1.0 * (outcome != "success")
        if outcome != "passed the asked x":
            assert episode.end["stop_error"] == pytest.approx(-off, abs=1e-4)
            precision = math.exp(-abs(episode.end["stop_error"]) / 0.002)
            assert episode.total("precision") == pytest.approx(precision)

    def test_rolling_out_at_last_misses(self):
        """A slow parcel rolls to rest within the zone: v^2 / (2 mu_min g) on."""
        end = play(bare(STOP), {"speed": 0.4, "parcel": "S", "position": 1.5}, ROLL).end
        assert end["outcome"] == "missed"
        assert end["pose"][0] == pytest.approx(0.125 + 0.16 / (2.0 * ROLL_LOSS), abs=0.005)


class TestReward:
    @pytest.mark.parametrize("seed", range(3))
    def test_approach_telescopes_and_the_error_is_reported_all_along(self, seed):
        options = {"speed": 1.2, "position": 1.1}
        episode = play(bare(STOP), options, seed=seed)
        nearer = abs(1.1 - episode.start["pose"][0]) - abs(1.1 - episode.end["pose"][0])
        assert episode.total("approach") == pytest.approx(nearer, abs=1e-9)
        for info in (episode.start, *episode.infos):
            assert info["stop_error"] == pytest.approx(info["pose"][0] - 1.1, abs=1e-12)


class TestSeen:
    @pytest.mark.parametrize("position", [1.2, 0.82])
    def test_features_of_a_state(self, position):
        x, vx = 0.83, 1.4
        start = Start(BOX, (x, 1.0, -0.2), (vx, 0.1, 0.3), (position,))
        half_extent = 0.125 * (math.cos(0.2) + math.sin(0.2))
        to_go = position - x
        over = vx - math.sqrt(2.0 * 0.5 * 9.81 * max(0.0, to_go))
        wanted = {
            "front in zone": (x + half_extent - 0.3) / 0.5,
            "rear to go": (1.9 - x + half_extent) / 0.5,
            "to go": to_go / 0.5,
            "to go, near": math.tanh(to_go / 0.05),
            "to go, nearest": math.tanh(to_go / 0.01),
            "excess of speed": over / 0.2,
        }
        assert_observed(Stop(), start, wanted)
