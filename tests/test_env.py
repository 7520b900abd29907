"""The single environment: Gymnasium's contract, seeds, twins, memory and drawing."""

import copy
import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_by_gymnasium
from stable_baselines3.common.env_checker import check_env as check_by_stable_baselines3

import surface_gym as sg
from surface_gym.state import RUNNING, SUCCESS
from tests import environments as te


class TestCheckers:
    @te.every_cell
    def test_they_have_nothing_to_say(self, env_id, actions, sensor):
        env = te.bare(env_id, actions=actions, sensors=sensor())
        check_by_gymnasium(env, skip_render_check=True)
        check_by_stable_baselines3(env)

    @te.every_id
    @pytest.mark.usefixtures("screen")
    def test_nor_when_it_draws(self, env_id):
        check_by_gymnasium(te.bare(env_id, render_mode="rgb_array"))

    def test_they_are_heard_here(self):
        """A warning of theirs does fail a test: they warn of a wrapped environment."""
        with pytest.raises(UserWarning, match="is different from the unwrapped"):
            check_by_gymnasium(gym.make(te.SORT), skip_render_check=True)


class TestEpisodes:
    @te.every_cell
    def test_types_spaces_sums_and_outcomes(self, env_id, actions, sensor):
        env = te.bare(env_id, actions=actions, sensors=sensor())
        assert env.observation_space.dtype == np.float32
        for observation, reward, terminated, truncated, info in te.steps(env, seed=3, episodes=3):
            assert observation in env.observation_space
            assert observation.dtype == np.float32
            assert type(reward) is float
            assert type(terminated) is bool
            assert truncated is False
            assert all(type(term) is float for term in te.terms(info).values())
            assert reward == pytest.approx(math.fsum(te.terms(info).values()), abs=1e-12)
            assert type(info["is_success"]) is bool
            assert terminated == (info["outcome"] != "running")
            assert info["is_success"] == (info["outcome"] == "success")

    @te.every_id
    def test_what_it_returns_is_the_users_own(self, env_id):
        env, twin = te.pair(env_id=env_id)
        observation, info = env.reset(seed=0)
        for _ in range(3):
            observation[:] = np.nan
            info["pose"][:] = np.nan
            info["velocity"][:] = np.nan
            observation, reward, _, _, info = env.step(env.action_space.sample())
            te.assert_same(observation, (same := twin.step(twin.action_space.sample()))[0])
            te.assert_same((reward, info), (same[1], same[4]))

    @pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, te.by_pickle])
    def test_an_outcome_is_a_number_and_its_name(self, copied):
        env = te.bare(actions="halves")
        ended = te.played_out(env, 10, side=1, speed=1.5)[-1][4]["outcome"]
        outcome = copied(ended)
        for same in ("success", SUCCESS, ended, env.outcomes[SUCCESS]):
            assert outcome == same
            assert same == outcome
            assert (outcome != same) is False
        for other in ("running", RUNNING, env.outcomes[RUNNING]):
            assert outcome != other
        assert str(outcome) == f"{outcome}" == "success"
        assert len({outcome, "success"}) == 1
        both = np.array([outcome, env.outcomes[RUNNING]])
        assert both.dtype == np.int64
        assert both.tolist() == [SUCCESS, RUNNING]

    def test_time_counts_the_control_periods(self):
        for number, step in enumerate(te.steps(te.bare(control_period=0.03), seed=0), start=1):
            assert step[2] or step[4]["time"] == pytest.approx(0.03 * number)

    @pytest.mark.parametrize(
        ("arguments", "wrong", "message"),
        [
            ({}, [0, 1], r"shape \(64,\), got \(2,\)"),
            ({}, np.full(64, 4), r"between 0 and 3, got array\(\[4"),
            ({"actions": "halves"}, 16, "between 0 and 15, got 16"),
            ({"actions": "halves"}, [3], r"shape \(\), got \(1,\)"),
            ({"actions": "halves"}, "up", "whole numbers, got <U2: 'up'"),
            ({"orientations": "any", "actions": "quadrants"}, [0.0, 45.0, 0.0, 0.0], r"0.0\]; deg"),
            ({"task": "flow", "actions": "parcels"}, [0], r"shape \(48,\), got \(1,\)"),
            ({"task": "flow", "actions": "parcels", "gate": True}, 0, r"shape \(49,\), got \(\)"),
            (
                {"task": "flow", "actions": "parcels", "gate": True}, [0] * 48 + [9],
                "between 0 and 8 of the gate, got 9$",
            ),
        ],
    )  # fmt: skip
    def test_an_action_that_is_refused_is_spoken_of_as_one(self, arguments, wrong, message):
        env = sg.SmartSurfaceEnv(**arguments)
        env.reset(seed=0)
        with pytest.raises(ValueError, match=f"action must .*{message}"):
            env.step(wrong)

    def test_steps_out_of_turn_are_refused(self):
        env = te.bare(actions="halves")
        with pytest.raises(gym.error.ResetNeeded, match="reset"):
            env.step(0)
        te.played_out(env, 0, speed=2.7)
        with pytest.raises(gym.error.ResetNeeded, match="ended"):
            env.step(0)
        env.reset()
        env.step(0)


class TestSeeds:
    @te.every_id
    def test_starts_differ_from_seed_to_seed_and_from_reset_to_reset(self, env_id):
        env = te.bare(env_id)
        starts = [env.reset(seed=seed)[0] for seed in range(5)]
        starts += [env.reset()[0] for _ in range(5)]
        assert len(np.unique(starts, axis=0)) == 10

    def test_all_randomness_is_np_random(self):
        env = te.bare(actions="quadrants", sensors=te.SENSORS[-1](), **te.EVERYTHING_VARIES)
        first = list(te.steps(env, seed=1))
        env.reset(seed=1)
        env.np_random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(1)))
        env.action_space.seed(1)
        env.reset()
        second = [env.step(env.action_space.sample()) for _ in first]
        te.assert_same(tuple(first), tuple(second))


class TestTwins:
    @pytest.mark.parametrize("twin_of", te.TWINS)
    @pytest.mark.parametrize("make", [gym.make, te.native])
    @te.every_varying
    def test_go_on_alike(self, env_id, sensor, make, twin_of):
        settings = {"actions": "quadrants", "sensors": sensor(), **te.EVERYTHING_VARIES}
        env = make(env_id, max_episode_steps=8, **settings)
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(4):
            env.step(env.action_space.sample())
        twin = twin_of(env)
        for _ in range(40):
            first = env.step(env.action_space.sample())
            te.assert_same(first, twin.step(twin.action_space.sample()))
            if make is gym.make and (first[2] or first[3]):
                te.assert_same(env.reset(), twin.reset())

    @pytest.mark.parametrize("twin_of", te.TWINS)
    @pytest.mark.parametrize("make", [te.bare, te.native])
    def test_go_their_own_ways(self, make, twin_of):
        env, reference = (make(actions="halves") for _ in range(2))
        for each in (env, reference):
            each.reset(seed=0, options={"parcel": te.TRIANGLE})
        twin, action = twin_of(env), env.action_space.sample()
        for _ in range(5):
            twin.step((action + 5) % 16)
        for _ in range(5):
            te.assert_same(env.step(action), reference.step(action))


class TestMemory:
    @te.every_sensor
    def test_does_not_grow(self, sensor):
        env = te.bare(sensors=sensor(), **te.PARCELS_VARY)
        env.action_space.seed(0)
        action = env.action_space.sample()

        def step() -> None:
            if env.step(action)[2]:
                env.reset()

        env.reset(seed=0)
        assert te.growth(step, 2_000, 3_000) < 20  # [bytes]: less than any object kept


class TestDrawing:
    def test_it_changes_nothing(self):
        drawn, plain = te.bare(render_mode="rgb_array"), te.bare()
        for first, second in zip(te.steps(drawn, seed=2), te.steps(plain, seed=2), strict=True):
            drawn.render()
            te.assert_same(first, second)

    @pytest.mark.parametrize("make", [te.bare, te.native])
    def test_there_is_none_without_a_mode_or_before_the_first_reset(self, make):
        env = make()
        env.reset(seed=0)
        with pytest.warns(UserWarning, match="without specifying any render mode"):
            assert env.render() is None
        env.close()
        env.close()  # twice is fine
        with pytest.raises(gym.error.ResetNeeded):
            make(render_mode="rgb_array").render()
