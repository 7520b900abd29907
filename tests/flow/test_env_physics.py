"""The single environment of a flow: its parcels move as `simulate` says, and what it pays."""

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import REWARD
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.state import ENTERED
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import ON_THE_WAY, PARCEL_TERMS
from surface_gym.physics.types import VX, X, Y
from surface_gym.randomisation import Actuators, Randomisation
from tests.environments import terms
from tests.flow import flows

DT = 0.005  # [s]
ASKEW = {"tilt": 0.06, "tilt_direction": 1.2}


class TestPhysics:
    @pytest.mark.parametrize(
        ("box", "choice", "slope"),
        [
            (flows.BOX, flows.MINUS_45, {}), (flows.LARGE_BOX, flows.ROLL, {}),
            (flows.BOX, flows.PLUS_45, ASKEW),
        ],
    )  # fmt: skip
    def test_one_alone_moves_as_by_simulate(
        self, box: sg.Parcel, choice: int, slope: dict[str, float]
    ) -> None:
        stream = flows.trace((0.0, "left 1"), parcel=box, speed=1.7)
        env = flows.bare(stream=stream, duration=10.0, **slope)
        env.reset(seed=0)
        surface = flows.surface_of(env.config, env.config.chosen_orientations[choice])
        start = (box.base.length / 2.0, flows.SHORT.line_y, 0.0)
        run = sg.simulate(surface, box, start, (1.7, 0.0, 0.0), duration=10.0)
        for period in itertools.count(1):
            info = env.step(flows.same_choice(env, choice))[4]
            if info["correct"] + info["wrong"] > 0:
                break
            truth = flows.truths(env.batch)[0]
            np.testing.assert_array_equal(truth[:3], run.pose[8 * period])
            np.testing.assert_array_equal(truth[3:], run.velocity[8 * period])
        step = round(env.batch.streams.departed[0, 0] / DT)
        assert 8 * (period - 1) < step <= 8 * period
        np.testing.assert_array_equal(env.batch.parcels.truth[0, :3], run.pose[step])

    @pytest.mark.parametrize("slope", [{}, ASKEW])
    def test_two_move_as_by_simulate_together(self, slope: dict[str, float]) -> None:
        poses = [(0.7, 1.0, 0.1), (0.35, 1.02, 0.0)]
        velocities = [(0.3, 0.0, 0.0), (1.5, 0.0, 0.0)]
        stream = flows.trace((0.0, "straight"), (0.0, "straight"))
        batch = flows.batch_with(stream, duration=5.0, restitution=0.5, **slope)
        flows.set_down(batch, poses, velocities)
        surface = flows.surface_of(batch.config, math.pi / 2)
        run = sg.simulate_together(
            surface, [flows.BOX, flows.BOX], poses, velocities, duration=1.0, restitution=0.5
        )
        for period in range(1, 21):
            batch.step(flows.command(batch, flows.ROLL))
            for number, truth in flows.truths(batch).items():
                np.testing.assert_array_equal(truth[:3], run.trajectories[number].pose[8 * period])
        time = run.touches.time[run.touches.time < 20.5 * 0.04]
        begun = int((np.diff(time, prepend=-1.0) > 0.2 + DT / 2).sum())
        assert batch.streams.touches[0, :2].tolist() == [begun, begun]
        assert begun >= 1


class TestMirror:
    @pytest.mark.parametrize(
        ("actions", "slope"), [("modules", {}), ("parcels", {}), ("modules", ASKEW)]
    )
    def test_a_mirrored_stream_runs_in_a_mirror(
        self, actions: str, slope: dict[str, float]
    ) -> None:
        names = ("left 1", "right 2", "right 1", "straight", "left 2")
        mirrored = ("right 1", "left 2", "left 1", "straight", "right 2")
        other_way = slope | {"tilt_direction": -slope.get("tilt_direction", 0.0)}
        env, mirror = (
            flows.bare(
                stream=flows.trace(*[(0.4 * k, name) for k, name in enumerate(each)]),
                actions=actions, duration=2.4, **way,
            )
            for each, way in ((names, slope), (mirrored, other_way))
        )  # fmt: skip
        kind = env.config.action_kind
        env.action_space.seed(3)
        env.reset(seed=0)
        mirror.reset(seed=0)
        for period in range(60):
            if period % 8 == 0:
                action = env.action_space.sample()
            other = action if actions == "parcels" else kind.flip(action[np.newaxis])[0]
            observation, reward, *_, info = env.step(action)
            observed, paid, *_, reported = mirror.step(flows.MIRRORED[other])
            assert info["parcels"].tolist() == reported["parcels"].tolist()
            assert reward == pytest.approx(paid, abs=1e-6)
            seen = flows.truths(mirror.batch)
            for number, truth in flows.truths(env.batch).items():
                flip = truth * [1.0, -1.0, -1.0, 1.0, -1.0, -1.0]
                flip[Y] += 2 * flows.SHORT.line_y
                np.testing.assert_allclose(seen[number], flip, rtol=0.0, atol=1e-7)
            # Whom a side is asked of is shown in a mirror, all but that side.
            aside = observation[:, 14] != 0.0
            both = np.delete(observation, 14, axis=1), np.delete(observed, 14, axis=1)
            np.testing.assert_allclose(both[0][aside], both[1][aside], rtol=0.0, atol=1e-5)
            np.testing.assert_array_equal(observation[:, 14], -observed[:, 14])
        assert info["entered"] >= 4


class TestEnds:
    def test_a_jam_terminates_after_patience(self) -> None:
        env = flows.bare(stream=Stream(Steady(36000.0)), patience=0.5, duration=20.0)
        env.reset(seed=0)
        still = 0
        terminated = False
        while not terminated:
            before = flows.truths(env.batch)
            _, reward, terminated, truncated, info = env.step(flows.same_choice(env, flows.BRAKE))
            now = flows.truths(env.batch)
            slow = all(np.hypot(*each[VX : VX + 2]) < 1e-3 for each in now.values())
            still = still + 1 if slow else 0
            assert (terminated, truncated) == (0.04 * still >= 0.5, False)
        assert set(before) == set(now)
        assert info["outcome"] == "jam"
        assert info["reward_jam"] == -10.0
        assert reward < -9.0
        assert info["waiting"] > 0


def out_and_halt(env: SmartSurfaceEnv) -> Iterator[flows.Step]:
    """Every step of an episode in which parcels are let out to a side, and later run into others
    that brake.
    """
    env.reset(seed=2)
    for period in itertools.count():
        step = env.step(flows.same_choice(env, flows.MINUS_45 if period < 50 else flows.BRAKE))
        yield step
        if step[2] or step[3]:
            break


class TestRewards:
    @pytest.mark.parametrize("lateral", [0.0, 0.03])
    def test_those_of_parcels_and_of_the_surface_sum_up(self, lateral: float) -> None:
        env = flows.bare(
            actions="modules", duration=4.0, randomisation=Randomisation(lateral=lateral)
        )
        for _, reward, _, _, info in out_and_halt(env):
            parcels, found = env.batch.parcels, terms(info)
            shared = math.fsum(found[name] for name in PARCEL_TERMS)
            assert parcels.reward.sum() == pytest.approx(shared, abs=1e-9)
            assert reward == pytest.approx(parcels.reward.sum() + found["waiting"] + found["jam"])
        assert info["touches"] > 0
        assert info["correct"] + info["wrong"] > 0

    def test_term_by_term(self) -> None:
        env = flows.bare(actions="modules", duration=4.0)
        totals = dict.fromkeys((*PARCEL_TERMS, "waiting"), 0.0)
        for *_, info in out_and_halt(env):
            for name in totals:
                totals[name] += info[REWARD + name]
        streams = env.batch.streams
        assert totals["correct"] == info["correct"]
        assert totals["wrong"] == -info["wrong"]
        assert totals["touch"] == pytest.approx(-0.5 * 2 * info["touches"])
        entered = int(streams.tally[0, ENTERED])
        stay = (
            np.where(np.isnan(streams.departed), info["time"], streams.departed) - streams.entered
        )
        assert totals["time"] == pytest.approx(-0.2 * stay[0, :entered].sum())
        assert totals["waiting"] == pytest.approx(-0.1 * streams.waited[0])
        assert streams.waited[0] > 0.0

    def test_reach_is_earned_from_where_a_parcel_entered(self) -> None:
        """One that enters aside of the middle neither gains nor loses by it."""
        stream = Stream(Steady(6000.0), destinations={"straight": 1.0})
        varies = Randomisation(lateral=0.05)
        env = flows.bare(stream=stream, actions="parcels", randomisation=varies, duration=1.2)
        _, info = env.reset(seed=0)
        assert set(terms(info).values()) == {0.0}
        played = flows.play(env, flows.ROLL)
        earned = sum(step[4]["reward_reach"] for step in played)
        assert played[-1][4]["correct"] == 0
        wanted = 0.0
        for number, truth in flows.truths(env.batch).items():
            start = env.batch.streams.start[0, number]
            aside = abs(truth[Y] - flows.SHORT.line_y) - abs(start[Y] - flows.SHORT.line_y)
            wanted += ON_THE_WAY * (truth[X] - start[X]) - aside
        assert earned == pytest.approx(wanted, abs=1e-9)
        assert played[-1][4]["entered"] == 2


class TestTouches:
    def test_count_once_a_beginning(self) -> None:
        """One that is pushed along is touched once; after 0.2 s apart it begins anew."""
        stream = flows.trace(*[(0.0, "straight")] * 2)
        batch = flows.batch_with(stream, duration=9.0, restitution=0.0)
        flows.set_down(batch, [(0.7, 1.0, 0.0), (0.4, 1.0, 0.0)], [(0.3, 0, 0), (1.5, 0, 0)])
        roll = flows.command(batch, flows.ROLL)
        for _ in range(3):
            batch.step(roll)
        assert batch.streams.touches[0].tolist()[:2] == [1, 1]
        # Taken apart for a moment too short to count, and then for one that counts.
        for periods, begun in ((2, 1), (6, 2)):
            batch.parcels.state[0, 0] += 0.1
            batch.parcels.state[:2, VX] = 0.5
            for _ in range(periods):
                batch.step(roll)
            batch.parcels.state[0, 0] = batch.parcels.state[1, 0] + 0.255
            batch.parcels.state[:2, VX] = 0.1, 0.8
            for _ in range(4):
                batch.step(roll)
            assert batch.streams.touches[0].tolist()[:2] == [begun, begun]


class TestModules:
    def test_an_action_sets_exactly_the_modules(self) -> None:
        stuck = ((9, 7), (11, 19))
        env = flows.bare(actions="modules", actuators=Actuators(stuck=stuck))
        env.reset(seed=0)
        streams = env.batch.streams
        first_row, rows, first, columns = env.config.site.zone
        expected = np.full(env.config.site.rotor.shape, math.pi / 2)
        env.action_space.seed(0)
        turns = 0
        for _ in range(5):
            action = env.action_space.sample()
            before = expected.copy()
            angle = np.array(env.config.chosen_orientations)[action.reshape(rows, columns)]
            expected[first_row : first_row + rows, first : first + columns] = angle
            expected[tuple(np.transpose(stuck))] = math.pi / 2
            expected[:, 20:] = math.pi / 2  # no rotors
            turns += int((expected != before).sum())
            *_, info = env.step(action)
            np.testing.assert_array_equal(streams.commanded[0], expected)
            assert info["turns"] == turns
            surface = env.batch.surfaces
            direction = surface.direction[0, surface.axis[0]]
            rotor = env.config.site.rotor
            wanted = np.stack([np.cos(expected), np.sin(expected)], axis=-1)
            np.testing.assert_allclose(direction[rotor], wanted[rotor], atol=1e-12)
