"""The GPU's benchmark on stand-ins: its timing, its comparison, its results and its command."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from rich.console import Console

from benchmarks.cli import main
from benchmarks.gpu import NotMeasured, cli, timing
from benchmarks.gpu.agreement import Ends, compare, run_episodes
from benchmarks.gpu.results import SMALL, Results, cpu_name, gpu_name, plot_rates
from benchmarks.gpu.timing import DeviceProgram, Effort, Rate, ResetCost, measure_rate
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.cuda import DeviceMissing
from surface_gym.tasks.sort import Sort

NUM_ENVS = 4
LIMIT = 6  # control periods of an episode
SIZE = {"num_envs": NUM_ENVS, "actions": "halves", "max_episode_steps": LIMIT}
QUIET = Console(quiet=True)


class ManualTime:
    """A clock that advances only where a test sets it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        monkeypatch.setattr(timing, "time", SimpleNamespace(perf_counter=lambda: self.now))


class Prefetch(SimpleNamespace):
    """The prefetch of a stand-in: three starts in half a second at each update."""

    def _prepare(self) -> SimpleNamespace:
        self.clock.now += 0.5
        return SimpleNamespace(env_indices=[0, 1, 2])

    def update(self) -> None:
        self._prepare()


class StandIn:
    """The CPU's environment with the interface of a GPU's: tensors, on the CPU."""

    device = torch.device("cpu")

    def __init__(self, mode: str = "SameStep", clock: Any = None) -> None:
        self._env = SmartSurfaceVectorEnv(autoreset_mode=mode, **SIZE)
        self.num_envs, self.seeds = NUM_ENVS, []
        self.single_action_space = self._env.single_action_space
        self.outcomes = self._env.batch.outcomes
        self._clock = clock or SimpleNamespace(now=0.0)
        taken = torch.zeros(NUM_ENVS, dtype=torch.int64)
        self.batch = SimpleNamespace(prefetch=Prefetch(clock=self._clock, starts_taken=taken))

    def reset(self, seed: int) -> None:
        self.seeds.append(seed)
        self._env.reset(seed=seed)
        self.batch.prefetch.starts_taken += 1

    def step(self, actions: torch.Tensor) -> tuple[Any, ...]:
        *arrays, infos = self._env.step(actions.numpy())
        self._clock.now += 2.0
        self._reset_ended(arrays[2] | arrays[3])
        self.batch.prefetch.update()
        names = list(self.outcomes)
        infos["outcome"] = torch.tensor([names.index(name) for name in infos["outcome"]])
        infos["pose"] = torch.from_numpy(infos["pose"])
        return *map(torch.from_numpy, arrays), infos

    def _reset_ended(self, ended: Any) -> None:
        self.batch.prefetch.starts_taken += torch.from_numpy(ended)
        self._clock.now += 1.5


class Scripted:
    """A program whose calls take given times."""

    name, num_envs, first = "scripted", 10, 3.0

    def __init__(self, clock: ManualTime, *seconds: float) -> None:
        self._clock = clock
        self._seconds = list(seconds)
        self.chunks: list[int] = []

    def step(self, steps: int) -> None:
        self.chunks.append(steps)
        self._clock.now += self._seconds.pop(0) if len(self._seconds) > 1 else self._seconds[0]

    def episodes(self) -> int:
        return 4 * len(self.chunks)


class TestTiming:
    def test_the_median_window_counts_after_warm_up_and_lasts_as_required(self, monkeypatch):
        program = Scripted(ManualTime(monkeypatch), 100.0, 1.0, 8.0, 2.0)
        effort = Effort(windows=3, steps=64, seconds=0.5, chunk=64, warm_up=128)
        rate = measure_rate(program, effort)
        assert rate == Rate("scripted", 10, 64 * 10 / 2.0, 4 / 2.0, 3.0)
        assert program.chunks == [128, 64, 64, 64]
        program = Scripted(ManualTime(monkeypatch), 0.1)
        measure_rate(program, Effort(windows=1, steps=8, seconds=0.95, chunk=8, warm_up=8))
        assert program.chunks == [8] * 11

    def test_a_device_is_reset_twice_alike_and_its_starts_are_counted(self):
        env = StandIn()
        program = DeviceProgram("stand-in", env)
        assert env.seeds == [0, 0]
        before = program.episodes()
        program.step(LIMIT)
        assert program.episodes() - before >= NUM_ENVS  # all have ended, at the limit or before
        assert program.num_envs == NUM_ENVS

    def test_the_host_counts_the_episodes_that_end(self):
        host = timing.make_sort(Sort(), NUM_ENVS, max_episode_steps=LIMIT)
        program = timing.HostProgram("host", host)
        assert program.episodes() == 0
        program.step(2 * LIMIT)
        assert program.episodes() >= 2 * NUM_ENVS

    def test_the_share_of_resets_is_of_the_parts_that_serve_them(self, monkeypatch):
        env = StandIn(clock=ManualTime(monkeypatch))
        cost = timing.measure_resets(DeviceProgram("stand-in", env), timing.HostClock(), steps=5)
        # A period takes 2 s to step, 1.5 s to reset and 0.5 s to prepare three starts.
        assert cost.share == pytest.approx((1.5 + 0.5) / 4.0)
        assert cost.starts == pytest.approx(3 / 0.5)
        assert "_reset_ended" not in vars(env)


class TestAgreement:
    ACTIONS = np.random.default_rng(0).integers(0, 16, (LIMIT, NUM_ENVS))

    def test_the_same_environments_end_alike_as_arrays_and_as_tensors_or_are_an_error(self):
        ends = run_episodes(SmartSurfaceVectorEnv(**SIZE), self.ACTIONS, seed=3)
        assert ends.position.any(axis=1).all()
        found = compare(run_episodes(StandIn("NextStep"), self.ACTIONS, seed=3), ends)
        assert (found.apart, found.other_outcomes, found.other_lengths) == (0, 0, 0)
        assert found.largest == 0.0
        with pytest.raises(ValueError, match="got 1: 4 environments have not ended"):
            run_episodes(StandIn("NextStep"), self.ACTIONS[:1], seed=3)

    def test_distances_and_other_outcomes_are_counted(self):
        ends = Ends(np.zeros((4, 2)), np.array(["success"] * 4), np.full(4, 9))
        position = np.array([[0.0, 5e-9], [0.0, 3e-8], [4.0, 3.0], [0.0, 0.0]])
        outcome = np.array(["success", "success", "stalled", "success"])
        found = compare(replace(ends, position=position, outcome=outcome), ends)
        assert (found.num_envs, found.apart, found.other_outcomes) == (4, 2, 1)
        assert found.largest == 3e-8
        assert found.median == pytest.approx(1.75e-8)


@pytest.fixture
def results():
    return Results(
        "a machine",
        rates=[
            Rate(cpu_name(SMALL, 1), 8, 100.0, 5.0, 0.1),
            Rate(cpu_name("Sort", 1), 8, 50.0, 5.0, 0.1),
            Rate(gpu_name(SMALL), 1024, 2e4, 9.0, 30.0),
            Rate(gpu_name(SMALL), 4096, 3e4, 9.0, 30.0),
            Rate("another", 4096, 7.0, 0.0, 1.0),
        ],
        resets=[ResetCost(gpu_name(SMALL), 4096, 0.25, 1e6, 2.0)],
    )


class TestResults:
    def test_each_task_is_compared_to_one_core_at_the_best_number(self, results):
        assert [results.over_core(rate) for rate in results.rates] == [1.0, 1.0, 200.0, 300.0, None]
        best, ratio = results.figures()
        assert (best.value, best.least) == (3e4, 40e6)
        assert (ratio.value, ratio.least) == (300.0, 150.0)
        assert "4,096 environments" in best.name

    def test_results_are_written_printed_and_plotted(self, results, tmp_path):
        results.write(tmp_path / "gpu.json")
        data = json.loads((tmp_path / "gpu.json").read_text(encoding="utf-8"))
        assert data["rates"][3]["decisions"] == 3e4
        assert len(data["figures"]) == 2
        console = Console(width=200)
        with console.capture() as capture:
            console.print(results.table())
        assert [word in capture.get() for word in ("300 x", "25 %", "2 s")] == [True] * 3
        plot_rates(results.rates, tmp_path / "gpu.png")
        assert (tmp_path / "gpu.png").stat().st_size > 0


class TestCommand:
    @pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
    def test_a_missing_gpu_is_an_error(self):
        with pytest.raises(SystemExit, match=r"^error: device='cuda' needs .*$"):
            main(["--device", "cuda"])

    def test_nothing_is_measured_without_a_device(self, monkeypatch):
        monkeypatch.setattr(cli, "check_device", Mock(side_effect=DeviceMissing("no GPU")))
        monkeypatch.setattr(cli, "list_jobs", lambda *_: pytest.fail("measures"))
        with pytest.raises(DeviceMissing):
            cli.measure_device((4,), True, None, None, QUIET)
        for num_envs in ((), (4, 0)):
            with pytest.raises(ValueError, match="num_envs must be positive numbers, one at least"):
                cli.measure_device(num_envs, True, None, None, QUIET)

    def test_a_package_that_is_not_installed_is_left_out_by_name(self, monkeypatch):
        monkeypatch.setattr(cli, "GYMNAX", False)
        monkeypatch.setattr(cli, "MUJOCO_WARP", False)
        results = Results("a machine")
        for job in cli.list_jobs((4,), beside=True):
            if not job.ours:
                job.run(results)
        assert results.left_out == ["not installed: gymnax", "not installed: mujoco-warp"]
        assert all(job.ours for job in cli.list_jobs((4,), beside=False))

    def test_a_failure_is_reported_and_the_rest_is_written(self, monkeypatch, tmp_path):
        def measure(results: Results) -> None:
            results.rates.append(Rate("measured", 4, 1.0, 0.0, 0.0))

        fail = Mock(side_effect=MemoryError("too many environments"))
        jobs = [cli.Job("theirs", fail, ours=False), cli.Job("ours", fail), cli.Job("ok", measure)]
        monkeypatch.setattr(cli, "check_device", lambda: None)
        monkeypatch.setattr(cli, "describe_machine", lambda: "a machine")
        monkeypatch.setattr(cli, "list_jobs", lambda *_: jobs)
        file = tmp_path / "gpu.json"
        with pytest.raises(NotMeasured, match=r"^ours: MemoryError: too many environments$"):
            cli.measure_device((4,), True, file, None, QUIET)
        data = json.loads(file.read_text(encoding="utf-8"))
        assert data["left_out"] == ["theirs: MemoryError: too many environments"]
        assert [rate["name"] for rate in data["rates"]] == ["measured"]
