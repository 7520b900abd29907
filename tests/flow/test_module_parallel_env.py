"""Modules of a slope as agents in PettingZoo, and what each of them sees."""

import math
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from surface_gym.config import EnvConfig
from surface_gym.flow import module_view as mv, take_away as ta
from surface_gym.flow.module_view import ModuleView
from surface_gym.flow.parallel_env import ModuleParallelEnv
from surface_gym.flow.state import NOBODY
from surface_gym.flow.take_away import slope_line
from surface_gym.tasks.features import columns
from tests import environments as te
from tests.environments import assert_same
from tests.flow.flows import BRAKE, ROLL
from tests.flow.test_take_away import TASKS

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of its own games, as it is imported
    from pettingzoo.test import parallel_api_test, parallel_seed_test

every_task = pytest.mark.parametrize("task", TASKS)


def modules_of(task: str = "singulate", **settings: Any) -> ModuleParallelEnv:
    return ModuleParallelEnv(**{"task": task, "duration": 1.0, "line": slope_line(1.0), **settings})


def all_say(env: ModuleParallelEnv, choice: int) -> dict[str, int]:
    return dict.fromkeys(env.agents, choice)


@every_task
class TestTasks:
    def test_pettingzoos_checks_pass(self, task: str, capsys: Any) -> None:
        parallel_api_test(modules_of(task), num_cycles=30)
        parallel_seed_test(lambda: modules_of(task, duration=0.4))
        assert "Passed" in capsys.readouterr().out

    @pytest.mark.parametrize("reward", ["parcel", "team"])
    def test_the_same_run_as_the_single_env_and_its_rewards(self, task: str, reward: str) -> None:
        env = modules_of(task, reward=reward, duration=3.0)
        name = f"SmartSurface/{task.title()}-v0"
        single = gym.make(name, disable_env_checker=True, line=slope_line(1.0), duration=3.0)
        single = single.unwrapped
        _, infos = env.reset(seed=2)
        single.reset(seed=2)
        earned = 0.0
        while env.agents:
            borne = {agent: info["parcel"] for agent, info in infos.items()}
            env.action_space("").seed(7)
            actions = {agent: env.action_space("").sample() for agent in env.agents}
            _, rewards, terminated, truncated, infos = env.step(actions)
            said = single.action_space.sample().reshape(14, -1)  # supports obey nothing
            said[:, :10] = np.reshape(list(actions.values()), (14, 10))
            _, paid, jammed, late, _ = single.step(said.reshape(-1))
            assert set(terminated.values()) == {jammed}
            assert set(truncated.values()) == {late}
            streams, parcels = single.batch.streams, single.batch.parcels
            if reward == "team":
                assert set(rewards.values()) == {paid}
                continue
            by_number = dict(zip(streams.number[0].tolist(), parcels.reward.tolist(), strict=True))
            for agent, number in borne.items():
                assert rewards[agent] == (0.0 if number == NOBODY else by_number[number])
                earned += abs(rewards[agent])
        assert reward == "team" or earned > 0.0
        assert late
        assert set(map(str, infos["module_0_0"])) == {"parcel", "outcome"}


class TestEnv:
    def test_spaces(self) -> None:
        env = modules_of()
        assert len(env.possible_agents) == 140
        assert env.possible_agents[11] == "module_1_1"
        assert env.action_space("module_0_0") == gym.spaces.Discrete(4)
        assert env.observation_space("module_0_0").shape == (mv.SIZE,)

    @pytest.mark.usefixtures("uncompiled")
    def test_an_angle_reaches_its_module(self) -> None:
        right = np.float32(math.pi / 2)
        angles = modules_of(orientations="any")
        assert angles.action_space("module_0_0") == gym.spaces.Box(-right, right, (1,))
        angles.reset(seed=0)
        said = {agent: np.array([0.1], np.float32) for agent in angles.agents}
        angles.step({**said, "module_2_3": np.array([-0.2], np.float32)})
        command = angles.batch.surfaces.command[0].reshape(14, -1)[:, :10]
        assert np.argwhere(np.isclose(command, -0.2)).tolist() == [[2, 3]]
        assert np.isclose(command, 0.1).sum() == 139

    def test_a_jam_terminates_all(self) -> None:
        env = modules_of(duration=20.0, patience=0.5)
        env.reset(seed=0)
        while env.agents:
            _, _, terminated, truncated, infos = env.step(all_say(env, BRAKE))
        assert set(terminated.values()) == {True}
        assert set(truncated.values()) == {False}
        assert {info["outcome"] for info in infos.values()} == {"jam"}

    def test_an_action_is_that_of_its_module(self) -> None:
        env = modules_of()
        env.reset(seed=0)
        env.step({**all_say(env, ROLL), "module_2_3": BRAKE})
        turned = np.argwhere(env.batch.streams.commanded[0] < 1.0)
        assert turned.tolist() == [[2, 3]]

    @pytest.mark.parametrize(
        ("named", "arguments"),
        [("actions", {"actions": "parcels"}), ("reward", {"reward": "none"}),
         ("task", {"task": "flow", "line": None}), ("gate", {"gate": True})],
    )  # fmt: skip
    def test_bad_arguments_are_named(self, named: str, arguments: dict[str, Any]) -> None:
        with pytest.raises(ValueError, match=named):
            modules_of(**arguments)

    @pytest.mark.parametrize("actions", [None, {}, {"module_0_0": 3}, "more", "high", "two"])
    def test_bad_actions_are_named_and_leave_the_episode(self, actions: Any) -> None:
        env, twin = modules_of(), modules_of()
        for each in (env, twin):
            each.reset(seed=0)
        bad = {
            "more": {**all_say(env, ROLL), "module_99_0": ROLL},
            "high": all_say(env, 4),
            "two": dict.fromkeys(env.agents, (ROLL, ROLL)),
        }
        with pytest.raises(ValueError, match="action"):
            env.step(bad.get(actions, actions) if isinstance(actions, str) else actions)
        assert_same(env.step(all_say(env, ROLL)), twin.step(all_say(twin, ROLL)))


def table_of(config: EnvConfig, *parcels: dict[str, float]) -> np.ndarray:
    """A table with parcels 0.4 m x 0.2 m in its first rows, of some features."""
    table = np.zeros((1, config.rows, len(config.features)), dtype=np.float32)
    for k, parcel in enumerate(parcels):
        shown = {
            "present": 1.0, "cosine_of_theta": 1.0, "takes_away": 1.0, "left": -1.0, "right": -1.0,
            "length": 0.5, "width": -1.5, **parcel,
        }  # fmt: skip
        for name, value in shown.items():
            table[0, k, getattr(columns(config.features), name).place] = value
    return table


def neighbour(passed: np.ndarray, way: int) -> list[float]:
    first = len(mv.PARCEL) + way * len(mv.NEIGHBOUR)
    return passed[first : first + len(mv.NEIGHBOUR)].tolist()


class TestView:
    def test_modules_know_the_parcel_that_the_kernel_lets_claim_them(self) -> None:
        config = EnvConfig("singulate", actions="parcels", stream=ta.bulk(14_000.0))
        batch, view = te.begun(config, 2), ModuleView(config)
        first_row, rows, first, columns = config.site.zone
        alike, borne = 0, 0
        for _ in range(100):
            owner = view(batch.observation).owner
            batch.step(np.full((2, 64), ROLL))
            obeyed = batch.streams.owner[:, first_row : first_row + rows, first : first + columns]
            alike += int(((obeyed.reshape(2, -1) == owner) & (owner >= 0)).sum())
            borne += int((owner >= 0).sum())
        assert alike > 0.99 * borne > 3000

    def test_a_table_may_have_any_number_of_rows_but_not_of_features(self) -> None:
        config = EnvConfig("singulate", max_parcels=4)
        view, table = ModuleView(config), table_of(EnvConfig("singulate"), {"to_the_end": 2.0})
        wide, narrow = view(np.concatenate([table] * 9, axis=1)), view(table[:, :1])
        np.testing.assert_array_equal(wide.owner >= 0, narrow.owner >= 0)
        assert wide.passed.shape == (1, 9 * 32, mv.PASSED)
        for bad in (table[0], table[..., :-1]):
            with pytest.raises(ValueError, match="tables must have the shape"):
                view(bad)

    def test_of_itself(self) -> None:
        config = EnvConfig("singulate")
        seen = ModuleView(config)(table_of(config, {"to_the_end": 2.0, "offset": 0.4}))
        own, owner = seen.own[0].reshape(14, 56, -1), seen.owner[0].reshape(14, 56)
        # Its base is from 1.8 to 2.2 m before the end, and from 0.1 to 0.3 m beside the middle;
        # at 1 m/s modules up to 0.1 m ahead are about to bear it.
        assert np.unique(np.nonzero(owner == 0)[0]).tolist() == [8, 9]
        assert np.unique(np.nonzero(owner == 0)[1]).tolist() == [28, 29, 30, 31, 32]
        np.testing.assert_allclose(own[8, 28], [2.15, 0.3, 1.0, -0.75, -0.25, 0.0], atol=1e-5)
        np.testing.assert_allclose(own[9, 32], [1.75, 0.5, 0.0, 1.25, 0.25, 0.5], atol=1e-5)
        np.testing.assert_allclose(own[0, 0], [4.95, -1.3, 0.0, 0.0, 0.0, 0.0], atol=1e-5)
        modules = seen.of_modules()[0].reshape(14, 56, -1)
        assert not modules[0, 0, len(mv.OWN) :].any()
        np.testing.assert_array_equal(modules[8, 28, len(mv.OWN) :], seen.passed[0, 0])

    def test_of_the_parcels_around(self) -> None:
        config = EnvConfig("singulate")
        one = {"to_the_end": 2.0, "offset": 0.0}
        ahead = {"to_the_end": 1.4, "offset": 0.2, "forward_speed": 0.5}
        left_behind = {"to_the_end": 2.5, "offset": 0.8, "lateral_speed": -0.5}
        far = {"to_the_end": 3.5, "offset": 0.0}
        seen = ModuleView(config)(table_of(config, one, ahead, left_behind, far)).passed[0]
        nobody = [2.0, 2.0, 0.0, 0.0, 0.0]
        expected = [nobody] * mv.DIRECTIONS
        expected[6] = [0.4, -0.2, 1.0, 0.0, 1.0]
        expected[2] = [0.2, 0.4, 0.0, -0.5, -1.0]
        for way, each in enumerate(expected):
            np.testing.assert_allclose(neighbour(seen[0], way), each, atol=1e-5)
        assert neighbour(seen[1], 1)[4] == -1.0  # what is ahead for one is behind for the other
        assert neighbour(seen[3], 6) == nobody

    def test_how_early_one_is_comes_from_all_before_it(self) -> None:
        config = EnvConfig("singulate")
        three = [
            {"to_the_end": 1.0 + k, "rolling": 0.1 + 0.025 * k, "clear": 1.0} for k in range(3)
        ]
        early = ModuleView(config)(table_of(config, *three)).passed[0, :3, mv.EARLY]
        # Each takes 0.4 m and the gap of the take-away, 0.35 s; the first comes after 0.4 s.
        np.testing.assert_allclose(early, [-0.15 - 0.4, 0.25, 0.5], atol=1e-5)

    def test_in_a_sequence_the_order_counts(self) -> None:
        config = EnvConfig("sequence")
        first, second = {"to_the_end": 1.0, "place": 0.125}, {"to_the_end": 1.6, "place": 0.0}
        table = table_of(config, first, second)
        seen = ModuleView(config)(table).passed[0]
        assert neighbour(seen[0], 1)[4] == 1.0
        assert seen[0, mv.EARLY] == pytest.approx(0.35 + 0.1)
        assert seen[0, len(mv.PARCEL) - 1] == pytest.approx(0.125)
