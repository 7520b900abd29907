"""The board: normalised scores, their intervals, and tables."""

import math
from dataclasses import replace

import numpy as np
from scipy import stats

from surface_gym.agents.benchmark.board import Board, compute_iqm, make_page, score_cells
from surface_gym.agents.benchmark.entry import (
    CELLS,
    EPISODES,
    BenchmarkEntry,
    Row,
    TestCell,
    read_protocol,
)

ZERO, ONE = read_protocol()["references"]["sort"]


def entry(
    name: str, shares: float | dict[str, float], seeds: int = 1, failed: str = ""
) -> BenchmarkEntry:
    """Make an entry whose share of successes in each cell is given."""
    rows = []
    for cell in CELLS:
        share = shares[cell] if isinstance(shares, dict) else shares
        scores = tuple(float(k < round(share * EPISODES)) for k in range(EPISODES))
        for seed in range(seeds):
            rows.append(
                Row("sort", cell, seed, TestCell("sort", cell).digest, {}, scores, scores, 1e-5)
            )
    if failed:
        rows[-1] = replace(rows[-1], scores=(), times=(), failure=failed)
    return BenchmarkEntry(name, tuple(rows))


def test_references_score_zero_and_one_and_others_between() -> None:
    board = Board([entry(ZERO, 0.25), entry(ONE, 0.75), entry("half", 0.5), entry("more", 1.0)])
    scores = [board.score(each, "sort").value for each in board.entries]
    assert scores == [0.0, 1.0, 0.5, 1.5]


def test_an_interval_narrows_with_more_episodes_and_holds_the_score() -> None:
    generator = np.random.default_rng(0)
    few, many = (
        score_cells([generator.random((3, count)) for _ in range(4)], 400) for count in (32, 3200)
    )
    for score in (few, many):
        assert score.low < score.value < score.high
    assert many.high - many.low < 0.3 * (few.high - few.low)


def test_an_interval_covers_the_truth_as_often_as_it_says() -> None:
    generator = np.random.default_rng(1)
    covered = 0
    for _ in range(60):
        score = score_cells([generator.random((1, 64)) for _ in range(4)], 200)
        covered += score.low <= 0.5 <= score.high
    assert 50 <= covered <= 60


def test_the_mean_leaves_out_the_outer_quarters() -> None:
    values = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 700.0])
    assert compute_iqm(values) == 3.5 == stats.trim_mean(values, 0.25)


def test_a_table_ranks_and_names_failures() -> None:
    entries = [
        entry(ZERO, 0.25), entry(ONE, 0.75), entry("seeds", 0.9, 5),
        entry("broken", 0.9, failed="took more than 60 s to decide"),
    ]  # fmt: skip
    table = Board(entries).table("sort")
    assert table is not None
    assert [row[0] for row in table.rows] == ["seeds", ONE, ZERO, "broken"]
    assert table.rows[0][table.header.index("seeds")] == "5"
    assert "failed" in table.rows[-1]
    assert math.isnan(Board(entries).score(entries[-1], "sort").value)
    assert make_page(Board(entries)).count("| seeds |") == 2  # the entry and the column


def test_without_references_there_are_results_but_no_scores() -> None:
    board = Board([entry("alone", 0.9)])
    assert math.isnan(board.score(board.entries[0], "sort").value)
    table = board.table("sort")
    assert table is not None
    assert "0.898" in table.rows[0]


def test_a_page_has_a_table_for_one_parcel_and_one_for_who_entered() -> None:
    mine = replace(entry("mine", 0.5), by="me", source="own.py:Mine", interactions=1_500_000)
    shipped = replace(entry("sort-ppo", 0.5), source="sort-ppo")
    page = make_page(Board([mine, shipped, replace(mine, name="other", rows=())]))
    assert "## One parcel" in page
    assert "## Streams" not in page
    one, two = [line for line in page.splitlines() if " 0.500 |" in line]
    assert one.startswith("| Sort | mine |")
    assert "1.5\u00a0M" in one
    assert two.startswith("|  | sort-ppo |")
    assert "| agent | me | mine: `own.py:Mine`; other: `own.py:Mine` |" in page
    assert "| agent | - | sort-ppo |" in page
