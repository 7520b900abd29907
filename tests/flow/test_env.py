"""The environments of a flow: Gymnasium's contract, seeds, twins, memory and bodies of the single
one, and the native vector environment beside single ones in Gymnasium's own vector.
"""

import copy
import math
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_by_gymnasium
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from stable_baselines3.common.env_checker import check_env as check_by_stable_baselines3

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.resets import place_parcel
from surface_gym.env import make_batch
from surface_gym.flow.arrivals import Schedule
from surface_gym.flow.batch import BodyPool, list_figures
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import FEATURES, Flow
from surface_gym.randomisation import Randomisation
from surface_gym.state import BAD_OBSERVATION, BAD_REWARD
from surface_gym.vector_env import SmartSurfaceVectorEnv
from tests import environments as te
from tests.environments import FLOW
from tests.flow import flows
from tests.test_vector_env import run_beside


class TestCheckers:
    @pytest.mark.parametrize("name", flows.KINDS)
    def test_gymnasiums_has_nothing_to_say(self, name: str) -> None:
        angles = pytest.warns(UserWarning, match="normalized space")
        with angles if "any angle" in name else nullcontext():
            check_by_gymnasium(flows.bare(**flows.KINDS[name]), skip_render_check=True)

    @pytest.mark.parametrize("actions", ["modules", "parcels"])
    def test_stable_baselines3s_has_nothing_to_say(self, actions: str) -> None:
        with pytest.warns(UserWarning, match="unconventional shape"):
            check_by_stable_baselines3(flows.bare(actions=actions))
        check_by_stable_baselines3(gym.wrappers.FlattenObservation(flows.bare(actions=actions)))


class TestEpisodes:
    @flows.every_kind
    def test_types_spaces_and_sums(self, kind: dict[str, Any]) -> None:
        env = flows.bare(**kind)
        assert env.observation_space.dtype == np.float32
        assert env.observation_space.shape == (24, len(FEATURES))
        for observation, reward, terminated, truncated, info in flows.steps(env, seed=3):
            assert observation in env.observation_space
            assert observation.dtype == np.float32
            assert type(reward) is float
            assert type(terminated) is type(truncated) is bool
            assert all(type(term) is float for term in te.terms(info).values())
            assert reward == pytest.approx(math.fsum(te.terms(info).values()), abs=1e-12)
            assert terminated == (info["outcome"] == "jam")
            assert truncated == (info["outcome"] == "out of time")
            ended = terminated or truncated
            assert ended or not any(info[name] for name in list_figures(Flow()))
        assert ended
        assert info["episode_turns_per_hour"] > 0.0

    def test_action_spaces(self) -> None:
        three = {"actions": "parcels", "max_parcels": 3}
        modules, parcels = flows.bare(actions="modules"), flows.bare(**three)
        # 4 rows of rotors, and all columns after the lead-in; the run-out's obey nobody.
        assert modules.action_space == gym.spaces.MultiDiscrete([4] * 4 * (flows.SHORT.columns - 5))
        assert parcels.action_space == gym.spaces.MultiDiscrete([4] * 6)
        any_angle = EnvConfig("flow", orientations="any", **three).action_space()
        right = np.float32(math.pi / 2)
        assert any_angle == gym.spaces.Box(-right, right, (6,))
        coarse = EnvConfig("flow", orientations=(0.0, 1.0), **three).action_space()
        assert coarse == gym.spaces.MultiDiscrete([2] * 6)

    @pytest.mark.parametrize(
        ("duration", "period", "periods"),
        [(1.0, 0.04, 25), (0.04, 0.04, 1), (0.9, 0.03, 30), (0.5, 0.013, 39)],
    )
    def test_lasts_its_duration(self, duration: float, period: float, periods: int) -> None:
        env = flows.bare(actions="parcels", duration=duration, control_period=period)
        assert env.config.periods == periods
        played = flows.play(env, flows.ROLL)
        assert len(played) == periods
        assert [step[3] for step in played] == [False] * (periods - 1) + [True]
        assert not any(step[2] for step in played)
        for number, step in enumerate(played, start=1):
            assert step[4]["time"] == pytest.approx(period * number, abs=1e-9)

    def test_a_gate_adds_a_row_and_a_number(self) -> None:
        env = flows.bare(actions="parcels", gate=True, max_parcels=3)
        assert env.observation_space.shape == (4, len(FEATURES))
        assert env.action_space == gym.spaces.MultiDiscrete([4] * 6 + [9])
        for observation, *_, info in flows.steps(env, seed=0):
            assert observation in env.observation_space
            assert info["parcels"].shape == (3,)
        assert info["entered"] > 0

    @pytest.mark.parametrize("varied", [{}, {"size": 0.05, "lateral": 0.01}])
    def test_nobody_may_come_at_all(self, varied: dict[str, float]) -> None:
        nobody = {"stream": flows.trace((9.0, "left 1")), "duration": 0.4}
        env = flows.bare(actions="parcels", randomisation=Randomisation(**varied), **nobody)
        played = flows.play(env, flows.ROLL)
        assert len(played) == 10
        assert not any(step[0].any() or step[1] for step in played)

    def test_nobody_may_come_yet(self) -> None:
        stream = Stream(Schedule(((0.0, 0.0), (0.5, 3600.0))))
        env = flows.bare(stream=stream, actions="parcels", patience=0.1, duration=0.8)
        observation, info = env.reset(seed=0)
        assert not observation.any()
        assert info["entered"] == 0
        played = flows.play(env, flows.ROLL)
        assert [step[4]["entered"] for step in played] == [0] * 12 + [1] * 8
        assert all(step[1] == 0.0 for step in played[:12])

    @pytest.mark.parametrize(
        "action", [3, [3] * 47, [3] * 47 + [4], [3.0] * 48, None, [[3] * 48]], ids=repr
    )
    def test_bad_actions_are_named_and_move_nobody(self, action: Any) -> None:
        env, twin = flows.pair()
        with pytest.raises(ValueError, match="action"):
            env.step(action)
        good = flows.same_choice(env, flows.ROLL)
        te.assert_same(env.step(good), twin.step(good))

    @pytest.mark.parametrize(
        ("options", "named"),
        [
            ({"speed": 1.0}, "options"), (3, "options"), ({"stream": "dense"}, "stream"),
            ({"stream": None}, "stream"),
            ({"stream": Stream(destinations={"north": 1.0})}, "destinations"),
            ({"stream": flows.trace((0.0, "north"))}, "exit"),
            ({"stream": Stream(parcels=(sg.Parcel(sg.Rectangle(0.05, 0.3)),))}, "parcels"),
        ],
    )  # fmt: skip
    def test_bad_options_are_named_and_leave_the_episode(self, options: Any, named: str) -> None:
        env, twin = flows.pair(randomisation=Randomisation(size=0.05))
        for each in (env, twin):
            each.step(flows.same_choice(env, flows.BRAKE))
        with pytest.raises(ValueError, match=named):
            env.reset(seed=1, options=options)
        good = flows.same_choice(env, flows.ROLL)
        te.assert_same(env.step(good), twin.step(good))
        te.assert_same(env.reset(), twin.reset())

    def test_a_reset_may_bring_a_stream_of_its_own(self) -> None:
        env, twin = flows.pair(duration=1.0)
        env.reset(seed=0, options={"stream": flows.trace((0.0, "left 1"), (0.5, "right 2"))})
        streams = env.batch.streams
        names = env.config.exits.names
        assert [names[place] for place in streams.exit[0, :2]] == ["left 1", "right 2"]
        assert streams.arrivals.tolist() == [2]
        env.reset(seed=0)
        te.assert_same(env.reset(seed=0), twin.reset(seed=0))

    def test_starts_differ_from_seed_to_seed_and_from_reset_to_reset(self) -> None:
        env, coming = flows.bare(actions="parcels"), []
        for seed in (0, 1, 2, None, None, None):
            env.reset(seed=seed)
            coming.append(env.batch.streams.time[0, 1:6].copy())
        assert len(np.unique(coming, axis=0)) == 6


class TestTwins:
    @pytest.mark.parametrize("twin_of", te.TWINS)
    @flows.every_kind
    def test_go_on_alike(self, kind: dict[str, Any], twin_of: Callable[[Any], Any]) -> None:
        env = flows.bare(duration=1.0, **kind)
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(12):
            env.step(env.action_space.sample())
        twin = twin_of(env)
        for _ in range(60):
            first = env.step(env.action_space.sample())
            second = twin.step(twin.action_space.sample())
            te.assert_same(first, second)
            if first[2] or first[3]:
                te.assert_same(env.reset(), twin.reset())

    def test_go_their_own_ways(self) -> None:
        env, reference = flows.pair()
        twin = copy.deepcopy(env)
        twin.reset(options={"stream": flows.trace((0.0, "left 1"), parcel=sg.Parcel(sg.Disc(0.2)))})
        for _ in range(20):
            twin.step(flows.same_choice(twin, flows.PLUS_45))
        for _ in range(20):
            action = flows.same_choice(env, flows.MINUS_45)
            te.assert_same(env.step(action), reference.step(action))


class TestMemory:
    @pytest.mark.parametrize("varied", [{}, {"size": 0.05, "friction": 0.1}])
    def test_does_not_grow(self, varied: dict[str, float]) -> None:
        randomisation = Randomisation(**varied)
        env = flows.bare(actions="parcels", duration=0.4, randomisation=randomisation)
        action = flows.same_choice(env, flows.ROLL)

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
        # Of parcels drawn anew, each is kept as long as the episode has use for it.
        used = int(env.batch.streams.arrivals[0]) if varied else len(flows.DENSE.kinds)
        assert len(env.batch._pool._users) == used


@pytest.fixture
def pool() -> BodyPool:
    return BodyPool(lambda parcel: place_parcel(parcel, flows.SHORT, None), flows.BOX)


def sizes(count: int) -> list[sg.Parcel]:
    return [sg.Parcel(sg.Rectangle(0.2 + 0.001 * k, 0.2)) for k in range(count)]


class TestPool:
    """Bodies are kept as long as an episode has use for them."""

    def test_parcels_that_are_alike_share_a_row_free_after_the_last(self, pool: BodyPool) -> None:
        rows = [pool.take(sg.layouts.box(size)) for size in "SSB"]
        assert rows[0] == rows[1] != rows[2]
        pool.give_back(rows[:1])
        assert pool.parcel(rows[1]) == flows.BOX
        pool.give_back(rows[1:])
        with pytest.raises(KeyError):
            pool.parcel(rows[1])
        taken = {pool.take(parcel) for parcel in sizes(16)}
        assert taken == set(range(16))

    def test_more_parcels_take_more_rows_and_leave_the_others(self, pool: BodyPool) -> None:
        parcels = sizes(40)
        rows = [pool.take(parcel) for parcel in parcels]
        assert len(set(rows)) == 40
        assert len(pool.bodies.body) == 64
        for row, parcel in zip(rows, parcels, strict=True):
            placement = place_parcel(parcel, flows.SHORT, None)
            np.testing.assert_array_equal(pool.bodies.body[row], placement.body)
            np.testing.assert_array_equal(pool.bodies.corners[row], placement.corners)
            assert pool.parcel(row) == parcel

    def test_more_edges_widen_the_rows_of_all(self, pool: BodyPool) -> None:
        row = pool.take(flows.BOX)
        narrow = pool.bodies.corners[row].copy()
        wide = pool.take(te.HEPTAGON)
        assert pool.bodies.edges.shape[1] == pool.bodies.corners.shape[1] == 7
        np.testing.assert_array_equal(pool.bodies.corners[row, :4], narrow)
        np.testing.assert_array_equal(pool.bodies.corners[row, 4:], np.tile(narrow[:1], (3, 1)))
        np.testing.assert_array_equal(
            pool.bodies.corners[wide], place_parcel(te.HEPTAGON, flows.SHORT, None).corners
        )


LONG = 10_000  # control periods: a flow ends by itself before that
EPISODE = {"stream": flows.DENSE, "line": flows.SHORT, "duration": 0.6}  # 15 control periods
VARIED = flows.KINDS["parcels, camera, all varies"]


def vector_of(parcels: int = te.NUM_ENVS, **settings: Any) -> VectorEnv:
    return te.native(FLOW, parcels, **{**EPISODE, **settings})


def singles_of(mode: AutoresetMode, **settings: Any) -> SyncVectorEnv:
    return te.singles(FLOW, mode, LONG, **{**EPISODE, **settings})


# What else may differ between the two, each with its control periods.
BESIDE: dict[str, tuple[dict[str, Any], int]] = {
    **{name: (kind, 40) for name, kind in flows.KINDS.items()},
    "a gate": ({"actions": "parcels", "gate": True}, 40),
    "a queue at a gate, all varies": ({**VARIED, "gate": True, "queue": 3}, 40),
    "jams": (
        {"actions": "parcels", "orientations": (0.0, 0.1), "patience": 0.2, "duration": 3.0}, 100
    ),
    # A start pays nothing, also where parcels enter aside of the middle as an episode begins.
    "starts aside": (
        {
            "stream": Stream(flows.DENSE.arrivals, destinations={"straight": 1.0}),
            "actions": "parcels", "duration": 0.12, "randomisation": Randomisation(lateral=0.05),
        },
        12,
    ),
}  # fmt: skip


class TestBesideSingles:
    @te.every_mode
    @pytest.mark.parametrize("name", BESIDE)
    def test_each_environment_is_a_single_env(self, name: str, mode: AutoresetMode) -> None:
        settings, periods = BESIDE[name]
        one, other = vector_of(autoreset_mode=mode, **settings), singles_of(mode, **settings)
        assert (type(one), one.spec.id) == (SmartSurfaceVectorEnv, FLOW)
        least = te.NUM_ENVS if name == "jams" else 2 * te.NUM_ENVS
        assert run_beside(one, other, mode, periods) >= least


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


class TestBatches:
    def test_their_number_does_not_matter_nor_does_that_of_threads(self) -> None:
        few, several = vector_of(2, threads=1, **VARIED), vector_of(12, threads=3, **VARIED)
        assert several.batch._threads == 3
        for first, second in zip(rollout(few), rollout(several), strict=True):
            te.assert_same(first, second)

    def test_every_environment_takes_its_own_stream(self) -> None:
        env = vector_of(actions="parcels")
        mine = flows.trace((0.0, "left 1"), (0.3, "right 1"), speed=1.1)
        _, infos = env.reset(seed=0, options=[None, {"stream": mine}, {}])
        batch = env.batch
        assert batch.streams.arrivals[1] == 2
        _, drawn = vector_of(actions="parcels").reset(seed=0)
        np.testing.assert_array_equal(infos["parcels"], drawn["parcels"])
        np.testing.assert_array_equal(batch.parcels.truth[batch.rows, 3], 1.1)


class TestVector:
    def test_a_limit_of_ones_own_truncates(self) -> None:
        env = vector_of(actions="parcels", max_episode_steps=4)
        env.reset(seed=0)
        action = np.full(env.action_space.shape, flows.ROLL)
        ends = [env.step(action)[3].all() for _ in range(5)]
        assert ends == [False, False, False, True, False]

    def test_bad_options_of_one_change_no_environment(self) -> None:
        env, twin = te.pair(vector_of, actions="parcels")
        action = np.full(env.action_space.shape, flows.BRAKE)
        te.assert_same(env.step(action)[:4], twin.step(action)[:4])
        with pytest.raises(ValueError, match="stream"):
            env.reset(seed=1, options=[{}, {}, {"stream": 3}])
        te.assert_same(env.step(action)[:4], twin.step(action)[:4])
        te.assert_same(env.reset()[0], twin.reset()[0])


def test_a_fault_is_named_by_the_features_or_the_terms() -> None:
    batch = make_batch(EnvConfig("flow"), 2, compiles=False)
    batch.episodes.fault[1] = BAD_OBSERVATION
    batch.observation[1, 3, 2] = math.nan
    assert "Flow.observe, with Exact, must write finite features, got others for cosine of" in str(
        batch._fault()
    )
    batch.episodes.fault[0] = BAD_REWARD
    batch.terms[0] = math.inf
    assert str(batch._fault()).startswith(
        "Flow.reward must write finite terms, got {'correct': inf"
    )
