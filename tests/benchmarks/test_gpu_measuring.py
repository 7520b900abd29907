"""The GPU's benchmark, on stand-ins: what it counts, times and compares."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.gpu import resets, windows
from benchmarks.gpu.agreement import Ends, compare, ends_of
from benchmarks.gpu.lanes import DeviceLanes, HostLanes, make_env
from benchmarks.gpu.resets import HostClock, resets_of
from benchmarks.gpu.windows import Effort, Rate, rate_of
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.tasks.sort import Sort

LANES = 4
LIMIT = 6  # control periods of an episode


class Watch:
    """A clock that goes on only when it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *modules: Any) -> None:
        self.now = 0.0
        for module in modules:
            monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=lambda: self.now))


class Supply:
    """Starts that were taken, of a stand-in."""

    def __init__(self, watch: Watch | None) -> None:
        self.taken = torch.zeros(LANES, dtype=torch.int64)
        self._watch = watch

    def _prepare(self) -> SimpleNamespace:
        if self._watch is not None:
            self._watch.now += 0.5
        return SimpleNamespace(lanes=[0, 1, 2])

    def follow(self) -> None:
        self._prepare()


class StandIn:
    """The CPU's environment with the face of a GPU's: tensors, on the CPU."""

    device = torch.device("cpu")

    def __init__(self, mode: str = "SameStep", watch: Watch | None = None) -> None:
        self._env = SmartSurfaceVectorEnv(
            LANES, actions="halves", max_episode_steps=LIMIT, autoreset_mode=mode
        )
        self.num_envs = LANES
        self.single_action_space = self._env.single_action_space
        self.outcomes = self._env._batch.outcomes
        self._batch = SimpleNamespace(supply=Supply(watch))
        self._watch = watch
        self.seeds: list[int] = []

    def reset(self, seed: int) -> None:
        self.seeds.append(seed)
        self._env.reset(seed=seed)
        self._batch.supply.taken += 1

    def step(self, actions: torch.Tensor) -> tuple[Any, ...]:
        observation, reward, terminated, truncated, infos = self._env.step(actions.numpy())
        if self._watch is not None:
            self._watch.now += 2.0
        self._begin_again(terminated | truncated)
        self._batch.supply.follow()
        names = list(self.outcomes)
        infos["outcome"] = torch.tensor([names.index(name) for name in infos["outcome"]])
        infos["pose"] = torch.from_numpy(infos["pose"])
        flags = (torch.from_numpy(each) for each in (terminated, truncated))
        return torch.from_numpy(observation), torch.from_numpy(reward), *flags, infos

    def _begin_again(self, over: Any) -> None:
        self._batch.supply.taken += torch.from_numpy(over)
        if self._watch is not None:
            self._watch.now += 1.5


def test_the_median_window_counts_and_what_comes_before_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    watch = Watch(monkeypatch, windows)

    class Slow:
        name, lanes, first = "slow", 10, 3.0
        seconds = iter([100.0, 1.0, 8.0, 2.0])  # settling and three windows
        chunks: list[int] = []

        def step(self, steps: int) -> None:
            self.chunks.append(steps)
            watch.now += next(self.seconds)

        def begun(self) -> int:
            return 4 * len(self.chunks)

    effort = Effort(windows=3, steps=64, seconds=0.5, chunk=64, settling=128)
    assert rate_of(Slow(), effort) == Rate("slow", 10, 64 * 10 / 2.0, 4 / 2.0, 3.0)
    assert Slow.chunks == [128, 64, 64, 64]


def test_a_window_lasts_as_long_as_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Watch(monkeypatch, windows)

    class Fast:
        name, lanes, first, steps = "fast", 1, 0.0, 0

        def step(self, steps: int) -> None:
            self.steps += steps
            watch.now += 0.1

        def begun(self) -> int:
            return 0

    fast = Fast()
    rate_of(fast, Effort(windows=1, steps=8, seconds=0.95, chunk=8, settling=8))
    assert fast.steps == 8 + 10 * 8


class TestLanes:
    def test_a_device_is_reset_twice_alike_and_its_starts_are_counted(self) -> None:
        env = StandIn()
        lanes = DeviceLanes("stand-in", env)
        assert env.seeds == [0, 0]
        before = lanes.begun()
        lanes.step(LIMIT)
        assert lanes.begun() - before >= LANES  # each lane has ended, at its limit or before
        assert lanes.lanes == LANES

    def test_the_host_counts_the_episodes_that_end(self) -> None:
        lanes = HostLanes("host", make_env(Sort(), LANES, max_episode_steps=LIMIT))
        assert lanes.begun() == 0
        lanes.step(2 * LIMIT)
        assert lanes.begun() >= 2 * LANES


def test_the_share_of_resets_is_of_the_parts_that_are_there_for_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = StandIn(watch=Watch(monkeypatch, resets))
    lanes = DeviceLanes("stand-in", env)
    found = resets_of(lanes, HostClock(), steps=5)
    # A step takes 2 s to move, 1.5 s to begin again and 0.5 s to keep three starts coming.
    assert found.share == pytest.approx((1.5 + 0.5) / 4.0)
    assert found.laid_out == pytest.approx(3 / 0.5)
    assert "_begin_again" not in vars(env)


class TestAgreement:
    ACTIONS = np.random.default_rng(0).integers(0, 16, (LIMIT, LANES))

    def test_the_same_lanes_of_both_faces_end_alike(self) -> None:
        host = SmartSurfaceVectorEnv(LANES, actions="halves", max_episode_steps=LIMIT)
        there = ends_of(host, self.ACTIONS, seed=3)
        here = ends_of(StandIn("NextStep"), self.ACTIONS, seed=3)
        assert there.place.any(axis=1).all()
        found = compare(here, there)
        assert (found.apart, found.other_outcomes, found.other_lengths) == (0, 0, 0)
        assert found.largest == 0.0

    def test_lanes_apart_and_other_outcomes_are_counted(self) -> None:
        ends = Ends(np.zeros((4, 2)), np.array(["success"] * 4), np.full(4, 9))
        place = np.array([[0.0, 5e-9], [0.0, 3e-8], [4.0, 3.0], [0.0, 0.0]])
        outcome = np.array(["success", "success", "stalled", "success"])
        found = compare(replace(ends, place=place, outcome=outcome), ends)
        assert (found.lanes, found.apart, found.other_outcomes) == (4, 2, 1)
        assert found.largest == 3e-8
        assert found.median == pytest.approx(1.75e-8)

    def test_an_episode_that_does_not_end_is_an_error(self) -> None:
        with pytest.raises(ValueError, match="got 1: 4 lanes have not ended"):
            ends_of(StandIn("NextStep"), self.ACTIONS[:1], seed=3)
