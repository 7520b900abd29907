"""The single environment of a flow: Gymnasium's contract, seeds, twins and memory."""

import copy
import math
import tracemalloc
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_by_gymnasium
from stable_baselines3.common.env_checker import check_env as check_by_stable_baselines3

import surface_gym as sg
from surface_gym.flow.arrivals import Schedule
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import FEATURES
from surface_gym.randomisation import Randomisation
from tests.environments import TWINS
from tests.flow.flows import (
    BRAKE,
    DENSE,
    KINDS,
    MINUS_45,
    PLUS_45,
    ROLL,
    SHORT,
    assert_alike,
    bare,
    every_kind,
    play,
    same_choice,
    steps,
    trace,
)


class TestCheckers:
    @pytest.mark.parametrize("name", [name for name in KINDS if "any angle" not in name])
    def test_gymnasiums_has_nothing_to_say(self, name: str) -> None:
        check_by_gymnasium(bare(**KINDS[name]), skip_render_check=True)

    def test_but_that_angles_are_no_numbers_between_0_and_1(self) -> None:
        with pytest.warns(UserWarning, match="normalized space"):
            check_by_gymnasium(
                bare(**KINDS["modules, presence, any angle"]), skip_render_check=True
            )

    @pytest.mark.parametrize("actions", ["modules", "parcels"])
    def test_stable_baselines3s_has_nothing_to_say(self, actions: str) -> None:
        """But that it would have a table flattened, as its policies do themselves."""
        with pytest.warns(UserWarning, match="unconventional shape"):
            check_by_stable_baselines3(bare(actions=actions))
        check_by_stable_baselines3(gym.wrappers.FlattenObservation(bare(actions=actions)))


class TestEpisodes:
    @every_kind
    def test_types_spaces_and_sums(self, kind: dict[str, Any]) -> None:
        env = bare(**kind)
        assert env.observation_space.dtype == np.float32
        assert env.observation_space.shape == (24, len(FEATURES))
        for observation, reward, terminated, truncated, info in steps(env, seed=3):
            assert observation in env.observation_space
            assert observation.dtype == np.float32
            assert type(reward) is float
            assert type(terminated) is type(truncated) is bool
            assert all(type(term) is float for term in info["reward_terms"].values())
            assert reward == pytest.approx(math.fsum(info["reward_terms"].values()), abs=1e-12)
            assert terminated == (info["outcome"] == "jam")
            assert truncated == (info["outcome"] == "out of time")
            assert ("episode_figures" in info) == (terminated or truncated)

    def test_action_spaces(self) -> None:
        modules, parcels = bare(actions="modules"), bare(actions="parcels", max_parcels=3)
        # 4 rows of rotors, and all columns after the lead-in; the run-out's obey nobody.
        assert modules.action_space == gym.spaces.MultiDiscrete([4] * 4 * (SHORT.columns - 5))
        assert parcels.action_space == gym.spaces.MultiDiscrete([4] * 6)
        angles = bare(actions="parcels", max_parcels=3, orientations="any").action_space
        assert angles == gym.spaces.Box(-np.float32(math.pi / 2), np.float32(math.pi / 2), (6,))
        coarse = bare(actions="parcels", max_parcels=3, orientations=(0.0, 1.0)).action_space
        assert coarse == gym.spaces.MultiDiscrete([2] * 6)

    @pytest.mark.parametrize(
        ("duration", "period", "periods"),
        [(1.0, 0.04, 25), (0.04, 0.04, 1), (0.9, 0.03, 30), (0.5, 0.013, 39)],
    )
    def test_lasts_its_duration(self, duration: float, period: float, periods: int) -> None:
        env = bare(actions="parcels", duration=duration, control_period=period)
        assert env.config.periods == periods
        played = play(env, ROLL)
        assert len(played) == periods
        assert [step[3] for step in played] == [False] * (periods - 1) + [True]
        assert not any(step[2] for step in played)
        for number, step in enumerate(played, start=1):
            assert step[4]["time"] == pytest.approx(period * number, abs=1e-9)

    def test_what_it_returns_is_the_users_own(self) -> None:
        env, twin = bare(actions="parcels"), bare(actions="parcels")
        for each in (env, twin):
            each.action_space.seed(0)
            observation, info = each.reset(seed=0)
        for _ in range(20):
            observation[:] = np.nan
            info["parcels"][:] = 77
            info["reward_terms"].clear()
            observation, reward, *_, info = env.step(env.action_space.sample())
            wanted = twin.step(twin.action_space.sample())
            assert_alike(observation, wanted[0])
            assert_alike((reward, info), (wanted[1], wanted[4]))

    def test_a_gate_adds_a_row_and_a_number(self) -> None:
        env = bare(actions="parcels", gate=True, max_parcels=3)
        assert env.observation_space.shape == (4, len(FEATURES))
        assert env.action_space == gym.spaces.MultiDiscrete([4] * 6 + [9])
        for observation, *_, info in steps(env, seed=0):
            assert observation in env.observation_space
            assert info["parcels"].shape == (3,)
        assert info["entered"] > 0

    @pytest.mark.parametrize("varies", [False, True])
    def test_nobody_may_come_at_all(self, varies: bool) -> None:
        randomisation = Randomisation(size=0.05, lateral=0.01) if varies else Randomisation()
        env = bare(
            stream=trace((9.0, "left 1")), actions="parcels", duration=0.4,
            randomisation=randomisation,
        )  # fmt: skip
        played = play(env, ROLL)
        assert len(played) == 10
        assert not any(step[0].any() or step[1] for step in played)

    def test_nobody_may_come_yet(self) -> None:
        """Before a schedule lets any in, all is 0 and nothing jams."""
        stream = Stream(Schedule(((0.0, 0.0), (0.5, 3600.0))))
        env = bare(stream=stream, actions="parcels", patience=0.1, duration=0.8)
        observation, info = env.reset(seed=0)
        assert not observation.any()
        assert info["entered"] == 0
        played = play(env, ROLL)
        assert [step[4]["entered"] for step in played] == [0] * 12 + [1] * 8
        assert all(step[1] == 0.0 for step in played[:12])

    def test_steps_out_of_turn_are_refused(self) -> None:
        env = bare(actions="parcels", duration=0.04)
        action = same_choice(env, ROLL)
        with pytest.raises(gym.error.ResetNeeded, match="reset"):
            env.step(action)
        env.reset(seed=0)
        env.step(action)
        with pytest.raises(gym.error.ResetNeeded, match="ended"):
            env.step(action)
        env.reset()
        env.step(action)

    @pytest.mark.parametrize(
        "action", [3, [3] * 47, [3] * 47 + [4], [3.0] * 48, None, [[3] * 48]], ids=repr
    )
    def test_bad_actions_are_named_and_move_nobody(self, action: Any) -> None:
        env, twin = bare(actions="parcels"), bare(actions="parcels")
        for each in (env, twin):
            each.reset(seed=0)
        with pytest.raises(ValueError, match="action"):
            env.step(action)
        good = same_choice(env, ROLL)
        assert_alike(env.step(good), twin.step(good))

    @pytest.mark.parametrize(
        ("options", "named"),
        [
            ({"speed": 1.0}, "options"),
            (3, "options"),
            ({"stream": "dense"}, "stream"),
            ({"stream": None}, "stream"),
            ({"stream": Stream(destinations={"north": 1.0})}, "destinations"),
            ({"stream": trace((0.0, "north"))}, "exit"),
            ({"stream": Stream(parcels=(sg.Parcel(sg.Rectangle(0.05, 0.3)),))}, "parcels"),
        ],
    )
    def test_bad_options_are_named_and_leave_the_episode(self, options: Any, named: str) -> None:
        settings = {"actions": "parcels", "randomisation": Randomisation(size=0.05)}
        env, twin = bare(**settings), bare(**settings)
        for each in (env, twin):
            each.reset(seed=0)
            each.step(same_choice(env, BRAKE))
        with pytest.raises(ValueError, match=named):
            env.reset(seed=1, options=options)
        assert_alike(env.step(same_choice(env, ROLL)), twin.step(same_choice(env, ROLL)))
        assert_alike(env.reset(), twin.reset())

    def test_a_reset_may_bring_a_stream_of_its_own(self) -> None:
        env = bare(actions="parcels", duration=1.0)
        env.reset(seed=0, options={"stream": trace((0.0, "left 1"), (0.5, "right 2"))})
        streams = env.batch.streams
        names = env.config.exits.names
        assert [names[place] for place in streams.exit[0, :2]] == ["left 1", "right 2"]
        assert streams.arrivals.tolist() == [2]
        env.reset(seed=0)
        assert_alike(env.reset(seed=0), bare(actions="parcels", duration=1.0).reset(seed=0))


class TestSeeds:
    @every_kind
    def test_a_seed_fixes_everything(self, kind: dict[str, Any]) -> None:
        one, other = bare(**kind), bare(**kind)
        for first, second in zip(steps(one, 5), steps(other, 5), strict=True):
            assert_alike(first, second)
        assert_alike(one.reset(), other.reset())

    def test_starts_differ_from_seed_to_seed_and_from_reset_to_reset(self) -> None:
        env = bare(actions="parcels")
        coming = []
        for seed in (0, 1, 2, None, None, None):
            env.reset(seed=seed)
            coming.append(env.batch.streams.time[0, 1:6].copy())
        assert len(np.unique(coming, axis=0)) == 6


class TestTwins:
    @pytest.mark.parametrize("twin_of", TWINS)
    @every_kind
    def test_go_on_alike(self, kind: dict[str, Any], twin_of: Callable[[Any], Any]) -> None:
        env = bare(duration=1.0, **kind)
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(12):
            env.step(env.action_space.sample())
        twin = twin_of(env)
        for _ in range(60):
            first = env.step(env.action_space.sample())
            second = twin.step(twin.action_space.sample())
            assert_alike(first, second)
            if first[2] or first[3]:
                assert_alike(env.reset(), twin.reset())

    def test_go_their_own_ways(self) -> None:
        env, reference = bare(actions="parcels"), bare(actions="parcels")
        for each in (env, reference):
            each.reset(seed=0)
        twin = copy.deepcopy(env)
        twin.reset(options={"stream": trace((0.0, "left 1"), parcel=sg.Parcel(sg.Disc(0.2)))})
        for _ in range(20):
            twin.step(same_choice(twin, PLUS_45))
        for _ in range(20):
            action = same_choice(env, MINUS_45)
            assert_alike(env.step(action), reference.step(action))


class TestMemory:
    @pytest.mark.parametrize("varies", [False, True])
    def test_does_not_grow(self, varies: bool) -> None:
        randomisation = Randomisation(size=0.05, friction=0.1) if varies else Randomisation()
        env = bare(actions="parcels", duration=0.4, randomisation=randomisation)
        action = same_choice(env, ROLL)

        def go(episodes: int) -> None:
            for _ in range(episodes):
                env.reset()
                while not env.step(action)[3]:
                    pass

        env.reset(seed=0)
        tracemalloc.start()
        try:
            go(60)
            before, rooms = tracemalloc.get_traced_memory()[0], len(env.batch.bodies.body)
            go(120)
            grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
        assert grown < 60_000  # [bytes] 500 an episode: less than a parcel
        assert len(env.batch.bodies.body) == rooms
        assert len(env.batch._pool._users) <= len(DENSE.kinds) + int(env.batch.streams.arrivals[0])
