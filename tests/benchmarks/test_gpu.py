"""The GPU's benchmark as a command: what it needs, what it tells and what it writes."""

import json
import sys
from pathlib import Path

import pytest
import torch
from rich.console import Console

from benchmarks.command import main
from benchmarks.gpu import command, measuring
from benchmarks.gpu.measuring import Job, jobs
from benchmarks.gpu.picture import draw
from benchmarks.gpu.resets import Resets
from benchmarks.gpu.results import SMALL, Results, on_cpu, on_gpu
from benchmarks.gpu.windows import Rate
from surface_gym.cuda.env import DeviceMissing


class TestWithoutAGpu:
    @pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
    def test_the_command_says_what_is_missing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sys, "argv", ["benchmarks", "--device", "cuda"])
        with pytest.raises(SystemExit, match=r"^error: device='cuda' needs .*$"):
            main()

    def test_nothing_is_measured_before(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def check() -> None:
            raise DeviceMissing("no GPU")

        monkeypatch.setattr(command, "check_device", check)
        monkeypatch.setattr(measuring, "jobs", lambda *_: pytest.fail("measures"))
        with pytest.raises(DeviceMissing):
            command.measure_device((4,), True, None, None, Console(quiet=True))

    @pytest.mark.parametrize("lanes", [(), (4, 0)])
    def test_lanes_must_be_numbers(self, lanes: tuple[int, ...]) -> None:
        with pytest.raises(ValueError, match="lanes must be positive numbers, one at least"):
            command.measure_device(lanes, True, None, None, Console(quiet=True))


def results() -> Results:
    found = Results("a machine")
    found.rates = [
        Rate(on_cpu(SMALL, 1), 8, 100.0, 5.0, 0.1),
        Rate(on_cpu("Sort", 1), 8, 50.0, 5.0, 0.1),
        Rate(on_gpu(SMALL), 1024, 2e4, 9.0, 30.0),
        Rate(on_gpu(SMALL), 4096, 3e4, 9.0, 30.0),
        Rate("another's", 4096, 7.0, 0.0, 1.0),
    ]
    found.resets = [Resets(on_gpu(SMALL), 4096, 0.25, 1e6, 2.0)]
    return found


class TestResults:
    def test_each_task_is_held_against_one_core_of_its_own(self) -> None:
        found = results()
        assert [found.over_core(rate) for rate in found.rates] == [1.0, 1.0, 200.0, 300.0, None]

    def test_the_best_number_of_lanes_counts(self) -> None:
        best, ratio = results().figures()
        assert (best.value, best.least) == (3e4, 40e6)
        assert (ratio.value, ratio.least) == (300.0, 150.0)
        assert "4,096 lanes" in best.name

    def test_all_is_written_printed_and_drawn(self, tmp_path: Path) -> None:
        found = results()
        found.write(tmp_path / "gpu.json")
        data = json.loads((tmp_path / "gpu.json").read_text(encoding="utf-8"))
        assert data["rates"][3]["decisions"] == 3e4
        assert len(data["figures"]) == 2
        console = Console(width=200)
        with console.capture() as capture:
            console.print(found.table())
        assert [word in capture.get() for word in ("300 x", "25 %", "2 s")] == [True] * 3
        draw(found.rates, tmp_path / "gpu.png")
        assert (tmp_path / "gpu.png").stat().st_size > 0


class TestJobs:
    def test_a_package_that_is_not_installed_is_left_out_with_its_name(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(measuring, "GYMNAX", False)
        monkeypatch.setattr(measuring, "MUJOCO_WARP", False)
        found = Results("a machine")
        for job in jobs((4,), beside=True):
            if not job.ours:
                job.run(found)
        assert found.left_out == ["not installed: gymnax", "not installed: mujoco-warp"]
        assert all(job.ours for job in jobs((4,), beside=False))

    def test_what_fails_is_told_and_the_rest_is_written(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        def fail(_: Results) -> None:
            raise MemoryError("too many lanes")

        def measure(found: Results) -> None:
            found.rates.append(Rate("measured", 4, 1.0, 0.0, 0.0))

        made = [Job("theirs", fail, ours=False), Job("ours", fail), Job("good", measure)]
        monkeypatch.setattr(command, "check_device", lambda: None)
        monkeypatch.setattr(measuring, "machine", lambda: "a machine")
        monkeypatch.setattr(measuring, "jobs", lambda *_: made)
        file = tmp_path / "gpu.json"
        with pytest.raises(command.NotMeasured, match=r"^ours: MemoryError: too many lanes$"):
            command.measure_device((4,), True, file, None, Console(quiet=True))
        data = json.loads(file.read_text(encoding="utf-8"))
        assert data["left_out"] == ["theirs: MemoryError: too many lanes"]
        assert [rate["name"] for rate in data["rates"]] == ["measured"]
