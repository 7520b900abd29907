"""A flow in PettingZoo: its contract, and the same run as the single environment's."""

import importlib
import math
import sys
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from surface_gym.flow.arrivals import Schedule, Steady
from surface_gym.flow.parallel_env import FlowParallelEnv
from surface_gym.flow.slope_tasks import lines, shuffled
from surface_gym.flow.state import NOBODY
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import bulk
from surface_gym.sensors import Presence
from tests.environments import TWINS, assert_same
from tests.flow.flows import BRAKE, DENSE, KINDS, MINUS_45, ROLL, SHORT, bare, trace
from tests.flow.test_module_parallel_env import modules_of
from tests.flow.test_take_away import TASKS

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of its own games, as it is imported
    from pettingzoo.test import parallel_api_test, parallel_seed_test

VARIED = dict(KINDS["parcels, camera, all varies"])
del VARIED["actions"]  # they are an agent's own
SPARSE = Stream(Steady(1800.0))  # one has left a short line before the next comes
LATE = Stream(Schedule(((0.0, 0.0), (1.0, 3600.0))))  # nobody is there as an episode begins
SETTINGS: tuple[dict[str, Any], ...] = (
    {},
    {"duration": 6.0, "patience": 0.3, "orientations": (0.0, 1.5)},
    {"duration": 10.0, "stream": SPARSE, "orientations": (math.pi / 2, math.pi / 2 - 1e-8)},
    {"orientations": "any", "sensors": Presence()},
    VARIED,
)
FAST = {"singulate": bulk(), "merge": lines(9000.0), "sequence": shuffled(3600.0)}
NORTH = Stream(destinations={"north": 1.0})  # where no exit is


def agents_of(**settings: Any) -> FlowParallelEnv:
    return FlowParallelEnv(**{"stream": DENSE, "duration": 2.0, "line": SHORT, **settings})


def all_say(env: FlowParallelEnv, choice: int) -> dict[str, np.ndarray]:
    return {agent: np.full(2, choice) for agent in env.agents}


def number_of(agent: str) -> int:
    return int(agent.removeprefix("parcel_"))


class TestContract:
    @pytest.mark.parametrize("settings", [*SETTINGS, {"stream": LATE}], ids=repr)
    def test_pettingzoos_checks_pass(self, settings: Any, capsys: Any) -> None:
        parallel_api_test(agents_of(**settings), num_cycles=1000)
        parallel_seed_test(lambda: agents_of(**settings))
        assert "Passed" in capsys.readouterr().out

    @pytest.mark.usefixtures("uncompiled")
    def test_spaces(self) -> None:
        env, single = agents_of(max_parcels=3), bare(actions="parcels", max_parcels=3)
        for agent in ("parcel_0", "parcel_77"):
            seen = env.observation_space(agent)
            assert seen is env.observation_space("parcel_0")
            np.testing.assert_array_equal(seen.low, single.observation_space.low[0])
            np.testing.assert_array_equal(seen.high, single.observation_space.high[0])
            assert env.action_space(agent) == gym.spaces.MultiDiscrete([4, 4])
            assert env.action_space(agent) is env.action_space("parcel_0")
        right = np.float32(math.pi / 2)
        any_angle = agents_of(orientations="any")
        assert any_angle.action_space("parcel_0") == gym.spaces.Box(-right, right, (2,))

    def test_it_says_what_is_missing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "pettingzoo", None)
        monkeypatch.delitem(sys.modules, "surface_gym.flow.parallel_env")
        with pytest.raises(ImportError, match=r"surface_gym\[multi\]"):
            importlib.import_module("surface_gym.flow.parallel_env")

    def test_bad_arguments_are_named(self) -> None:
        for name, value in (("max_parcels", 0), ("actions", "modules"), ("gate", True)):
            with pytest.raises(ValueError, match=name):
                agents_of(**{name: value})


class TestBesideTheSingleEnv:
    @pytest.mark.parametrize("settings", SETTINGS, ids=repr)
    def test_the_same_run_to_the_bit(self, settings: Any) -> None:
        env, single = agents_of(**settings), bare(actions="parcels", **settings)
        rng = np.random.default_rng(4)
        env.action_space("").seed(7)
        observations, infos = env.reset(seed=3)
        observation, info = single.reset(seed=3)
        place_of = {0: 0}
        over = False
        while not over:
            for agent in env.agents:
                place = place_of[number_of(agent)]
                np.testing.assert_array_equal(observations[agent], observation[place])
                assert infos[agent]["time"] == info["time"]
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            # What is said for places where nobody is does not matter.
            said = single.action_space.sample().reshape(-1, 2)
            for agent in rng.permutation(env.agents).tolist():
                said[place_of[number_of(agent)]] = actions[agent]
            observations, rewards, terminated, truncated, infos = env.step(actions)
            paid: dict[int, float] = {}
            there: set[int] = set(place_of)
            while True:
                observation, _, jammed, late, info = single.step(said.reshape(-1))
                streams, parcels = single.batch.streams, single.batch.parcels
                for place in np.nonzero(streams.number[0] != NOBODY)[0].tolist():
                    number = int(streams.number[0, place])
                    place_of[number] = place
                    paid[number] = float(parcels.reward[place])
                over = jammed or late
                if (info["parcels"] >= 0).any() or over:
                    break
            assert there <= set(paid)
            assert rewards == {f"parcel_{number}": value for number, value in paid.items()}
            now = set(info["parcels"].tolist()) - {-1}
            for number in paid:
                agent = f"parcel_{number}"
                assert terminated[agent] == (jammed or number not in now)
                assert truncated[agent] == (late and number in now)
            place_of = {number: place for number, place in place_of.items() if number in now}
            assert env.agents == ([] if over else [f"parcel_{number}" for number in sorted(now)])


class TestAgents:
    def test_come_and_go_with_their_parcels(self) -> None:
        stream = trace((0.0, "left 1"), (0.6, "straight"), (3.0, "right 2"), (9.0, "left 1"))
        env = agents_of(stream=stream, duration=4.0)
        observations, infos = env.reset(seed=0)
        assert set(observations) == set(infos) == {"parcel_0"} == set(env.agents)
        assert env.possible_agents == ["parcel_0", "parcel_1", "parcel_2"]
        assert infos["parcel_0"] == {"time": 0.0, "exit": "left 1"}
        ends: dict[str, dict[str, Any]] = {}
        came = {"parcel_0": 0.0}
        while env.agents:
            observations, rewards, terminated, truncated, infos = env.step(all_say(env, ROLL))
            reported = set(observations)
            assert reported == set(rewards) == set(terminated) == set(truncated) == set(infos)
            for agent in reported:
                assert agent not in ends
                came.setdefault(agent, infos[agent]["time"])
                assert ("outcome" in infos[agent]) == (terminated[agent] or truncated[agent])
                if terminated[agent]:
                    assert not observations[agent].any()
                if "outcome" in infos[agent]:
                    ends[agent] = infos[agent]
        assert came["parcel_1"] == pytest.approx(0.6, abs=0.041)
        # Nobody is on the line before the third comes: time runs on by itself.
        assert came["parcel_2"] == pytest.approx(3.0, abs=0.041)
        outcomes = [ends[f"parcel_{k}"]["outcome"] for k in range(3)]
        assert outcomes == ["wrong", "correct", "out of time"]
        assert ends["parcel_1"]["time"] < 2.2

    def test_the_first_may_come_late_or_not_at_all(self) -> None:
        env = agents_of(stream=trace((0.5, "left 1")))
        _, infos = env.reset(seed=0)
        assert env.agents == ["parcel_0"]
        assert infos["parcel_0"]["time"] == pytest.approx(0.52)
        assert env.reset(seed=0, options={"stream": trace((5.0, "left 1"))}) == ({}, {})
        assert env.agents == env.possible_agents == []

    def test_a_jam_terminates_all(self) -> None:
        env = agents_of(stream=Stream(Steady(9000.0)), duration=20.0, patience=0.5)
        env.reset(seed=0)
        waiting = len(env.possible_agents)
        while env.agents:
            agents = set(env.agents)
            _, _, terminated, truncated, infos = env.step(all_say(env, BRAKE))
        assert terminated == dict.fromkeys(agents, True)
        assert truncated == dict.fromkeys(agents, False)
        assert {info["outcome"] for info in infos.values()} == {"jam"}
        # Who had not entered cannot any more.
        assert set(env.possible_agents) >= agents
        assert len(env.possible_agents) < waiting

    def test_possible_ones_are_as_many_as_a_draw_has(self) -> None:
        assert len(agents_of(stream=Stream(Steady(3600.0))).possible_agents) == 2
        env = agents_of()
        assert set(env.possible_agents) >= {"parcel_0", "parcel_1"}
        env.reset(seed=5)
        assert len(env.possible_agents) == env.batch.streams.arrivals[0]
        env.reset(seed=0, options={"stream": trace((0.0, "right 1"), (0.4, "left 2"))})
        assert env.possible_agents == ["parcel_0", "parcel_1"]

    @pytest.mark.parametrize("twin_of", TWINS)
    def test_twins_go_on_alike(self, twin_of: Any) -> None:
        env = agents_of(**VARIED)
        env.reset(seed=0)
        for _ in range(10):
            env.step(all_say(env, MINUS_45))
        twin = twin_of(env)
        while env.agents:
            assert_same(env.step(all_say(env, ROLL)), twin.step(all_say(twin, ROLL)))
        assert not twin.agents


@pytest.mark.parametrize("task", TASKS)
class TestTakeAway:
    def test_pettingzoos_checks_pass(self, task: str, capsys: Any) -> None:
        env = FlowParallelEnv(task=task, duration=3.0)
        env.reset(seed=0)  # later resets go on from it
        parallel_api_test(env, num_cycles=100)
        parallel_seed_test(lambda: FlowParallelEnv(task=task, duration=2.0))
        assert "Passed" in capsys.readouterr().out

    def test_rewards_are_the_envs_own_and_outcomes_all_that_is_asked(self, task: str) -> None:
        env = FlowParallelEnv(task=task, duration=8.0, stream=FAST[task], exits="end")
        env.reset(seed=1)
        streams, outcomes = env.batch.streams, {}
        while env.agents:
            _, rewards, _, _, infos = env.step(all_say(env, ROLL))
            # The last two terms are the surface's: of parcels that wait, and of a jam.
            assert sum(rewards.values()) == pytest.approx(env.batch.terms[0, :-2].sum())
            outcomes.update(
                {agent: each["outcome"] for agent, each in infos.items() if "outcome" in each}
            )
        ended = {number_of(agent): outcome for agent, outcome in outcomes.items()}
        gone = {number for number, outcome in ended.items() if outcome in ("correct", "wrong")}
        assert gone == set(np.flatnonzero(~np.isnan(streams.departed[0])))
        assert all((ended[k] == "correct") == streams.correct[0, k] for k in gone)
        by_the_exit = {k for k in gone if streams.taken[0, k] == streams.exit[0, k]}
        assert {ended[k] for k in by_the_exit} == {"correct", "wrong"}


class TestBadInput:
    @pytest.mark.parametrize(
        ("named", "call"),
        [
            *(
                ("action", lambda env, actions=actions: env.step(actions))
                for actions in (
                    {}, None, [0, 0], {"parcel_0": (0, 0), "parcel_9": (0, 0)},
                    {"parcel_9": (0, 0)}, {"parcel_0": 3}, {"parcel_0": (0, 4)},
                    {"parcel_0": (0, 0, 0)}, {"parcel_0": (0.0, 0.0)}, {"parcel_0": None},
                )
            ),
            ("stream", lambda env: env.reset(options={"stream": 3})),
            ("options", lambda env: env.reset(options=3)),
            ("destinations", lambda env: env.reset(options={"stream": NORTH})),
        ],
    )  # fmt: skip
    def test_is_named_and_leaves_the_episode(self, named: str, call: Any) -> None:
        env, twin = agents_of(), agents_of()
        for each in (env, twin):
            each.reset(seed=0)
        with pytest.raises(ValueError, match=named):
            call(env)
        assert_same(env.step(all_say(env, ROLL)), twin.step(all_say(twin, ROLL)))

    @pytest.mark.parametrize("make", [agents_of, modules_of])
    def test_steps_out_of_turn_are_refused(self, make: Any) -> None:
        env = make(duration=0.08)
        for _ in range(2):
            with pytest.raises(gym.error.ResetNeeded):
                env.step({})
            env.reset(seed=0)
            while env.agents:
                env.step({agent: env.action_space(agent).sample() for agent in env.agents})


def test_it_draws_as_the_single_env_does_and_without_a_mode_not_at_all() -> None:
    env = agents_of(render_mode="rgb_array")
    single = bare(actions="parcels", render_mode="rgb_array")
    env.reset(seed=0)
    single.reset(seed=0)
    for _ in range(5):
        env.step(all_say(env, ROLL))
        single.step([ROLL] * 48)
    np.testing.assert_array_equal(env.render(), single.render())
    env.close()
    env = agents_of()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="without specifying any render mode"):
        assert env.render() is None
    env.close()
