"""What cells come to: minimum speeds, times beside the fixed layout, medians."""

import math

import numpy as np
import pytest

from agents.evaluation.sorting import (
    minimum_speed,
    parcels_an_hour,
    share_sorted,
    slower_time,
    touched,
    worst_time,
)
from agents.evaluation.summary import Summary, summarise
from agents.evaluation.trials import SORT_SPEEDS
from tests.agents.evaluation.cells import GRID, slow_cell, sort_cell

FIXED = Summary((sort_cell("fixed layout", {"S": 0.72, "B": 1.0}),))


def test_the_minimum_is_that_of_the_worst_seed() -> None:
    two = Summary(
        (sort_cell("a", {"S": 0.36, "B": 0.52}), sort_cell("a", {"S": 0.4, "B": 0.52}, seed=1))
    )
    assert (minimum_speed(two, "S"), minimum_speed(two, "B")) == (0.4, 0.52)


def test_one_failure_above_moves_the_minimum_beyond_it() -> None:
    cell = sort_cell("a", {"S": 0.36, "B": 0.52})
    success = np.array(cell.success).reshape(GRID)
    success[0, 60, 1] = False  # the S-box at 1.5 m/s, to y < 0
    holed = Summary((cell.__class__(**{**cell.plain(), "success": success.ravel().tolist()}),))
    assert minimum_speed(holed, "S") == 1.52
    assert minimum_speed(holed, "B") == 0.52
    assert np.isinf(slower_time(holed, "S")[0, 60])
    success[0, -1] = False
    never = Summary((cell.__class__(**{**cell.plain(), "success": success.ravel().tolist()}),))
    assert math.isnan(minimum_speed(never, "S"))


def test_time_is_held_against_the_fixed_layout_where_that_one_sorts() -> None:
    faster = Summary((sort_cell("a", {"S": 0.36, "B": 0.52}, time=0.9),))
    assert worst_time(faster, FIXED, "S") == pytest.approx(0.9)
    less_able = Summary((sort_cell("a", {"S": 1.0, "B": 0.52}),))
    assert worst_time(less_able, FIXED, "S") == np.inf


def test_shares_columns_and_throughput() -> None:
    assert share_sorted(FIXED, "B") == np.mean(SORT_SPEEDS >= 1.0 - 1e-9)
    assert touched(FIXED) == 4.0
    sorted_at = np.concatenate([SORT_SPEEDS[SORT_SPEEDS > 0.71], SORT_SPEEDS[SORT_SPEEDS > 0.99]])
    assert parcels_an_hour(FIXED) == pytest.approx(3600.0 / (1.0 / sorted_at).mean())


def test_cells_of_all_seeds_are_one_summary() -> None:
    cells = [slow_cell("a", [0.001, -0.02], seed=seed) for seed in (0, 1)]
    cells.append(slow_cell("b", [0.0, 0.0]))
    summaries = summarise(cells)
    assert list(summaries) == [("slow", "a", "exact"), ("slow", "b", "exact")]
    first = summaries["slow", "a", "exact"]
    assert first.rate == 0.5
    assert first.success.shape == (2, 2)
    np.testing.assert_array_equal(first.figure("ratio_error"), [[0.001, 0.02]] * 2)
