"""The native vector environment: seeds, partial resets and bad input."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import VectorEnv

import surface_gym as sg
from tests import environments as te


class TestSeeds:
    def test_a_number_is_for_the_first_environment(self):
        one, listed = te.native(), te.native()
        te.assert_same(one.reset(seed=7), listed.reset(seed=[7, 8, 9]))
        te.assert_same(one.reset(seed=np.int64(7)), listed.reset(seed=(7, 8, 9)))

    def test_none_goes_on_drawing(self):
        env, twin = te.native(), te.native()
        env.reset(seed=7)
        twin.reset(seed=7)
        te.assert_same(env.reset(), twin.reset(seed=[None, None, None]))
        mixed, twins = env.reset(seed=[1, None, 1])[0], twin.reset()[0]
        np.testing.assert_array_equal(mixed[1], twins[1])
        np.testing.assert_array_equal(mixed[0], mixed[2])

    def test_unseeded_envs_differ(self):
        starts = [te.native().reset()[0] for _ in range(2)]
        assert len(np.unique(np.concatenate(starts), axis=0)) == 2 * te.NUM_ENVS

    @pytest.mark.parametrize(
        "seed", [[1, 2], [1, 2, 3, 4], [], 1.5, "seed", [1, 2, -3], -1, True, [0.5] * 3], ids=repr
    )
    def test_bad_ones_are_refused(self, seed):
        env = te.native()
        with pytest.raises((ValueError, gym.error.Error), match=r"[Ss]eed"):
            env.reset(seed=seed)
        te.assert_same(env.reset(seed=0), te.native().reset(seed=0))


class TestPartialResets:
    def disabled(self) -> VectorEnv:
        env = te.native(actions="halves", autoreset_mode="Disabled", sensors=te.SENSORS[-1]())
        env.reset(seed=0)
        return env

    def test_draw_nothing_for_others_and_leave_the_callers_options_alone(self):
        env, twin = self.disabled(), self.disabled()
        action = np.array([6, 7, 8])
        for _ in range(4):
            te.assert_same(env.step(action)[0][1:], twin.step(action)[0][1:])
            env.reset(options={"reset_mask": np.array([True, False, False])})
        mask = np.array([False, True, True])
        options = {"reset_mask": mask, "speed": 1.0}
        te.assert_same(env.reset(options=options)[0][1:], twin.reset(options=options)[0][1:])
        assert set(options) == {"reset_mask", "speed"}
        te.assert_same(env.step(action)[0][1:], twin.step(action)[0][1:])

    def test_leave_the_others_where_they_are(self):
        env = self.disabled()
        before = env.step(np.array([6, 7, 8]))[0]
        mask = np.array([False, True, False])
        after, infos = env.reset(options={"reset_mask": mask, "speed": 1.25})
        np.testing.assert_array_equal(after[~mask], before[~mask])
        np.testing.assert_array_equal(infos["_pose"], mask)
        np.testing.assert_array_equal(infos["velocity"][mask], [[1.25, 0.0, 0.0]])

    def test_seed_the_environments_they_reset(self):
        env = self.disabled()
        mask = np.array([False, True, True])
        observations, _ = env.reset(seed=40, options={"reset_mask": mask})
        fresh = self.disabled().reset(seed=40)[0]
        np.testing.assert_array_equal(observations[mask], fresh[mask])

    BAD_MASKS = (
        [True, False, False], np.zeros(3, dtype=bool), np.ones(2, dtype=bool),
        np.ones((3, 1), dtype=bool), np.ones(3, dtype=int), True, None,
    )  # fmt: skip

    def test_bad_masks_are_named(self):
        env, twin = self.disabled(), self.disabled()
        for mask in self.BAD_MASKS:
            with pytest.raises(ValueError, match="reset_mask"):
                env.reset(options={"reset_mask": mask})
            te.assert_same(env.step(np.array([1, 2, 3])), twin.step(np.array([1, 2, 3])))

    def test_the_first_reset_is_whole_and_comes_before_a_step(self):
        env = te.native(autoreset_mode="Disabled")
        with pytest.raises(gym.error.ResetNeeded, match="reset"):
            env.step(env.action_space.sample())
        with pytest.raises(gym.error.ResetNeeded):
            env.reset(options={"reset_mask": np.array([True, False, False])})

    def test_ended_environments_wait_for_theirs(self):
        env = te.native(actions="halves", autoreset_mode="Disabled", max_episode_steps=1)
        env.reset(seed=0)
        env.step(np.array([0, 0, 0]))
        with pytest.raises(gym.error.ResetNeeded, match=r"\[0, 1, 2\]"):
            env.step(np.array([0, 0, 0]))
        env.reset(options={"reset_mask": np.array([True, True, False])})
        with pytest.raises(gym.error.ResetNeeded, match=r"\[2\]"):
            env.step(np.array([0, 0, 0]))


class TestBadInput:
    BAD_ACTIONS: tuple[Any, ...] = (
        3, [3, 3], [3, 3, 3, 3], [[3], [3], [3]], [3, 3, 16], [3, 3, -1], [3.0, 3.0, 3.0],
        [3, 3, math.nan], [True, True, False], None, "roll", [[3], [3, 3], 3], [None] * 3,
    )  # fmt: skip

    @pytest.mark.parametrize("actions", BAD_ACTIONS, ids=repr)
    def test_bad_actions_are_named(self, actions):
        env, twin = te.pair(te.native, actions="halves", max_episode_steps=2)
        for _ in range(4):
            with pytest.raises(ValueError, match="action"):
                env.step(actions)
            te.assert_same(env.step(np.array([1, 2, 3])), twin.step(np.array([1, 2, 3])))

    @te.every_kind_of_action
    def test_one_bad_environment_moves_none(self, actions):
        env, twin = te.pair(te.native, **te.cell(te.SORT, actions))
        good = env.action_space.sample()
        bad = good.copy()
        bad[-1] = 99
        with pytest.raises(ValueError, match="action"):
            env.step(bad)
        te.assert_same(env.step(good), twin.step(good))

    TOO_LONG = sg.Parcel(sg.Rectangle(2.0, 0.3))

    @pytest.mark.parametrize(
        ("named", "bad"),
        [
            ("options", [{"velocity": 1.0}, "speed", 3, [{}, {}], [{}, {}, {}, {}]]),
            ("options", [[{}, {}, {"velocity": 1.0}], [{}, {}, 3]]),
            ("speed", [{"speed": -1.0}, [{}, {}, {"speed": "fast"}]]),
            ("parcel", [[{}, {}, {"parcel": parcel}] for parcel in ("M", TOO_LONG)]),
            ("side", [[{}, {}, {"side": 2}]]),
        ],
    )
    def test_bad_options_are_named(self, named, bad):
        env, twin = te.pair(te.native, actions="halves")
        for options in bad:
            with pytest.raises(ValueError, match=named):
                env.reset(seed=1, options=options)
            te.assert_same(env.step(np.array([1, 2, 3])), twin.step(np.array([1, 2, 3])))
        te.assert_same(env.reset(seed=2), twin.reset(seed=2))

    @pytest.mark.parametrize(
        ("name", "values"),
        [
            ("num_envs", (0, -2, 2.0, True)), ("threads", (0, -1, 1.5, True, "all")),
            ("max_episode_steps", (0, 2.5)), ("autoreset_mode", ("sometimes", 3, None)),
            ("render_mode", ("human",)),
        ],
    )  # fmt: skip
    def test_bad_arguments_are_named(self, name, values):
        for value in values:
            with pytest.raises(ValueError, match=name):
                sg.SmartSurfaceVectorEnv(**{name: value})
