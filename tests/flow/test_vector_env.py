"""The native vector environment of flows, beside single ones in Gymnasium's own vector."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from surface_gym.flow.stream import Stream
from surface_gym.randomisation import Randomisation
from surface_gym.registration import FLOW
from surface_gym.vector_env import SmartSurfaceVectorEnv
from tests.environments import NUM_ENVS, assert_same, every_mode, native, singles
from tests.flow.flows import BRAKE, DENSE, KINDS, ROLL, SHORT, every_kind, trace
from tests.test_vector_env import run_beside

LONG = 10_000  # control periods: a flow ends by itself before that
EPISODE = {"stream": DENSE, "line": SHORT, "duration": 0.6}  # 15 control periods
VARIED = KINDS["parcels, camera, all varies"]


def streams(parcels: int = NUM_ENVS, **settings: Any) -> VectorEnv:
    return native(FLOW, parcels, **{**EPISODE, **settings})


def single_flows(mode: AutoresetMode, **settings: Any) -> SyncVectorEnv:
    return singles(FLOW, mode, LONG, **{**EPISODE, **settings})


# What else may differ between the two, each with its control periods.
BESIDE: dict[str, tuple[dict[str, Any], int]] = {
    **{name: (kind, 40) for name, kind in KINDS.items()},
    "a gate": ({"actions": "parcels", "gate": True}, 40),
    "jams": (
        {"actions": "parcels", "orientations": (0.0, 0.1), "patience": 0.2, "duration": 3.0}, 100
    ),
    # A start pays nothing, also where parcels enter aside of the middle as an episode begins.
    "starts aside": (
        {
            "stream": Stream(DENSE.arrivals, destinations={"straight": 1.0}),
            "actions": "parcels", "duration": 0.12, "randomisation": Randomisation(lateral=0.05),
        },
        12,
    ),
}  # fmt: skip


@every_mode
@pytest.mark.parametrize("beside", BESIDE.values(), ids=BESIDE)
def test_each_environment_is_a_single_env(beside: tuple[Any, int], mode: AutoresetMode) -> None:
    settings, periods = beside
    one, other = streams(autoreset_mode=mode, **settings), single_flows(mode, **settings)
    assert run_beside(one, other, mode, periods) >= (1 if "patience" in settings else 2) * NUM_ENVS


def rollout(env: VectorEnv) -> Iterator[tuple[Any, ...]]:
    """What the first two environments give, each acting as it would in a smaller batch."""
    observations, _ = env.reset(seed=3)
    yield (observations[:2],)
    rng = np.random.default_rng(0)
    for _ in range(40):
        actions = rng.integers(0, 4, (64, *env.single_action_space.shape))[: env.num_envs]
        observations, rewards, terminated, truncated, infos = env.step(actions)
        results = (observations, rewards, terminated, truncated)
        yield tuple(each[:2] for each in (*results, infos["parcels"], infos["touches"]))


class TestLanes:
    def test_their_number_does_not_matter_nor_does_that_of_threads(self) -> None:
        few, several = streams(2, threads=1, **VARIED), streams(12, threads=3, **VARIED)
        assert several.batch._threads == 3
        for first, second in zip(rollout(few), rollout(several), strict=True):
            assert_same(first, second)

    def test_every_environment_takes_its_own_stream(self) -> None:
        env = streams(actions="parcels")
        mine = trace((0.0, "left 1"), (0.3, "right 1"), speed=1.1)
        _, infos = env.reset(seed=0, options=[None, {"stream": mine}, {}])
        batch = env.batch
        assert batch.streams.arrivals[1] == 2
        _, drawn = streams(actions="parcels").reset(seed=0)
        np.testing.assert_array_equal(infos["parcels"], drawn["parcels"])
        np.testing.assert_array_equal(batch.parcels.truth[batch.rows, 3], 1.1)


class TestContract:
    @every_kind
    def test_make_vec_gives_the_native_one_with_their_spaces(self, kind: dict[str, Any]) -> None:
        env, sync = streams(**kind), single_flows(AutoresetMode.NEXT_STEP, **kind)
        assert type(env) is SmartSurfaceVectorEnv
        assert env.spec.id == FLOW
        for name in (
            "single_observation_space", "single_action_space", "observation_space", "action_space",
        ):  # fmt: skip
            assert getattr(env, name) == getattr(sync, name)
        assert env.reset(seed=0)[0] in env.observation_space

    def test_a_limit_of_ones_own_truncates(self) -> None:
        env = streams(actions="parcels", max_episode_steps=4)
        env.reset(seed=0)
        action = np.full(env.action_space.shape, ROLL)
        ends = [env.step(action)[3].all() for _ in range(5)]
        assert ends == [False, False, False, True, False]

    def test_bad_options_of_one_change_no_environment(self) -> None:
        env, twin = streams(actions="parcels"), streams(actions="parcels")
        action = np.full(env.action_space.shape, BRAKE)
        for each in (env, twin):
            each.reset(seed=0)
            each.step(action)
        with pytest.raises(ValueError, match="stream"):
            env.reset(seed=1, options=[{}, {}, {"stream": 3}])
        assert_same(env.step(action)[:4], twin.step(action)[:4])
        assert_same(env.reset()[0], twin.reset()[0])
