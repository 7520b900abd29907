"""The single environment: Gymnasium's contract, seeds, twins, memory and drawing."""

import math
import tracemalloc
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_by_gymnasium
from stable_baselines3.common.env_checker import check_env as check_by_stable_baselines3

from surface_gym.randomisation import Actuators, Randomisation
from tests.environments import (
    EVERYTHING_VARIES,
    MINUS_45,
    PLUS_45,
    ROLL,
    SENSORS,
    SORT,
    TRIANGLE,
    TWINS,
    assert_same,
    bare,
    every_cell,
    every_id,
    every_sensor,
    every_varying,
    played_out,
    same_choice,
    steps,
)


class TestCheckers:
    @every_cell
    def test_they_have_nothing_to_say(self, env_id: str, actions: str, sensor: Any) -> None:
        env = bare(env_id, actions=actions, sensors=sensor())
        check_by_gymnasium(env, skip_render_check=True)
        check_by_stable_baselines3(env)

    @every_id
    @pytest.mark.usefixtures("screen")
    def test_nor_when_it_draws(self, env_id: str) -> None:
        check_by_gymnasium(bare(env_id, render_mode="rgb_array"))

    def test_they_are_heard_here(self) -> None:
        """A warning of theirs does fail a test: they warn of a wrapped environment."""
        with pytest.raises(UserWarning, match="is different from the unwrapped"):
            check_by_gymnasium(gym.make(SORT), skip_render_check=True)


class TestEpisodes:
    @every_cell
    def test_types_spaces_sums_and_outcomes(self, env_id: str, actions: str, sensor: Any) -> None:
        env = bare(env_id, actions=actions, sensors=sensor())
        assert env.observation_space.dtype == np.float32
        for observation, reward, terminated, truncated, info in steps(env, seed=3, episodes=3):
            assert observation in env.observation_space
            assert observation.dtype == np.float32
            assert type(reward) is float
            assert type(terminated) is bool
            assert truncated is False
            assert all(type(term) is float for term in info["reward_terms"].values())
            assert reward == pytest.approx(math.fsum(info["reward_terms"].values()), abs=1e-12)
            assert type(info["is_success"]) is bool
            assert terminated == (info["outcome"] != "running")
            assert info["is_success"] == (info["outcome"] == "success")

    @every_id
    def test_what_it_returns_is_the_users_own(self, env_id: str) -> None:
        env, twin = bare(env_id), bare(env_id)
        for each in (env, twin):
            each.action_space.seed(0)
        observation, info = env.reset(seed=0)
        twin.reset(seed=0)
        for _ in range(3):
            observation[:] = np.nan
            info["pose"][:] = np.nan
            info["velocity"][:] = np.nan
            info["reward_terms"].clear()
            observation, reward, _, _, info = env.step(env.action_space.sample())
            assert_same(observation, (same := twin.step(twin.action_space.sample()))[0])
            assert_same((reward, info), (same[1], same[4]))

    def test_time_counts_the_control_periods(self) -> None:
        for number, step in enumerate(steps(bare(control_period=0.03), seed=0), start=1):
            assert step[2] or step[4]["time"] == pytest.approx(0.03 * number)

    @every_id
    def test_running_out_of_time_truncates(self, env_id: str) -> None:
        env = gym.make(env_id, max_episode_steps=3)
        *before, last = steps(env, seed=0)
        assert [step[2:4] for step in before] == [(False, False)] * 2
        assert last[2:4] == (False, True)
        assert not last[4]["is_success"]

    @pytest.mark.parametrize(
        ("side", "choice", "outcome"),
        [
            (1, MINUS_45, "success"),
            (-1, PLUS_45, "success"),
            (1, PLUS_45, "wrong side"),
            (-1, MINUS_45, "wrong side"),
            (1, ROLL, "passed the zone"),
        ],
    )
    def test_outcomes_of_sort(self, side: int, choice: int, outcome: str) -> None:
        env = bare(actions="modules")
        action = same_choice(env, choice)
        *_, info = played_out(env, action, speed=1.5, side=side, parcel="S")[-1]
        assert info["outcome"] == outcome
        assert info["is_success"] == (outcome == "success")

    def test_a_parcel_too_slow_stalls(self) -> None:
        env = bare()
        action = same_choice(env, MINUS_45)
        *_, info = played_out(env, action, speed=0.3, side=1, parcel="B")[-1]
        assert (info["outcome"], info["is_success"]) == ("stalled", False)
        assert info["reward_terms"]["failure"] < 0.0
        np.testing.assert_allclose(info["velocity"], 0.0, atol=1e-3)

    def test_steps_out_of_turn_are_refused(self) -> None:
        env = bare(actions="halves")
        with pytest.raises(gym.error.ResetNeeded, match="reset"):
            env.step(0)
        played_out(env, 0, speed=2.7)
        with pytest.raises(gym.error.ResetNeeded, match="ended"):
            env.step(0)
        env.reset()
        env.step(0)


class TestSeeds:
    @every_id
    def test_starts_differ_from_seed_to_seed_and_from_reset_to_reset(self, env_id: str) -> None:
        env = bare(env_id)
        starts = [env.reset(seed=seed)[0] for seed in range(5)]
        starts += [env.reset()[0] for _ in range(5)]
        assert len(np.unique(starts, axis=0)) == 10

    def test_all_randomness_is_np_random(self) -> None:
        env = bare(actions="quadrants", sensors=SENSORS[-1](), **EVERYTHING_VARIES)
        first = list(steps(env, seed=1))
        env.reset(seed=1)
        env.np_random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(1)))
        env.action_space.seed(1)
        env.reset()
        second = [env.step(env.action_space.sample()) for _ in first]
        assert_same(tuple(first), tuple(second))


class TestTwins:
    @pytest.mark.parametrize("twin_of", TWINS)
    @every_varying
    def test_go_on_alike(self, env_id: str, sensor: Any, twin_of: Callable[[Any], Any]) -> None:
        settings = {"actions": "quadrants", "sensors": sensor(), **EVERYTHING_VARIES}
        env = gym.make(env_id, max_episode_steps=8, **settings)
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(4):
            env.step(env.action_space.sample())
        twin = twin_of(env)
        for _ in range(40):
            first = env.step(env.action_space.sample())
            assert_same(first, twin.step(twin.action_space.sample()))
            if first[2] or first[3]:
                assert_same(env.reset(), twin.reset())

    @pytest.mark.parametrize("twin_of", TWINS)
    def test_go_their_own_ways(self, twin_of: Callable[[Any], Any]) -> None:
        env, reference = bare(), bare()
        for each in (env, reference):
            each.reset(seed=0, options={"parcel": TRIANGLE})
        twin, action = twin_of(env), same_choice(env, MINUS_45)
        for _ in range(5):
            twin.step(same_choice(twin, PLUS_45))
        for _ in range(5):
            assert_same(env.step(action), reference.step(action))


class TestMemory:
    @every_sensor
    def test_does_not_grow(self, sensor: Any) -> None:
        env = bare(
            actions="quadrants",
            sensors=sensor(),
            randomisation=Randomisation(size=0.05, friction=0.1),
            actuators=Actuators(axis_speed=8.0),
        )
        action = env.action_space.sample()

        def go(count: int) -> None:
            for _ in range(count):
                if env.step(action)[2]:
                    env.reset()

        env.reset(seed=0)
        tracemalloc.start()
        try:
            go(2_000)
            before = tracemalloc.get_traced_memory()[0]
            go(3_000)
            grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
        assert grown < 60_000  # [bytes] 20 a step: less than any object kept of each


class TestDrawing:
    @every_id
    def test_a_picture_of_what_happens(self, env_id: str) -> None:
        env = bare(env_id, render_mode="rgb_array")
        env.reset(seed=0)
        first = env.render()
        env.step(env.action_space.sample())
        second = env.render()
        assert first.dtype == second.dtype == np.uint8
        assert first.shape == second.shape == (*first.shape[:2], 3)
        assert (first != second).any()

    def test_it_changes_nothing(self) -> None:
        drawn, plain = bare(render_mode="rgb_array"), bare()
        for first, second in zip(steps(drawn, seed=2), steps(plain, seed=2), strict=True):
            drawn.render()
            assert_same(first, second)

    def test_without_a_mode_there_is_none(self) -> None:
        env = bare()
        env.reset(seed=0)
        assert env.render() is None

    def test_before_the_first_reset_it_is_refused(self) -> None:
        with pytest.raises(gym.error.ResetNeeded):
            bare(render_mode="rgb_array").render()

    def test_closing_twice_is_fine(self) -> None:
        env = bare()
        env.reset(seed=0)
        env.close()
        env.close()
