"""Entries: their files, and how a policy becomes rows."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surface_gym.agents import library
from surface_gym.agents.benchmark.entry import (
    BenchmarkEntry,
    Row,
    digest_source,
    make_jobs,
    play_cell,
    read_entries,
    read_entry,
    write_entry,
)
from surface_gym.agents.benchmark.process import PolicyLimits, PolicyProcess
from surface_gym.agents.benchmark.protocol import CELLS, EPISODES, TestCell
from surface_gym.agents.rollout import run_episodes

TEST = TestCell("sort", "0 ms")
SCORES = tuple(float(k % 2) for k in range(EPISODES))
ROW = Row("sort", "0 ms", 0, TEST.digest, {"actions": "halves"}, SCORES, SCORES, 1e-5)
FAILED = Row("sort", "lab", 0, TEST.digest, {}, (), (), 0.0, "took more than 60 s to decide")
ENTRY = BenchmarkEntry("mine", (ROW, FAILED), by="me", interactions=1_000_000, source="own.py:Mine")


def test_a_file_holds_everything_and_a_line_per_row(tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    write_entry(ENTRY, file)
    assert read_entry(file) == ENTRY
    assert len(file.read_text().splitlines()) < 20
    assert read_entries(tmp_path) == [ENTRY]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"protocol": 2}, "protocol must be one of 1, got 2"),
        ({"kind": "magic"}, "kind must be one of 'baseline', .* got 'magic'"),
        ({"name": ""}, "name must not be empty"),
        ({"by": "x" * 300}, "by must be a text of at most 200"),
        ({"rows": [7]}, "holds no entry"),
        ({"more": 1}, "holds no entry.*more"),
    ],
)
def test_a_file_with_something_else_is_refused(tmp_path: Path, change: dict, message: str) -> None:
    file = tmp_path / "mine.json"
    write_entry(ENTRY, file)
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(ValueError, match=message):
        read_entry(file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scores": (0.5,) * 3}, f"scores must have {EPISODES} numbers"),
        ({"scores": (2.0,) * EPISODES}, "scores must be .* got 2.0"),
        ({"times": (float("nan"),) * EPISODES}, "times must be .* got nan"),
        ({"scores": ()}, "or none with a failure"),
        ({"cell": "50 ms"}, "cell must be one of '0 ms'"),
    ],
)
def test_a_row_with_other_numbers_is_refused(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(ROW, **change)


def test_two_entries_of_a_name_are_refused(tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        write_entry(ENTRY, tmp_path / name)
    with pytest.raises(ValueError, match="unique on the board, got 'mine' twice"):
        read_entries(tmp_path)


def test_a_shipped_agent_runs_in_all_its_seeds_and_every_cell() -> None:
    jobs = make_jobs("sort-ppo", ("sort",), (), {}, PolicyLimits())
    assert [job.seed for job in jobs] == list(library.seeds("sort-ppo"))
    assert [test.cell for test in jobs[0].tests] == list(CELLS)
    assert "runs/7.zip" in [
        job.source for job in make_jobs("runs/{seed}.zip", ("sort",), (6, 7), {}, PolicyLimits())
    ]


def test_a_digest_follows_the_content_of_a_policy(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text("class Mine: pass")
    before = digest_source([f"{file}:Mine"])
    assert before == digest_source([f"{file}:Mine"])
    file.write_text("class Mine: ...")
    assert digest_source([f"{file}:Mine"]) != before
    assert digest_source(["sort-ppo"]) == ""


def test_results_are_those_of_the_policy_in_this_process() -> None:
    (first, *_) = make_jobs("sort-ppo", ("sort",), (), {}, PolicyLimits())
    with PolicyProcess(first.source) as process:
        kwargs = process.env_kwargs("sort", "exact")
        scores, times = play_cell(TEST, process, first.seed, kwargs, 16)
    config = TEST.config(kwargs)
    policy = library.load("sort-ppo", first.seed)
    episodes = run_episodes(policy, config, [{}] * 16, TEST.seed)
    np.testing.assert_array_equal(scores, episodes.success)
    np.testing.assert_allclose(times, episodes.time, atol=1e-3)
    assert 0.0 < process.decided < 60.0
