"""The native vector environment, beside single ones; seeds, resets, bad input."""

import math
from collections.abc import Iterator
from functools import partial
from itertools import cycle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, VectorEnv

import surface_gym as sg
from tests import environments as te


def assert_infos_same(found: dict[str, Any], wanted: dict[str, Any], late: np.ndarray) -> None:
    """Infos of the native env agree with those Gymnasium gathered from single ones.

    Values count where the mask says so. A single env knows of no time limit, so the outcome of
    the environments that ran out of time is its one difference.
    """
    assert set(found) == set(wanted)
    for name, value in wanted.items():
        if name.startswith("_"):
            assert found[name].dtype == np.bool_
            np.testing.assert_array_equal(found[name], value, name)
            continue
        mask = wanted[f"_{name}"]
        if name == "final_obs":
            for i in range(len(mask)):
                te.assert_same(found[name][i], value[i])
        elif isinstance(value, dict):
            assert_infos_same(found[name], value, late)
        else:
            assert found[name].dtype == value.dtype, name
            if name == "outcome":
                assert (found[name][mask & late] == "out of time").all()
                mask = mask & ~late
            np.testing.assert_array_equal(found[name][mask], value[mask], name)


def run_beside(one: VectorEnv, other: VectorEnv, mode: AutoresetMode, periods: int) -> int:
    """Step both alike, comparing all they return; how many episodes ended."""
    for space in ("single_observation", "single_action", "observation", "action"):
        assert getattr(one, f"{space}_space") == getattr(other, f"{space}_space")
    one.action_space.seed(0)
    observations, infos = one.reset(seed=11)
    same_observations, same_infos = other.reset(seed=11)
    te.assert_same(observations, same_observations)
    nobody = np.zeros(one.num_envs, dtype=np.bool_)
    assert_infos_same(infos, same_infos, nobody)
    ended = 0
    for _ in range(periods):
        actions = one.action_space.sample()
        *results, infos = one.step(actions)
        *same_results, same_infos = other.step(actions)
        te.assert_same(tuple(results), tuple(same_results))
        _, _, terminated, truncated = results
        over = terminated | truncated
        late = truncated & ~terminated
        if mode == AutoresetMode.SAME_STEP:  # the environments' infos are those of their next start
            assert_infos_same(infos.pop("final_info", {}), same_infos.pop("final_info", {}), late)
            late = nobody
        assert_infos_same(infos, same_infos, late)
        ended += int(over.sum())
        if mode == AutoresetMode.DISABLED and over.any():
            observations, infos = one.reset(options={"reset_mask": over})
            same_observations, same_infos = other.reset(options={"reset_mask": over.copy()})
            te.assert_same(observations, same_observations)
            assert_infos_same(infos, same_infos, nobody)
    return ended


class TestBesideSingles:
    @te.every_mode
    @te.every_cell
    def test_each_environment_is_a_single_env(self, env_id, actions, sensor, mode):
        settings = {"actions": actions, "sensors": sensor()}
        one = te.native(env_id, max_episode_steps=te.LIMIT, autoreset_mode=mode, **settings)
        other = te.singles(env_id, mode, **settings)
        assert run_beside(one, other, mode, 40) >= 2 * te.NUM_ENVS

    @te.every_mode
    @te.every_id
    def test_also_where_everything_varies(self, env_id, mode):
        settings = {"actions": "quadrants", "sensors": te.SENSORS[-1](), **te.EVERYTHING_VARIES}
        one = te.native(env_id, max_episode_steps=te.LIMIT, autoreset_mode=mode, **settings)
        assert run_beside(one, te.singles(env_id, mode, **settings), mode, 40) >= 2 * te.NUM_ENVS

    @te.every_mode
    def test_also_over_whole_episodes(self, mode):
        one = te.native(actions="halves", autoreset_mode=mode)
        assert (
            run_beside(one, te.singles(te.SORT, mode, 100, actions="halves"), mode, 300)
            >= te.NUM_ENVS
        )

    def test_also_in_the_lab_where_parcel_and_rotors_are_seen(self):
        settings = {"preset": "lab", "observe": ("parcel", "rotors"), "actions": "halves"}
        mode = AutoresetMode.NEXT_STEP
        one = te.native(max_episode_steps=te.LIMIT, autoreset_mode=mode, **settings)
        assert run_beside(one, te.singles(te.SORT, mode, **settings), mode, 20) >= te.NUM_ENVS

    @te.every_mode
    def test_ending_at_the_limit_is_both(self, mode):
        """As with Gymnasium's TimeLimit: an end in the last period is truncated too."""
        single, start = te.bare(actions="halves"), {"speed": 2.0, "side": 1, "parcel": "S"}
        action = te.same_choice(single, te.MINUS_45)
        length = len(te.played_out(single, action, **start))
        results = []
        for env in (
            te.native(num_envs=1, actions="halves", max_episode_steps=length, autoreset_mode=mode),
            te.singles(te.SORT, mode, length, num_envs=1, actions="halves"),
        ):
            env.reset(seed=11, options=start)
            for _ in range(length):
                step = env.step(np.array([action]))
            results.append(step)
        te.assert_same(results[0][:4], results[1][:4])
        if mode != AutoresetMode.SAME_STEP:
            assert [flags.tolist() for flags in results[0][2:4]] == [[True], [True]]

    def test_singles_in_processes_of_their_own(self):
        settings = {"actions": "halves", "sensors": te.SENSORS[-1]()}
        make = partial(te.single_of, te.SORT, te.LIMIT, settings)
        apart = AsyncVectorEnv([make] * 2, context="spawn")
        together = te.native(num_envs=2, max_episode_steps=te.LIMIT, **settings)
        try:
            assert run_beside(together, apart, AutoresetMode.NEXT_STEP, 20) >= 2
        finally:
            apart.close()


def rollout(env: VectorEnv, chosen: slice, periods: int = 60) -> Iterator[tuple[Any, ...]]:
    """What some of the environments give, each acting as it would in a smaller batch."""
    observations, _ = env.reset(seed=3)
    yield (observations[chosen],)
    rng = np.random.default_rng(0)
    for _ in range(periods):
        actions = rng.integers(0, 4, (64, *env.single_action_space.shape))[: env.num_envs]
        observations, rewards, terminated, truncated, infos = env.step(actions)
        given = (observations, rewards, terminated, truncated, infos["pose"])
        yield tuple(each[chosen] for each in given)


class TestBatchSize:
    @te.every_varying
    def test_neither_it_nor_the_number_of_threads_matters(self, env_id, sensor):
        settings = {"actions": "quadrants", "sensors": sensor(), **te.EVERYTHING_VARIES}
        found = [
            tuple(rollout(te.native(env_id, num_envs, threads=threads, **settings), slice(4)))
            for num_envs, threads in ((4, 1), (16, 1), (8, 2), (16, 3), (5, 8))
        ]
        for other in found[1:]:
            te.assert_same(found[0], other)

    def test_an_environment_is_not_touched_by_the_parcels_of_others(self):
        """A base of more edges and contacts than any before widens the memory of all."""
        alone, among = (te.native(num_envs=count, actions="halves") for count in (1, 3))
        options = {"speed": 1.0, "side": 1, "parcel": "S"}
        alone.reset(seed=0, options=options)
        among.reset(seed=[0, 1, 2], options=[options, None, None])
        for period in range(20):
            if period == 5:
                mask = np.array([False, True, False])
                among.reset(options={"reset_mask": mask, "parcel": te.PARCELS["heptagon"]})
            if period == 10:
                mask = np.array([False, False, True])
                among.reset(options={"reset_mask": mask, "parcel": te.PARCELS["long"]})
            found = among.step(np.array([9, 9, 9]))
            wanted = alone.step(np.array([9]))
            te.assert_same(found[0][:1], wanted[0])
            te.assert_same(found[4]["pose"][:1], wanted[4]["pose"])

    def test_every_environment_takes_its_own_options(self):
        env = te.native(num_envs=4)
        speeds = [0.5, 1.0, 1.5, 2.0]
        starts = [{"speed": speed, "side": -1} for speed in speeds]
        observations, infos = env.reset(seed=0, options=starts)
        np.testing.assert_array_equal(infos["velocity"][:, 0], speeds)
        np.testing.assert_array_equal(observations[:, -1], -1.0)
        _, infos = env.reset(seed=0, options=[None, {"speed": 0.7}, None, {}])
        drawn = te.native(num_envs=4).reset(seed=0)[1]["velocity"][:, 0]
        drawn[1] = 0.7
        np.testing.assert_array_equal(infos["velocity"][:, 0], drawn)

    @te.every_id
    def test_one_set_of_options_is_for_all(self, env_id):
        observations, infos = te.native(env_id).reset(seed=0, options=te.OPTIONS[env_id])
        assert (observations == observations[0]).all()
        assert (infos["pose"] == infos["pose"][0]).all()

    @te.every_id
    def test_the_time_limit_is_the_registered_one(self, env_id):
        column = 19 if env_id == "SmartSurface/Park-v0" else 26  # Park's last one
        env = te.native(env_id, num_envs=1, zone=(column, column), autoreset_mode="Disabled")
        limit = gym.spec(env_id).max_episode_steps
        env.reset(seed=0)
        for period in range(1, limit + 1):
            *_, terminated, truncated, infos = env.step(env.action_space.sample())
            assert truncated[0] == (period == limit)
            if terminated[0]:
                break
        else:
            assert infos["outcome"].tolist() == ["out of time"]

    def test_there_may_be_no_time_limit(self):
        env = sg.SmartSurfaceVectorEnv(2, actions="halves", autoreset_mode="SameStep")
        env.reset(seed=0, options={"speed": 0.0})
        ends = [env.step(np.array([15, 15]))[2:4] for _ in range(300)]
        assert not np.array(ends)[:, 1].any()


class TestContract:
    @te.every_mode
    def test_the_instance_says_its_mode(self, mode):
        for given in (mode, mode.value):
            env = te.native(autoreset_mode=given)
            assert type(env) is sg.SmartSurfaceVectorEnv
            assert (env.num_envs, env.spec.id) == (te.NUM_ENVS, te.SORT)
            assert env.metadata["autoreset_mode"] is mode
        assert "autoreset_mode" not in sg.SmartSurfaceVectorEnv.metadata
        assert te.native().metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP

    @te.every_mode
    def test_what_it_returns_is_the_users_own(self, mode):
        env, twin = te.pair(te.native, max_episode_steps=3, autoreset_mode=mode)
        for number in range(9):
            results = env.step(env.action_space.sample())
            te.assert_same(results, twin.step(twin.action_space.sample()))
            for array in arrays_of(results):
                assert array.flags.writeable
                array[:] = 0
            if mode == AutoresetMode.DISABLED and number % 3 == 2:
                for each in (env, twin):
                    each.reset(options={"reset_mask": np.ones(te.NUM_ENVS, dtype=bool)})

    def test_gymnasiums_wrappers_work_on_it(self):
        env = gym.wrappers.vector.RecordEpisodeStatistics(
            te.native(actions="halves", max_episode_steps=5, autoreset_mode="SameStep")
        )
        env.reset(seed=0)
        for _ in range(5):
            *_, infos = env.step(np.array([1, 2, 3]))
        assert infos["episode"]["l"].tolist() == [5, 5, 5]


def arrays_of(value: Any) -> Iterator[np.ndarray]:
    if isinstance(value, np.ndarray):
        yield value
        if value.dtype == object:
            for element in value:
                yield from arrays_of(element)
    elif isinstance(value, (tuple, dict)):
        for element in value.values() if isinstance(value, dict) else value:
            yield from arrays_of(element)


class TestMemory:
    @pytest.mark.parametrize(
        ("sensor", "mode"), list(zip(te.SENSORS, cycle(AutoresetMode), strict=False))
    )
    def test_does_not_grow(self, sensor, mode):
        env = te.native(num_envs=8, sensors=sensor(), autoreset_mode=mode, **te.PARCELS_VARY)
        actions = np.zeros((8, 4), dtype=np.int64)

        def step() -> None:
            _, _, terminated, truncated, _ = env.step(actions)
            over = terminated | truncated
            if mode == AutoresetMode.DISABLED and over.any():
                env.reset(options={"reset_mask": over})

        env.reset(seed=0)
        assert te.growth(step, 300, 500) < 17 * 8  # [bytes] an environment


class TestDrawing:
    def test_a_film_of_all_environments(self, tmp_path):
        env: Any = gym.make_vec(te.SORT, 3, actions="halves", render_mode="rgb_array")
        env.reset(seed=0)
        assert len(env.unwrapped.render()) == 3
        film = gym.wrappers.vector.RecordVideo(env, str(tmp_path / "films"))
        film.reset(seed=0)
        for _ in range(3):
            film.step(env.action_space.sample())
        film.close()
        assert [file.suffix for file in (tmp_path / "films").iterdir()] == [".mp4"]

    def test_all_environments_in_one_picture(self):
        env = te.native(render_mode="rgb_array")
        env.reset(seed=0)
        first = env.montage()
        env.step(env.action_space.sample())
        second = env.montage()
        assert first.dtype == np.uint8
        assert first.shape == second.shape
        assert (first != second).any()


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
