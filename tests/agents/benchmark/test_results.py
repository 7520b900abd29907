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
TRAINED = {"behaviour cloning": "bc-0.pt", "cleanrl-ppo": "cleanrl-0.pt", "d3rlpy-cql": "cql-0.pt"}
ENTRIES = {entry.name: entry for entry in read_entries(RESULTS)}
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


@pytest.mark.parametrize("name", ENTRIES)
def test_a_sample_comes_out_the_same(name: str) -> None:
    entry = ENTRIES[name]
    if name in TRAINED and not (ROOT / TRAINED[name]).is_file():
        pytest.skip(f"there is no {TRAINED[name]}: the entry's file says how to train it")
    row = next(row for row in entry.rows if not row.failure)
    test = TestCell(row.task, row.cell)
    assert row.digest == test.digest
    source = entry.source
    if ":" in source:
        source = str(ROOT / "examples/entries" / source)
    (job, *_) = make_jobs(source, (row.task,), (row.seed,), {}, PolicyLimits())
    with PolicyProcess(job.source) as policy:
        policy.env_kwargs(row.task, CELLS[row.cell].name)
        scores, times = play_cell(test, policy, row.seed, dict(row.env_kwargs), SAMPLE)
    np.testing.assert_array_equal(scores, row.scores[:SAMPLE])
    np.testing.assert_array_equal(times, row.times[:SAMPLE])
