"""Plots of the board by rliable: scores with intervals, and performance profiles.

The board computes the scores and their bootstrap samples. rliable computes metrics from them, and
draws.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ..base import Numbers
from . import TASKS
from .board import Board, find_interval, resample_scores

THRESHOLDS = 101  # points of a performance profile
MOST = 10  # entries in a figure: rliable's palette has as many colours


def compute_profile(scores: Numbers, thresholds: Numbers) -> Numbers:
    """Compute the share (..., thresholds) of scores (..., runs) above each threshold."""
    return np.asarray((scores[..., np.newaxis] > thresholds).mean(axis=-2))


def plot_board(board: Board, folder: Path) -> list[Path]:
    """Draw each task's best entries into TASK-scores.png and TASK-profile.png; return the files.

    A run is a training seed in a cell.

    Raises:
        ModuleNotFoundError: rliable is not installed.
    """
    import matplotlib as mpl

    with mpl.rc_context({"backend": "agg"}):
        return [file for task in TASKS for file in _plot_task(board, task, folder)]


def _plot_task(board: Board, task: str, folder: Path) -> list[Path]:
    from rliable import metrics, plot_utils
    from seaborn import color_palette

    computed = {
        "IQM": metrics.aggregate_iqm,
        "mean": metrics.aggregate_mean,
        "optimality gap": metrics.aggregate_optimality_gap,
    }
    cells = {entry.name: found for entry in board.entries if (found := board.whole(entry, task))}
    if not cells:
        return []
    runs = {
        name: np.concatenate([each.mean(axis=1) for each in found]) for name, found in cells.items()
    }
    names = sorted(cells, key=lambda name: (-metrics.aggregate_iqm(runs[name]), name))[:MOST]
    drawn = {name: resample_scores(cells[name]) for name in names}

    def aggregate(scores: Numbers) -> Numbers:  # (runs, 1): any number of seeds in each cell
        return np.array([compute(scores[:, np.newaxis]) for compute in computed.values()])

    colours = dict(zip(names, color_palette("colorblind", len(names)), strict=True))
    points = {name: aggregate(runs[name]) for name in names}
    intervals = {name: find_interval([aggregate(each) for each in drawn[name]]) for name in names}
    figure, _ = plot_utils.plot_interval_estimates(
        points, intervals, list(computed), names[::-1], colours, xlabel="score",
        xlabel_y_coordinate=-1.2 / len(names),
    )  # fmt: skip
    files = [_save(figure, folder / f"{task}-scores.png")]
    every = np.concatenate(list(runs.values()))
    thresholds = np.linspace(min(0.0, every.min()) - 0.05, every.max() + 0.05, THRESHOLDS)
    axes = plot_utils.plot_performance_profiles(
        {name: compute_profile(runs[name], thresholds) for name in names}, thresholds,
        {name: find_interval(compute_profile(drawn[name], thresholds)) for name in names},
        colors=colours, figsize=(7, 4), xlabel="score", ylabel="share of runs above", legend=True,
    )  # fmt: skip
    return [*files, _save(axes.figure, folder / f"{task}-profile.png")]


def _save(figure: Any, file: Path) -> Path:
    from matplotlib import pyplot as plt

    figure.savefig(file, dpi=100, bbox_inches="tight")
    plt.close(figure)
    return file
