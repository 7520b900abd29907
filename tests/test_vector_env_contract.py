"""The native vector environment: Gymnasium's contract, twins, memory and drawing."""

import tracemalloc
from collections.abc import Callable, Iterator
from itertools import cycle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import surface_gym as sg
from surface_gym.randomisation import Randomisation
from tests.environments import (
    ACTIONS,
    EVERYTHING_VARIES,
    NUM_ENVS,
    SENSORS,
    TRIANGLE,
    TWINS,
    assert_same,
    every_id,
    every_mode,
    every_varying,
    native,
    singles,
)


class TestContract:
    @every_id
    def test_make_vec_gives_the_native_one(self, env_id: str) -> None:
        env = native(env_id)
        assert type(env) is sg.SmartSurfaceVectorEnv
        assert env.spec is not None
        assert env.spec.id == env_id
        assert env.num_envs == NUM_ENVS

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
                mask = np.ones(NUM_ENVS, dtype=bool)
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
    @every_varying
    def test_go_on_alike(self, env_id: str, sensor: Any, twin_of: Callable[[Any], Any]) -> None:
        settings = {"actions": "quadrants", "sensors": sensor(), **EVERYTHING_VARIES}
        env = native(env_id, max_episode_steps=8, **settings)
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
    @pytest.mark.parametrize(
        ("sensor", "mode"), list(zip(SENSORS, cycle(AutoresetMode), strict=False))
    )
    def test_does_not_grow(self, sensor: Any, mode: AutoresetMode) -> None:
        env = native(
            num_envs=8,
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
        assert grown < 200_000  # [bytes] 17 an environment and step


class TestDrawing:
    def test_all_environments_in_one_picture(self) -> None:
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
