"""Sort: starts, ends, reward and what is seen."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.tasks import Sort
from surface_gym.tasks.start import Start
from tests import tasks
from tests.environments import MINUS_45, PLUS_45, ROLL, TRIANGLE, bare, batch_with, steps

BOX = sg.layouts.box("S")
COASTING_LOSS = 0.01 * 9.81 / math.sqrt(2.0)  # [m/s^2] along x and y on 45 deg axes


def lateral_reach(info: dict, side: int) -> float:
    """[m] as the reward has it, from what is reported."""
    y, vx, vy = side * (info["pose"][1] - 1.0), info["velocity"][0], side * info["velocity"][1]
    shared = 0.5 * (vx + vy) if vx > vy else vy
    return min(0.6, y + max(0.0, shared) ** 2 / (2.0 * COASTING_LOSS))


class TestStarts:
    def test_obey_their_laws(self):
        starts = tasks.draws(Sort(), 600)
        speed = np.array([start.velocity[0] for start in starts])
        assert speed.min() >= 0.3
        assert speed.max() <= 2.7
        # Half of them from 0.3 to 1.1 m/s, and a third of the other half by chance.
        assert np.mean(speed <= 1.1) == pytest.approx(2.0 / 3.0, abs=0.06)
        assert np.mean([start.goal == (1.0,) for start in starts]) == pytest.approx(0.5, abs=0.06)
        assert {start.goal for start in starts} == {(1.0,), (-1.0,)}
        tasks.assert_laws(starts)

    @pytest.mark.parametrize(("share", "low", "high"), [(1.0, 0.4, 0.5), (0.0, 1.0, 2.0)])
    def test_bands(self, share, low, high):
        task = Sort(slow_share=share, speeds=(1.0, 2.0), slow_speeds=(0.4, 0.5))
        tasks.assert_uniform([start.velocity[0] for start in tasks.draws(task)], low, high)


class TestEnds:
    @pytest.mark.parametrize(
        ("side", "choice", "outcome"),
        [(1, MINUS_45, "success"), (-1, PLUS_45, "success"), (1, PLUS_45, "wrong side"),
         (-1, MINUS_45, "wrong side"), (0, MINUS_45, "wrong side"), (1, ROLL, "passed the zone"),
         (-1, ROLL, "passed the zone"), (0, ROLL, "success"), (1, tasks.BRAKE, "stalled"),
         (0, tasks.BRAKE, "stalled")],
    )  # fmt: skip
    def test_by_choice(self, side, choice, outcome):
        episode = tasks.play(bare(), {"speed": 1.5, "side": side, "parcel": "S"}, choice)
        assert episode.end["outcome"] == outcome
        assert episode.total("success") == (outcome == "success")
        assert episode.total("failure") == -1.0 * (outcome != "success")


class TestReward:
    @pytest.mark.parametrize("side", [1, 0, -1])
    @pytest.mark.parametrize("seed", range(2))
    def test_reach_telescopes(self, side, seed):
        episode = tasks.play(bare(), {"side": side}, seed=seed)

        def score(info: dict) -> float:
            if side:
                return lateral_reach(info, side)
            return 0.3 * info["pose"][0] - abs(info["pose"][1] - 1.0)

        gained = score(episode.end) - score(episode.start)
        assert episode.total("reach") == pytest.approx(2.0 * gained, abs=1e-9)

    @pytest.mark.parametrize(
        ("side", "speed", "choice", "outcome"),
        [(1, 1.5, MINUS_45, "success"), (0, 1.5, ROLL, "success"), (1, 0.4, MINUS_45, "stalled")],
    )
    def test_time_costs_and_haste_pays_at_success(self, side, speed, choice, outcome):
        episode = tasks.play(bare(), {"side": side, "speed": speed}, choice)
        assert episode.end["outcome"] == outcome
        paid = 4.0 / episode.end["time"] if outcome == "success" else 0.0
        assert all(info["reward_haste"] == 0.0 for info in episode.infos[:-1])
        assert episode.total("haste") == pytest.approx(paid, abs=1e-12)
        assert episode.total("time") == pytest.approx(-0.3 * episode.end["time"], abs=1e-12)

    def test_a_longer_reach_than_enough_earns_no_more(self):
        fast = Start(BOX, (0.5, 1.0, 0.0), (2.5, 0.0, 0.0), (1.0,))
        _, terms = tasks.advanced(Sort(), fast, ROLL)
        assert terms["reach"] == 0.0


class TestSeen:
    @pytest.mark.parametrize("side", [1, -1])
    def test_features_of_a_state(self, side):
        x, y, theta, vx, vy, omega = 0.83, 0.04, 0.3, 1.4, 0.25, -0.6
        pose, velocity = (x, 1.0 + side * y, side * theta), (vx, side * vy, side * omega)
        start = Start(BOX, pose, velocity, (float(side),))
        half_extent = 0.125 * (math.cos(theta) + math.sin(theta))  # of a turned square
        wanted = {
            "clearance": (y - half_extent - 0.05) / 0.2,
            "time": 0.0,
            "distance into zone": (x - half_extent - 0.3) / 0.5,
            "side": side,
        }
        tasks.assert_observed(Sort(), start, wanted, side)

    @pytest.mark.parametrize("side", [1, -1])
    def test_the_clearance_is_that_of_the_corner_nearest_to_the_line(self, side):
        start = Start(TRIANGLE, (1.0, 1.0 + side * 0.3, 0.7), (1.0, 0.0, 0.0), (float(side),))
        batch = batch_with(start, task=Sort())
        x, y, theta = batch.parcels.truth[0, :3]
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        corners = turn @ (TRIANGLE.base.outline - TRIANGLE.base.centroid).T + [[x], [y]]
        rows = np.nonzero(batch.bodies.rotor[0].any(axis=1))[0]
        outermost = 0.05 + 0.1 * rows.max() - 1.0  # of the line's rotors, from its middle
        clearance = ((side * (corners[1] - 1.0)).min() - outermost) / 0.2
        seen = tasks.features_of(Sort(), start)["clearance"]
        assert seen == pytest.approx(clearance, abs=1e-6)

    def test_time_is_seen(self):
        env = bare()
        for observation, *_, info in steps(env, seed=0):
            assert observation[12] == pytest.approx(info["time"] / 4.0)

    def test_mirrored_episodes_look_alike(self):
        episodes = []
        mirrored = np.array([0, 2, 1, 3])
        for side in (1, -1):
            env = bare(actions="quadrants")
            action = np.array([MINUS_45, ROLL, MINUS_45, tasks.BRAKE])
            if side < 0:
                action = mirrored[env.config.action_kind.flip(action[None])[0]]
            options = {"side": side, "speed": 1.5, "parcel": "B"}
            episodes.append(tasks.play(env, options, action, longest=12))
        for one, other in zip(episodes[0].steps, episodes[1].steps, strict=True):
            np.testing.assert_allclose(one[0][:-1], other[0][:-1], rtol=0, atol=1e-5)
            assert (one[0][-1], other[0][-1]) == (1.0, -1.0)
            assert one[1] == pytest.approx(other[1], abs=1e-9)
        assert abs(episodes[0].end["pose"][2]) > 0.01  # it did turn
