"""What is asked of sorting alone: by entry speed, and beside the fixed layout."""

import numpy as np
from numpy.typing import NDArray

from .summary import Summary
from .trials import PARCELS, SIDES, SORT_SPEEDS

Numbers = NDArray[np.float64]
GRID = (len(PARCELS), len(SORT_SPEEDS), len(SIDES))  # of Sort's starts


def sorted_by_speed(summary: Summary, parcel: str) -> NDArray[np.bool_]:
    """(seeds, speeds) whether a box was sorted to both sides."""
    grid = summary.success.reshape(-1, *GRID)[:, PARCELS.index(parcel)]
    return np.asarray(grid.all(axis=-1))


def slower_time(summary: Summary, parcel: str) -> Numbers:
    """(seeds, speeds) [s] to sort to the slower side; inf where it was not sorted."""
    grid = np.where(summary.success, summary.time, np.inf).reshape(-1, *GRID)
    slower: Numbers = grid[:, PARCELS.index(parcel)].max(axis=-1)
    return slower


def minimum_speed(summary: Summary, parcel: str) -> float:
    """[m/s] from which on every start of every seed is sorted; nan if the fastest is not."""
    fails = np.nonzero(~sorted_by_speed(summary, parcel).all(axis=0))[0]
    first = 0 if len(fails) == 0 else int(fails[-1]) + 1
    return float(SORT_SPEEDS[first]) if first < len(SORT_SPEEDS) else float("nan")


def worst_time(summary: Summary, fixed: Summary, parcel: str) -> float:
    """[-] greatest time over the fixed layout's, at the speeds that one sorts at."""
    theirs = slower_time(fixed, parcel)[0]
    managed = np.isfinite(theirs)
    return float((slower_time(summary, parcel)[:, managed] / theirs[managed]).max())


def parcels_an_hour(summary: Summary) -> float:
    """[1/h] one after the other, each on the surface alone: by the mean time of those sorted."""
    return 3600.0 / float(summary.time[summary.success].mean()) if summary.rate else float("nan")


def touched(summary: Summary) -> float:
    """Columns that a parcel sorted touched, on average."""
    return float(summary.columns[summary.success].mean()) if summary.rate else float("nan")


def share_sorted(summary: Summary, parcel: str) -> float:
    """[-] of one box's starts."""
    return float(summary.success.reshape(-1, *GRID)[:, PARCELS.index(parcel)].mean())
