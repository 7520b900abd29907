"""Cells made by hand."""

from collections.abc import Sequence

import numpy as np

from agents.evaluation.cell import Cell
from agents.evaluation.trials import PARCELS, SIDES, SORT_SPEEDS

GRID = (len(PARCELS), len(SORT_SPEEDS), len(SIDES))


def sort_cell(
    name: str, least: dict[str, float], time: float = 1.0, seed: int = 0, condition: str = "exact"
) -> Cell:
    """One that sorts from a speed on, by parcel, in a time over the speed."""
    sorts = np.zeros(GRID, bool)
    for k, parcel in enumerate(PARCELS):
        sorts[k] = (least[parcel] - 1e-9 <= SORT_SPEEDS)[:, np.newaxis]
    times = np.broadcast_to((time / SORT_SPEEDS)[:, np.newaxis], GRID)
    count = sorts.size
    return Cell(
        "sort", name, condition, seed, sorts.ravel().tolist(), times.ravel().tolist(), [4] * count,
        {}, 1e-5,
    )  # fmt: skip


def slow_cell(name: str, errors: Sequence[float], seed: int = 0, condition: str = "exact") -> Cell:
    """One that leaves at errors of the ratio."""
    success = [abs(error) <= 0.01 for error in errors]
    count = len(success)
    return Cell(
        "slow", name, condition, seed, success, [1.0] * count, [0] * count,
        {"ratio_error": list(errors)}, 2e-5,
    )  # fmt: skip
