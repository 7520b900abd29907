"""The entries of the board: they are read, and a sample of each is run again."""

from pathlib import Path

import numpy as np
import pytest

from surface_gym.agents.benchmark.board import Board, make_page
from surface_gym.agents.benchmark.entry import (
    CELLS,
    TestCell,
    make_jobs,
    play_cell,
    read_entries,
    read_protocol,
)
from surface_gym.agents.benchmark.process import PolicyLimits, PolicyProcess

ROOT = Path(__file__).parents[3]
RESULTS = ROOT / "benchmarks/results"
# Weights of entries that are not in the repository.
TRAINED = {
    "behaviour cloning": "bc-{seed}.pt",
    "cleanrl-ppo": "cleanrl-{seed}.pt",
    "d3rlpy-cql": "cql-{seed}.pt",
    "ppo-1m": "runs/ppo-1m-{task}-{seed}.zip",
}
ENTRIES = {entry.name: entry for entry in read_entries(RESULTS)}
MEASURED = [
    (task, name)
    for name, entry in ENTRIES.items()
    for task in dict.fromkeys(row.task for row in entry.rows)
]
SAMPLE = 6  # episodes


def test_references_are_there_and_results_are_small() -> None:
    references = read_protocol()["references"]
    found = Board(list(ENTRIES.values())).references
    measured = {row.task for entry in ENTRIES.values() for row in entry.rows}
    for task in measured:
        assert set(references[task]) <= set(ENTRIES)
        assert [cell for cell in CELLS if (task, cell) not in found] == []
    assert sum(file.stat().st_size for file in RESULTS.glob("*.json")) <= 1_000_000


def test_the_board_of_the_documentation_shows_them() -> None:
    board = Board(read_entries(RESULTS))
    assert (ROOT / "docs/board.md").read_text() == make_page(board)


@pytest.mark.parametrize(("task", "name"), MEASURED)
def test_a_sample_comes_out_the_same(task: str, name: str) -> None:
    entry = ENTRIES[name]
    row = next(row for row in entry.rows if row.task == task and not row.failure)
    trained = TRAINED.get(name, "").format(task=task, seed=row.seed)
    if not (ROOT / trained).exists():
        pytest.skip(f"there is no {trained}: the entry's file says how to train it")
    test = TestCell(row.task, row.cell)
    assert row.digest == test.digest
    source = entry.source
    if ":" in source:
        source = str(ROOT / "examples/entries" / source)
    elif trained:
        source = str(ROOT / trained)
    (job, *_) = make_jobs(source, (row.task,), (row.seed,), {}, PolicyLimits())
    with PolicyProcess(job.source) as policy:
        policy.env_kwargs(row.task, CELLS[row.cell].name)
        scores, times = play_cell(test, policy, row.seed, dict(row.env_kwargs), SAMPLE)
    np.testing.assert_array_equal(scores, row.scores[:SAMPLE])
    np.testing.assert_array_equal(times, row.times[:SAMPLE])
