"""The native vector environment, beside single ones and Gymnasium's own vector of them."""

import math
import tracemalloc
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

import surface_gym as sg
from surface_gym.actuators import Actuators
from surface_gym.randomisation import Randomisation
from tests.environments import (
    ACTIONS,
    MINUS_45,
    OPTIONS,
    PARCELS,
    SENSORS,
    SORT,
    TRIANGLE,
    TWINS,
    assert_same,
    every_id,
    every_kind_of_action,
    every_sensor,
    same_choice,
)

LANES = 3
LIMIT = 14  # control periods of an episode, so that some run out of time
every_mode = pytest.mark.parametrize("mode", AutoresetMode, ids=lambda mode: mode.name)
EVERYTHING_VARIES: dict[str, Any] = {
    "actuators": Actuators(axis_speed=8.0, stuck_share=0.1),
    "randomisation": Randomisation(
        friction=0.2, rolling=0.2, mass=0.2, size=0.05, com_offset=0.2, stiffness=0.3,
        lateral=0.01, heading=0.05,
    ),
}  # fmt: skip


def native(env_id: str = SORT, lanes: int = LANES, **settings: Any) -> VectorEnv:
    return gym.make_vec(env_id, num_envs=lanes, **settings)


def single_of(env_id: str, limit: int, settings: dict[str, Any]) -> gym.Env:
    return gym.make(env_id, max_episode_steps=limit, disable_env_checker=True, **settings)


def singles(
    env_id: str, mode: AutoresetMode, limit: int = LIMIT, lanes: int = LANES, **settings: Any
) -> SyncVectorEnv:
    make = partial(single_of, env_id, limit, settings)
    return SyncVectorEnv([make] * lanes, autoreset_mode=mode)


def assert_infos_same(found: dict[str, Any], wanted: dict[str, Any], late: np.ndarray) -> None:
    """Infos of the native env agree with those Gymnasium gathered from single ones.

    Values count where the mask says so. A single env knows of no time limit, so the outcome of
    the lanes that ran out of time is its one difference.
    """
    assert set(found) == set(wanted)
    for name, value in wanted.items():
        if name.startswith("_"):
            assert found[name].dtype == np.bool_
            np.testing.assert_array_equal(found[name], value, name)
            continue
        mask = wanted[f"_{name}"]
        if name == "final_obs":
            for lane in range(len(mask)):
                assert_same(found[name][lane], value[lane])
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
    one.action_space.seed(0)
    observations, infos = one.reset(seed=11)
    same_observations, same_infos = other.reset(seed=11)
    assert_same(observations, same_observations)
    nobody = np.zeros(one.num_envs, dtype=np.bool_)
    assert_infos_same(infos, same_infos, nobody)
    ended = 0
    for _ in range(periods):
        actions = one.action_space.sample()
        *results, infos = one.step(actions)
        *same_results, same_infos = other.step(actions)
        assert_same(tuple(results), tuple(same_results))
        _, _, terminated, truncated = results
        over = terminated | truncated
        late = truncated & ~terminated
        if mode == AutoresetMode.SAME_STEP:  # the lanes' infos are those of their next start
            assert_infos_same(infos.pop("final_info", {}), same_infos.pop("final_info", {}), late)
            late = nobody
        assert_infos_same(infos, same_infos, late)
        ended += int(over.sum())
        if mode == AutoresetMode.DISABLED and over.any():
            observations, infos = one.reset(options={"reset_mask": over})
            same_observations, same_infos = other.reset(options={"reset_mask": over.copy()})
            assert_same(observations, same_observations)
            assert_infos_same(infos, same_infos, nobody)
    return ended


class TestBesideSingles:
    @every_mode
    @every_sensor
    @every_kind_of_action
    @every_id
    def test_each_lane_is_a_single_env(
        self, env_id: str, actions: str, sensor: Any, mode: AutoresetMode
    ) -> None:
        settings = {"actions": actions, "sensors": sensor()}
        one = native(env_id, max_episode_steps=LIMIT, autoreset_mode=mode, **settings)
        other = singles(env_id, mode, **settings)
        assert run_beside(one, other, mode, 40) >= 2 * LANES

    @every_mode
    @every_id
    def test_also_where_everything_varies(self, env_id: str, mode: AutoresetMode) -> None:
        settings = {"actions": "quadrants", "sensors": SENSORS[-1](), **EVERYTHING_VARIES}
        one = native(env_id, max_episode_steps=LIMIT, autoreset_mode=mode, **settings)
        assert run_beside(one, singles(env_id, mode, **settings), mode, 40) >= 2 * LANES

    @every_mode
    def test_also_over_whole_episodes(self, mode: AutoresetMode) -> None:
        one = native(actions="halves", autoreset_mode=mode)
        assert run_beside(one, singles(SORT, mode, 100, actions="halves"), mode, 300) >= LANES

    def test_lane_by_lane(self) -> None:
        """What the above says, spelled out for the mode that needs no reset of its own."""
        env = native(lanes=4, actions="halves", autoreset_mode="SameStep")
        env.action_space.seed(0)
        actions = [env.action_space.sample() for _ in range(150)]
        observations, _ = env.reset(seed=20)
        seen = [observations]
        for action in actions:
            seen.append(env.step(action)[0])
        for lane in range(4):
            one = gym.make(SORT, actions="halves")
            observation, _ = one.reset(seed=20 + lane)
            np.testing.assert_array_equal(seen[0][lane], observation)
            for period, action in enumerate(actions, start=1):
                observation, _, terminated, truncated, _ = one.step(action[lane])
                if terminated or truncated:
                    observation, _ = one.reset()
                np.testing.assert_array_equal(seen[period][lane], observation)

    @every_mode
    def test_ending_at_the_limit_is_both(self, mode: AutoresetMode) -> None:
        """As with Gymnasium's TimeLimit: a lane that ends in its last period is truncated too."""
        single = gym.make(SORT, actions="halves", max_episode_steps=1000)
        action = same_choice(single.unwrapped, MINUS_45)
        single.reset(seed=11, options={"speed": 2.0, "side": 1})
        length = 1
        while not single.step(action)[2]:
            length += 1
        results = []
        for env in (
            native(lanes=1, actions="halves", max_episode_steps=length, autoreset_mode=mode),
            singles(SORT, mode, length, lanes=1, actions="halves"),
        ):
            env.reset(seed=11, options={"speed": 2.0, "side": 1})
            for _ in range(length):
                step = env.step(np.array([action]))
            results.append(step)
        assert_same(results[0][:4], results[1][:4])

    @pytest.mark.parametrize("context", ["spawn", "forkserver"])
    def test_singles_in_processes_of_their_own(self, context: str) -> None:
        settings = {"actions": "halves", "sensors": SENSORS[-1]()}
        make = partial(single_of, SORT, LIMIT, settings)
        apart = AsyncVectorEnv([make] * 2, context=context)
        together = native(lanes=2, max_episode_steps=LIMIT, **settings)
        try:
            assert run_beside(together, apart, AutoresetMode.NEXT_STEP, 20) >= 2
        finally:
            apart.close()


def rollout(env: VectorEnv, lanes: slice, periods: int = 60) -> Iterator[tuple[Any, ...]]:
    """What some of the lanes give, each lane acting as it would in a smaller batch."""
    observations, _ = env.reset(seed=3)
    yield (observations[lanes],)
    rng = np.random.default_rng(0)
    for _ in range(periods):
        actions = rng.integers(0, 4, (64, *env.single_action_space.shape))[: env.num_envs]
        observations, rewards, terminated, truncated, infos = env.step(actions)
        yield (
            observations[lanes],
            rewards[lanes],
            terminated[lanes],
            truncated[lanes],
            infos["pose"][lanes],
        )


class TestLanes:
    @every_sensor
    @every_id
    def test_their_number_does_not_matter(self, env_id: str, sensor: Any) -> None:
        settings = {"actions": "quadrants", "sensors": sensor(), **EVERYTHING_VARIES}
        few, many = (native(env_id, lanes, **settings) for lanes in (4, 16))
        for first, second in zip(rollout(few, slice(4)), rollout(many, slice(4)), strict=True):
            assert_same(first, second)

    def test_a_lane_is_not_touched_by_the_parcels_of_others(self) -> None:
        """A base of more edges and contacts than any before widens the memory of all lanes."""
        alone, among = native(lanes=1, actions="halves"), native(lanes=3, actions="halves")
        options = {"speed": 1.0, "side": 1, "parcel": "S"}
        alone.reset(seed=0, options=options)
        among.reset(seed=[0, 1, 2], options=[options, None, None])
        for period in range(20):
            if period == 5:
                mask = np.array([False, True, False])
                among.reset(options={"reset_mask": mask, "parcel": PARCELS["heptagon"]})
            if period == 10:
                mask = np.array([False, False, True])
                among.reset(options={"reset_mask": mask, "parcel": PARCELS["long"]})
            found = among.step(np.array([9, 9, 9]))
            wanted = alone.step(np.array([9]))
            assert_same(found[0][:1], wanted[0])
            assert_same(found[4]["pose"][:1], wanted[4]["pose"])

    def test_every_lane_takes_its_own_options(self) -> None:
        env = native(lanes=4)
        speeds = [0.5, 1.0, 1.5, 2.0]
        starts = [{"speed": speed, "side": -1} for speed in speeds]
        observations, infos = env.reset(seed=0, options=starts)
        np.testing.assert_array_equal(infos["velocity"][:, 0], speeds)
        np.testing.assert_array_equal(observations[:, -1], -1.0)
        _, infos = env.reset(seed=0, options=[None, {"speed": 0.7}, None, {}])
        drawn = native(lanes=4).reset(seed=0)[1]["velocity"][:, 0]
        drawn[1] = 0.7
        np.testing.assert_array_equal(infos["velocity"][:, 0], drawn)

    @every_id
    def test_one_set_of_options_is_for_all(self, env_id: str) -> None:
        observations, infos = native(env_id).reset(seed=0, options=OPTIONS[env_id])
        assert (observations == observations[0]).all()
        assert (infos["pose"] == infos["pose"][0]).all()
        assert OPTIONS[env_id] == dict(OPTIONS[env_id])

    @every_id
    def test_the_time_limit_is_the_registered_one(self, env_id: str) -> None:
        env = native(env_id, lanes=1, zone=(29, 29), autoreset_mode="Disabled")
        limit = gym.spec(env_id).max_episode_steps
        env.reset(seed=0)
        for period in range(1, limit + 1):
            *_, terminated, truncated, infos = env.step(env.action_space.sample())
            assert truncated[0] == (period == limit)
            if terminated[0]:
                break
        else:
            assert infos["outcome"].tolist() == ["out of time"]

    def test_there_may_be_no_time_limit(self) -> None:
        env = sg.SmartSurfaceVectorEnv(2, actions="halves", autoreset_mode="SameStep")
        env.reset(seed=0, options={"speed": 0.0})
        ends = [env.step(np.array([15, 15]))[2:4] for _ in range(300)]
        assert not np.array(ends)[:, 1].any()


class TestThreads:
    @pytest.mark.parametrize("threads", [2, 3, 8])
    def test_their_number_does_not_matter(self, threads: int) -> None:
        settings = {"actions": "quadrants", "sensors": SENSORS[-1](), **EVERYTHING_VARIES}
        one, several = native(lanes=5, **settings), native(lanes=5, threads=threads, **settings)
        for first, second in zip(
            rollout(one, slice(None)), rollout(several, slice(None)), strict=True
        ):
            assert_same(first, second)

    @pytest.mark.parametrize("threads", [0, -1, 1.5, True, "all"])
    def test_bad_numbers_are_named(self, threads: Any) -> None:
        with pytest.raises(ValueError, match="threads"):
            sg.SmartSurfaceVectorEnv(2, threads=threads)


class TestSeeds:
    def test_a_number_is_for_the_first_lane(self) -> None:
        one, listed = native(), native()
        assert_same(one.reset(seed=7), listed.reset(seed=[7, 8, 9]))
        assert_same(one.reset(seed=np.int64(7)), listed.reset(seed=(7, 8, 9)))

    def test_none_goes_on_drawing(self) -> None:
        env, twin = native(), native()
        env.reset(seed=7)
        twin.reset(seed=7)
        assert_same(env.reset(), twin.reset(seed=[None, None, None]))
        mixed, twins = env.reset(seed=[1, None, 1])[0], twin.reset()[0]
        np.testing.assert_array_equal(mixed[1], twins[1])
        np.testing.assert_array_equal(mixed[0], mixed[2])

    def test_unseeded_envs_differ(self) -> None:
        starts = [native().reset()[0] for _ in range(2)]
        assert len(np.unique(np.concatenate(starts), axis=0)) == 2 * LANES

    @pytest.mark.parametrize(
        "seed", [[1, 2], [1, 2, 3, 4], [], 1.5, "seed", [1, 2, -3], -1, [0.5] * 3], ids=repr
    )
    def test_bad_ones_are_refused(self, seed: Any) -> None:
        env = native()
        with pytest.raises((ValueError, gym.error.Error), match=r"[Ss]eed"):
            env.reset(seed=seed)
        assert_same(env.reset(seed=0), native().reset(seed=0))


class TestPartialResets:
    def disabled(self) -> VectorEnv:
        env = native(actions="halves", autoreset_mode="Disabled", sensors=SENSORS[-1]())
        env.reset(seed=0)
        return env

    def test_draw_nothing_for_others(self) -> None:
        env, twin = self.disabled(), self.disabled()
        action = np.array([6, 7, 8])
        for _ in range(4):
            assert_same(env.step(action)[0][1:], twin.step(action)[0][1:])
            env.reset(options={"reset_mask": np.array([True, False, False])})
        mask = np.array([False, True, True])
        assert_same(
            env.reset(options={"reset_mask": mask})[0][1:],
            twin.reset(options={"reset_mask": mask})[0][1:],
        )
        assert_same(env.step(action)[0][1:], twin.step(action)[0][1:])

    def test_leave_the_others_where_they_are(self) -> None:
        env = self.disabled()
        before = env.step(np.array([6, 7, 8]))[0]
        mask = np.array([False, True, False])
        after, infos = env.reset(options={"reset_mask": mask, "speed": 1.25})
        np.testing.assert_array_equal(after[~mask], before[~mask])
        np.testing.assert_array_equal(infos["_pose"], mask)
        np.testing.assert_array_equal(infos["velocity"][mask], [[1.25, 0.0, 0.0]])

    def test_seed_the_lanes_they_reset(self) -> None:
        env = self.disabled()
        mask = np.array([False, True, True])
        observations, _ = env.reset(seed=40, options={"reset_mask": mask})
        fresh = self.disabled().reset(seed=40)[0]
        np.testing.assert_array_equal(observations[mask], fresh[mask])

    def test_leave_the_callers_options_alone(self) -> None:
        options = {"reset_mask": np.array([True, False, True]), "speed": 1.0}
        self.disabled().reset(options=options)
        assert set(options) == {"reset_mask", "speed"}

    @pytest.mark.parametrize(
        "mask",
        [
            [True, False, False],
            np.zeros(3, dtype=bool),
            np.ones(2, dtype=bool),
            np.ones((3, 1), dtype=bool),
            np.ones(3, dtype=int),
            True,
            None,
        ],
        ids=repr,
    )
    def test_bad_masks_are_named(self, mask: Any) -> None:
        env, twin = self.disabled(), self.disabled()
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})
        assert_same(env.step(np.array([1, 2, 3])), twin.step(np.array([1, 2, 3])))

    def test_the_first_reset_is_whole(self) -> None:
        env = native(autoreset_mode="Disabled")
        with pytest.raises(gym.error.ResetNeeded):
            env.reset(options={"reset_mask": np.array([True, False, False])})

    def test_ended_lanes_wait_for_theirs(self) -> None:
        env = native(actions="halves", autoreset_mode="Disabled", max_episode_steps=1)
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
    def test_bad_actions_are_named(self, actions: Any) -> None:
        env, twin = (native(actions="halves", max_episode_steps=2) for _ in range(2))
        for each in (env, twin):
            each.reset(seed=0)
        for _ in range(4):
            with pytest.raises(ValueError, match="action"):
                env.step(actions)
            assert_same(env.step(np.array([1, 2, 3])), twin.step(np.array([1, 2, 3])))

    @every_kind_of_action
    def test_one_bad_lane_moves_none(self, actions: str) -> None:
        env, twin = (native(actions=actions) for _ in range(2))
        for each in (env, twin):
            each.reset(seed=0)
        good = env.action_space.sample()
        bad = good.copy()
        bad[-1] = 99
        with pytest.raises(ValueError, match="action"):
            env.step(bad)
        assert_same(env.step(good), twin.step(good))

    BAD_OPTIONS: tuple[Any, ...] = (
        ({"velocity": 1.0}, "options"),
        ("speed", "options"),
        (3, "options"),
        ([{}, {}], "options"),
        ([{}, {}, {}, {}], "options"),
        ([{}, {}, {"velocity": 1.0}], "options"),
        ([{}, {}, 3], "options"),
        ({"speed": -1.0}, "speed"),
        ([{}, {}, {"speed": "fast"}], "speed"),
        ([{}, {}, {"parcel": "M"}], "parcel"),
        ([{}, {}, {"parcel": sg.Parcel(sg.Rectangle(2.0, 0.3))}], "parcel"),
        ([{}, {}, {"side": 2}], "side"),
    )

    @pytest.mark.parametrize(("options", "named"), BAD_OPTIONS)
    def test_bad_options_are_named(self, options: Any, named: str) -> None:
        """The episodes go on as if nothing had been asked, in the lanes before the bad one too."""
        env, twin = (native(actions="halves") for _ in range(2))
        for each in (env, twin):
            each.reset(seed=0)
            each.step(np.array([1, 2, 3]))
        with pytest.raises(ValueError, match=named):
            env.reset(seed=1, options=options)
        assert_same(env.step(np.array([1, 2, 3])), twin.step(np.array([1, 2, 3])))
        assert_same(env.reset(seed=2), twin.reset(seed=2))

    @pytest.mark.parametrize(
        ("argument", "named"),
        [
            ({"num_envs": 0}, "num_envs"),
            ({"num_envs": -2}, "num_envs"),
            ({"num_envs": 2.0}, "num_envs"),
            ({"num_envs": True}, "num_envs"),
            ({"max_episode_steps": 0}, "max_episode_steps"),
            ({"max_episode_steps": 2.5}, "max_episode_steps"),
            ({"autoreset_mode": "sometimes"}, "autoreset_mode"),
            ({"autoreset_mode": 3}, "autoreset_mode"),
            ({"autoreset_mode": None}, "autoreset_mode"),
            ({"render_mode": "human"}, "render_mode"),
        ],
    )
    def test_bad_arguments_are_named(self, argument: dict[str, Any], named: str) -> None:
        with pytest.raises(ValueError, match=named):
            sg.SmartSurfaceVectorEnv(**argument)

    def test_steps_before_a_reset_are_refused(self) -> None:
        env = native()
        with pytest.raises(gym.error.ResetNeeded, match="reset"):
            env.step(env.action_space.sample())


class TestContract:
    @every_id
    def test_make_vec_gives_the_native_one(self, env_id: str) -> None:
        env = native(env_id)
        assert type(env) is sg.SmartSurfaceVectorEnv
        assert env.spec is not None
        assert env.spec.id == env_id
        assert env.num_envs == LANES

    @pytest.mark.parametrize("actions", ACTIONS)
    @every_id
    def test_spaces_are_those_of_single_ones(self, env_id: str, actions: str) -> None:
        env = native(env_id, actions=actions)
        single = gym.make(env_id, actions=actions)
        assert env.single_observation_space == single.observation_space
        assert env.single_action_space == single.action_space
        sync = singles(env_id, AutoresetMode.NEXT_STEP, actions=actions)
        assert env.observation_space == sync.observation_space
        assert env.action_space == sync.action_space
        assert env.reset(seed=0)[0] in env.observation_space

    @every_mode
    def test_the_instance_says_its_mode(self, mode: AutoresetMode) -> None:
        for given in (mode, mode.value):
            env = native(autoreset_mode=given)
            assert env.metadata["autoreset_mode"] is mode
        assert "autoreset_mode" not in sg.SmartSurfaceVectorEnv.metadata

    def test_the_default_mode_is_next_step(self) -> None:
        assert native().metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP

    @every_mode
    def test_what_it_returns_is_the_users_own(self, mode: AutoresetMode) -> None:
        env, twin = (native(max_episode_steps=3, autoreset_mode=mode) for _ in range(2))
        for each in (env, twin):
            each.reset(seed=0)
            each.action_space.seed(0)
        kept = []
        for _ in range(9):
            results = env.step(env.action_space.sample())
            assert_same(results, twin.step(twin.action_space.sample()))
            kept.append(results)
            for array in arrays_of(results):
                assert array.flags.writeable
                array[:] = 0
            if mode == AutoresetMode.DISABLED and env.num_envs and len(kept) % 3 == 0:
                mask = np.ones(LANES, dtype=bool)
                for each in (env, twin):
                    each.reset(options={"reset_mask": mask})

    def test_gymnasiums_wrappers_work_on_it(self) -> None:
        env = gym.wrappers.vector.RecordEpisodeStatistics(
            native(actions="halves", max_episode_steps=5, autoreset_mode="SameStep")
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


class TestTwins:
    @pytest.mark.parametrize("twin_of", TWINS)
    @every_sensor
    @every_id
    def test_go_on_alike(self, env_id: str, sensor: Any, twin_of: Callable[[Any], Any]) -> None:
        env = native(env_id, sensors=sensor(), max_episode_steps=8, **EVERYTHING_VARIES)
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(4):
            env.step(env.action_space.sample())
        twin = twin_of(env)
        for _ in range(30):
            assert_same(env.step(env.action_space.sample()), twin.step(twin.action_space.sample()))

    @pytest.mark.parametrize("twin_of", TWINS)
    def test_go_their_own_ways(self, twin_of: Callable[[Any], Any]) -> None:
        env, reference = (native(actions="halves") for _ in range(2))
        for each in (env, reference):
            each.reset(seed=0, options={"parcel": TRIANGLE})
        twin = twin_of(env)
        twin.step(np.array([5, 5, 5]))
        assert_same(env.step(np.array([1, 2, 3])), reference.step(np.array([1, 2, 3])))


class TestMemory:
    @every_sensor
    @every_mode
    def test_does_not_grow(self, sensor: Any, mode: AutoresetMode) -> None:
        env = native(
            lanes=8,
            actions="halves",
            sensors=sensor(),
            autoreset_mode=mode,
            randomisation=Randomisation(size=0.05, friction=0.1),
        )
        actions = np.zeros(8, dtype=np.int64)

        def go(periods: int) -> None:
            for _ in range(periods):
                _, _, terminated, truncated, _ = env.step(actions)
                over = terminated | truncated
                if mode == AutoresetMode.DISABLED and over.any():
                    env.reset(options={"reset_mask": over})

        env.reset(seed=0)
        tracemalloc.start()
        try:
            go(1_000)
            before = tracemalloc.get_traced_memory()[0]
            go(1_500)
            grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
        assert grown < 200_000  # [bytes] 17 a lane and step


class TestDrawing:
    def test_all_lanes_in_one_picture(self) -> None:
        env = native(render_mode="rgb_array")
        env.reset(seed=0)
        (first,) = env.render()
        env.step(env.action_space.sample())
        (second,) = env.render()
        assert first.dtype == np.uint8
        assert first.shape == second.shape
        assert (first != second).any()

    def test_without_a_mode_there_is_none(self) -> None:
        env = native()
        env.reset(seed=0)
        assert env.render() is None

    def test_before_the_first_reset_it_is_refused(self) -> None:
        with pytest.raises(gym.error.ResetNeeded):
            native(render_mode="rgb_array").render()
