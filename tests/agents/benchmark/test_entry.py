"""The protocol's cells and starts; entries, their files, and how a policy becomes rows."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surface_gym.agents import library
from surface_gym.agents.benchmark.entry import (
    CELLS,
    EPISODES,
    STREAMS,
    TASKS,
    BenchmarkEntry,
    Row,
    TestCell,
    digest_source,
    keep_rows,
    make_jobs,
    play_cell,
    read_entries,
    read_entry,
    read_protocol,
    write_entry,
)
from surface_gym.agents.benchmark.process import PolicyLimits, PolicyProcess
from surface_gym.agents.rollout import run_episodes
from surface_gym.registration import SHIPPED

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


def test_tasks_are_run_one_after_the_other(tmp_path: Path) -> None:
    file, own = tmp_path / "mine.json", tmp_path / "own.py"
    own.write_text("class Mine: pass")
    source = f"{own}:Mine"
    rows = tuple(replace(row, source_digest=digest_source(source)) for row in ENTRY.rows)
    entry, empty = replace(ENTRY, rows=rows), replace(ENTRY, rows=())
    again, other = (make_jobs(source, (t,), (0,), {}, PolicyLimits()) for t in ("sort", "stop"))
    assert keep_rows(empty, file, source, other) == empty
    write_entry(entry, file)
    assert keep_rows(empty, file, source, other) == entry
    assert keep_rows(empty, file, source, again) == empty
    for change in ({"source": "another.py:Mine"}, {"version": "0.0.1"}):
        changed = replace(empty, **change)
        assert keep_rows(changed, file, source, other) == changed
    own.write_text("class Mine: ...")
    assert keep_rows(empty, file, source, other) == empty
    own.unlink()  # nothing tells that the policy has changed
    assert keep_rows(empty, file, source, other) == entry


@pytest.mark.parametrize(("source", "kept"), [("own.py:Mine", "abc"), ("own-{task}.zip", "")])
def test_a_file_with_one_digest_for_all_rows_is_read(
    tmp_path: Path, source: str, kept: str
) -> None:
    file = tmp_path / "mine.json"
    write_entry(replace(ENTRY, source=source), file)
    old = json.loads(file.read_text()) | {"source_digest": "abc"}
    for row in old["rows"]:
        del row["source_digest"]
    file.write_text(json.dumps(old))
    assert {row.source_digest for row in read_entry(file).rows} == {kept}


def test_a_stream_has_fewer_episodes() -> None:
    flow = replace(ROW, task="flow", scores=SCORES[:STREAMS], times=SCORES[:STREAMS])
    assert len(flow.scores) == TestCell("flow", "lab").episodes < EPISODES
    with pytest.raises(ValueError, match=f"scores must have {STREAMS} numbers"):
        replace(ROW, task="flow")


def test_two_entries_of_a_name_are_refused(tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        write_entry(ENTRY, tmp_path / name)
    with pytest.raises(ValueError, match="unique on the board, got 'mine' twice"):
        read_entries(tmp_path)


def test_a_shipped_agent_runs_in_all_its_seeds_and_every_cell() -> None:
    jobs = make_jobs("sort-ppo", ("sort",), (), {}, PolicyLimits())
    assert [job.seed for job in jobs] == list(library.seeds("sort-ppo"))
    assert [test.cell for test in jobs[0].tests] == list(CELLS)
    jobs = make_jobs("runs/{task}-{seed}.zip", ("sort", "stop"), (6, 7), {}, PolicyLimits())
    assert [job.source for job in jobs] == [
        f"runs/{task}-{seed}.zip" for task in ("sort", "stop") for seed in (6, 7)
    ]


def test_a_digest_follows_the_content_of_a_policy(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text("class Mine: pass")
    before = digest_source(f"{file}:Mine")
    assert before == digest_source(f"{file}:Mine")
    file.write_text("class Mine: ...")
    assert digest_source(f"{file}:Mine") != before
    assert digest_source("sort-ppo") == ""


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


def test_every_cell_has_a_digest_and_seeds_of_its_own() -> None:
    digests = read_protocol()["digests"]
    assert list(digests) == list(TASKS)
    assert set(TASKS) == set(SHIPPED)
    assert all(list(cells) == list(CELLS) for cells in digests.values())
    cells = [TestCell(task, cell) for task in TASKS for cell in CELLS]
    starts = {(cell.task, CELLS[cell.cell].name): cell for cell in cells}
    assert len({cell.digest for cell in cells}) == len(starts)  # cells of a preset share starts
    seeds = {cell.seed + k for cell in starts.values() for k in range(EPISODES)}
    assert len(seeds) == EPISODES * len(starts)


@pytest.mark.parametrize("cell", ["0 ms", "lab"])
def test_starts_are_those_of_the_protocol_whatever_a_policy_chooses(cell: str) -> None:
    test = TestCell("sort", cell)
    config = test.config({"actions": "halves", "control_period": 0.08})
    assert test.compute_digest(config) == test.digest
    assert test.periods(config) == 50  # 4 s, as with the default period


def test_another_start_has_another_digest() -> None:
    first, second = TestCell("sort", "0 ms"), TestCell("sort", "lab")
    config = first.config({"actions": "halves"})
    assert first.compute_digest(config, 4) != second.compute_digest(config, 4)


def test_slower_axes_are_set_by_the_cell() -> None:
    speeds = [TestCell("stop", cell).config({}).actuators.axis_speed for cell in CELLS]
    assert speeds[0] == float("inf")
    assert speeds[1] == pytest.approx(2.0 * speeds[2])


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"zone": (4, 5)}, "env_kwargs must be one of 'actions', .* got 'zone'"),
        ({"actions": "thirds"}, "actions must be .* got 'thirds'"),
        ({"gate": True}, "unexpected keyword argument 'gate'"),
    ],
)
def test_what_a_policy_must_not_choose_is_named(chosen: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TestCell("sort", "0 ms").config(chosen)
