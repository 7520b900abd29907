"""Park: starts, ends, reward and what is seen."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.tasks import Park
from surface_gym.tasks.park import ENTRY_X
from surface_gym.tasks.start import Start
from tests.environments import ROLL, bare, batch_with
from tests.tasks import BRAKE, assert_uniform, draws, features_of, play

PARK = "SmartSurface/Park-v0"
BOX = sg.layouts.box("S")
TWO_DEGREES = math.radians(2.0)
SPEED, MIDDLE = 1.4, 0.8  # [m/s], [m]

# A layout that turns the S-box as it stops: only modules on the left brake.
LAYOUT = np.full((16, 20), ROLL)
LAYOUT[8:, 5:] = BRAKE


def rest() -> tuple[float, float, float]:
    """x, y [m] and theta [rad] at which it rests, by the simulator alone, in finer steps."""
    line, angles = Park.line, np.array(sg.lines.ORIENTATIONS)
    surface = line.surface(angles[LAYOUT], np.ones(LAYOUT.shape, dtype=bool))
    run = sg.simulate(surface, BOX, (ENTRY_X, MIDDLE, 0.0), (SPEED, 0.0, 0.0), 3.0, dt=5e-4)
    assert np.abs(run.velocity[-1]).max() < 1e-6
    x, y, theta = run.pose[-1].tolist()
    return x, y, theta


def options(x: float, y: float, theta: float) -> dict[str, object]:
    goal = {"ahead": x - ENTRY_X, "aside": y - MIDDLE, "angle": theta}
    return {"speed": SPEED, "parcel": "S", **goal}


class TestStarts:
    def test_obey_their_laws(self):
        starts = draws(Park())
        assert {start.parcel for start in starts} == {sg.layouts.box(size) for size in "SB"}
        assert_uniform([start.velocity[0] for start in starts], 1.2, 1.6)
        assert {start.pose for start in starts} == {(ENTRY_X, MIDDLE, 0.0)}
        for k, bounds in enumerate(((0.9, 1.3), (0.6, 1.0), (-math.pi / 6, math.pi / 6))):
            assert_uniform([start.goal[k] for start in starts], *bounds)

    def test_the_centre_of_any_base_enters_at_the_same_place(self):
        parcel = sg.Parcel(sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.1, 0.3)]))
        batch = batch_with(draws(Park(), 1, parcel=parcel)[0], task="park")
        np.testing.assert_allclose(batch.parcels.truth[0, :2], (ENTRY_X, MIDDLE), atol=1e-12)


class TestEnds:
    @pytest.mark.parametrize(
        ("off", "turn", "outcome"),
        [(0.0, 0.0, "success"), (0.9, 0.9, "success"), (-0.9, -0.9, "success"),
         (1.1, 0.0, "missed"), (0.0, 1.1, "missed"), (0.0, -1.1, "missed")],
    )  # fmt: skip
    def test_success_is_rest_within_both_tolerances(self, off, turn, outcome):
        x, y, theta = rest()
        assert abs(y - MIDDLE) > 0.001
        assert abs(theta) > 0.04
        slant = 0.6  # of the offset: 3, 4, 5
        goal = (x + 0.005 * off * slant, y + 0.005 * off * 0.8, theta + TWO_DEGREES * turn)
        episode = play(bare(PARK, control_period=1e-3), options(*goal), LAYOUT.ravel())
        assert episode.end["outcome"] == outcome
        assert episode.end["distance"] == pytest.approx(0.005 * abs(off), abs=3e-4)
        assert episode.end["angle_error"] == pytest.approx(-TWO_DEGREES * turn, abs=3e-3)
        assert episode.total("success") == 2.0 * (outcome == "success")
        assert episode.total("failure") == -1.0 * (outcome == "missed")
        remaining = 0.005 * math.hypot(off, turn)
        precision = 2.0 * math.exp(-remaining / 0.01)
        assert episode.total("precision") == pytest.approx(precision, abs=0.08)

    def test_passing_the_goal_is_no_success(self):
        episode = play(bare(PARK), options(ENTRY_X + 0.6, MIDDLE, 0.0), ROLL)
        assert min(info["distance"] for info in episode.infos) < 0.04
        assert episode.end["outcome"] == "off the surface"


class TestReward:
    @pytest.mark.parametrize("seed", range(3))
    def test_approach_telescopes(self, seed):
        episode = play(bare(PARK), options(1.1, 0.9, 0.2), seed=seed)

        def remaining(info):
            x, y, theta = info["pose"] - (1.1, 0.9, 0.2)
            return math.hypot(x, y, theta * 0.005 / TWO_DEGREES)

        nearer = remaining(episode.start) - remaining(episode.end)
        assert episode.total("approach") == pytest.approx(nearer, abs=1e-9)


START = Start(BOX, (0.73, 0.83, -0.2), (1.1, 0.3, 0.4), (1.13, 0.93, 0.1))


class TestSeen:
    def test_features_of_a_state(self):
        seen = features_of(Park(), START)
        brake = math.hypot(1.1, 0.3) / 9.81  # [s] to rest at 0.5 g
        short_x, short_y = 0.4 - 1.1 * brake, 0.1 - 0.3 * brake
        wanted = {
            "lateral offset": 0.03 / 0.3, "lateral speed": 0.6, "to go along": 0.8,
            "to go along, nearest": math.tanh(40.0), "to go across": 0.5,
            "to go across, near": math.tanh(2.0), "angle to turn": 1.0,
            "short along": short_x / 0.2, "short along, near": math.tanh(short_x / 0.03),
            "short across": short_y / 0.2, "short across, near": math.tanh(short_y / 0.03),
            "short of the angle": (0.3 - 0.4 * 0.4 * 0.125 / 4.4) / 0.3,
        }  # fmt: skip
        assert {name: seen[name] for name in wanted} == pytest.approx(wanted, abs=1e-6)

    def test_a_start_decoded_is_seen_as_the_start_itself(self):
        seen = batch_with(START, task="park").parcels.observation[0]
        decoded = EnvConfig("park").decode_start(seen)
        again = batch_with(decoded, task="park").parcels.observation[0]
        np.testing.assert_allclose(again, seen, atol=2e-5)
