"""`evaluate.py` from results that are there already to its folder, and on a run of streams."""

import io
import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from shutil import copytree
from typing import Any

import imageio.v2 as imageio
import pytest
from rich.console import Console

from surface_gym.agents.evaluation import capacity, report, streams
from surface_gym.agents.evaluation.capacity import Case
from surface_gym.agents.evaluation.cli import TASK_NAMES, EvaluateConfig, evaluate
from surface_gym.agents.evaluation.methods import rules
from surface_gym.agents.evaluation.report import evaluate_run, is_of_streams
from surface_gym.agents.evaluation.robustness import FILE as SWEPT
from surface_gym.agents.evaluation.streams import BOUND, RESERVATION, StreamResults
from surface_gym.agents.library import SHELF
from surface_gym.registration import FLOW_TASK
from surface_gym.tasks import TASKS
from tests.agents.evaluation.made import RULES, STARTS, stream_results, stream_rows, sweep_results


def keep(rows: Sequence[Any], file: Path) -> list[str]:
    lines = [json.dumps(asdict(row)) + "\n" for row in rows]
    file.write_text("".join(lines))
    return lines


class TestConfig:
    def test_streams_are_compared_first_unless_asked_otherwise(self) -> None:
        assert EvaluateConfig().tasks == TASK_NAMES == (FLOW_TASK, *TASKS)

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"tasks": ("juggle",)}, "tasks must be one of 'flow', .*, got 'juggle'"),
            ({"starts": 0}, "^starts must be .* at least 1, got 0"),
            (
                {"robustness": True, "run": Path("runs/a")},
                "^run must be None where robustness is swept, got runs",
            ),
        ],
    )
    def test_errors(self, given, message) -> None:
        with pytest.raises(ValueError, match=message):
            EvaluateConfig(**given)


def test_results_of_streams_become_a_page(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(streams, "stream_methods", lambda: RULES)
    monkeypatch.setattr(StreamResults, "of", lambda *_: stream_results())
    monkeypatch.setattr(report, "FILMED", 0.4)
    monkeypatch.setattr(report, "SHOWN_AT", 0.2)
    lines = keep(stream_rows(), tmp_path / streams.FILE)
    screen = io.StringIO()
    config = EvaluateConfig(out=tmp_path, tasks=(FLOW_TASK,), workers=1, resume=True)
    evaluate(config, Console(file=screen, width=160))
    assert "reservation" in screen.getvalue()
    page = (tmp_path / "report.html").read_text()
    assert '<a href="#flow">Flow</a>' in page
    assert "Flow: over event rule" in page
    assert "data:video/mp4;base64," in page
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert not (tmp_path / "comparison.md").exists()
    kept = (tmp_path / streams.FILE).read_text().splitlines()
    assert list(map(json.loads, kept)) == list(map(json.loads, lines))
    text = (tmp_path / "flow.md").read_text()
    assert all(f"## {each.heading}" in text for each in streams.stream_tables(stream_results()))
    count = len(streams.stream_numbers(stream_results()))
    assert len((tmp_path / "flow.csv").read_text().splitlines()) == count + 1
    for name in ("flow-capacity.png", "flow-rate.png", "flow.png"):
        assert imageio.imread(tmp_path / name).std() > 10.0  # there is something on it
    with imageio.get_reader(tmp_path / "flow.mp4") as video:
        assert video.count_frames() == 10 + 25
        assert video.get_data(0).shape[0] > 2 * imageio.imread(tmp_path / "flow.png").shape[0]


def test_a_sweep_becomes_tables(tmp_path, monkeypatch) -> None:
    fixed = rules("slow")[:1]
    monkeypatch.setattr("surface_gym.agents.evaluation.methods.all_methods", lambda _: fixed)
    keep(sweep_results("slow", {"fixed layout": 0.5}), tmp_path / SWEPT)
    screen = io.StringIO()
    config = EvaluateConfig(
        out=tmp_path, tasks=("slow",), workers=1, resume=True, robustness=True, starts=STARTS
    )
    evaluate(config, Console(file=screen, width=160))
    assert "fixed layout" in screen.getvalue()
    assert (tmp_path / "robustness.csv").is_file()
    assert not (tmp_path / "comparison.md").exists()


class TestARunOfStreams:
    @pytest.fixture(autouse=True)
    def small(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(streams, "cases", lambda preset="exact": [Case("S", 2.0, preset)])
        monkeypatch.setattr(streams, "CURVE", Case("S", 2.0))
        monkeypatch.setattr(capacity, "REPLICATIONS", 2)
        monkeypatch.setattr(capacity, "WARM_UP", 4.0)
        monkeypatch.setattr(capacity, "SECONDS", 12.0)

    def test_every_seed_is_measured_beside_the_reservation(self, tmp_path, monkeypatch) -> None:
        for seed in (0, 1):
            copytree(SHELF / "flow-ppo" / f"seed-{seed}", tmp_path / f"seed-{seed}")
        seen: list[StreamResults] = []
        compare = report.compare_streams

        def watched(*given: Any) -> StreamResults:
            seen.append(compare(*given))
            return seen[0]

        monkeypatch.setattr(report, "compare_streams", watched)
        card = evaluate_run(tmp_path, None, 1, Console(quiet=True))
        (found,), case = seen, Case("S", 2.0)
        assert set(found.names) == {RESERVATION, "seed 0", "seed 1"}
        for name in found.names:
            assert found.rate(name, case) > 0.7 * found.rate(BOUND, case)
        assert "seed 1" in (tmp_path / report.TABLE).read_text()
        for preset in ("exact", "camera"):
            (stream,) = card[preset].values()
            assert len(stream["capacity_of_each_seed"]) == 2
            assert min(stream["right_at_80_percent"]) > 0.99

    @pytest.mark.parametrize("text", ["", "[1", "env_id: SmartSurface/Sort-v0", "- a"])
    def test_other_runs(self, tmp_path, text) -> None:
        (tmp_path / "policy.yaml").write_text(text)
        assert not is_of_streams(tmp_path)
        empty = tmp_path / "empty"
        empty.mkdir()
        assert not is_of_streams(empty)
