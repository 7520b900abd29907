"""The board: scores and plots of all entries; an entry holds the results of one policy.

A cell is a set of test episodes of a task. Results are normalised by cell: score 0 is the mean
result of the task's fixed layout, and score 1 is the mean result of the best rule. The fixed layout
and the best rule are entries, too; the protocol's file names them. The board ranks entries by the
interquartile mean (IQM) of their scores over training seeds and cells. The 95 % interval comes from
a stratified bootstrap over seeds and episodes, as Agarwal et al. (2021) recommend. The library
rliable draws scores and intervals.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from surface_gym.registration import PERIODS

from ..base import Integers, Numbers
from ..evaluation.tables import NOTHING, Table, number
from . import TASKS
from .entry import CELLS, BenchmarkEntry, Row, read_protocol

RESAMPLES = 2000
CONFIDENCE = 0.95
TRIMMED = 0.25  # [-] share cut off at both ends for the interquartile mean
SEED = 1
TITLE = """# The board

Results of all entries of [the benchmark](benchmark.md), best first. Made by
`surface-gym benchmark table` from the entries' files in `benchmarks/results/`.

The columns from "0 ms" to "lab" are the [test conditions](benchmark.md#what-is-measured). They \
show success rates; on streams they show correct deliveries per hour at the task's default rate of \
arrivals (Flow: 1200 per hour). The score is the interquartile mean with its 95 % interval: in \
each condition "{zero}" scores 0 and "{one}" scores 1. Training periods are counted per seed. The \
decision time is the mean time per environment if a policy decides for many at once."""


@dataclass(frozen=True)
class Score:
    """A score with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if math.isnan(self.value):
            return NOTHING
        value = round(self.value, 2) + 0.0  # no negative zero
        # Spaces that do not break keep a row of the page on one line.
        return f"{value:.2f} ({self.low:.2f} to {self.high:.2f})".replace(" ", "\u00a0")


def compute_iqm(scores: Numbers) -> float:
    """Compute the interquartile mean of scores of any shape."""
    return float(stats.trim_mean(scores.ravel(), TRIMMED))


def score_cells(cells: Sequence[Numbers], resamples: int = RESAMPLES) -> Score:
    """Compute the interquartile mean over seeds and cells, with an interval from a bootstrap.

    Args:
        cells: normalised results (seeds, episodes) of each cell.
        resamples: number of bootstrap samples.
    """
    iqm = compute_iqm(np.concatenate([each.mean(axis=1) for each in cells]))
    drawn = stats.trim_mean(resample_scores(cells, resamples), TRIMMED, axis=1)
    low, high = find_interval(drawn)
    return Score(iqm, float(low), float(high))


def resample_scores(cells: Sequence[Numbers], resamples: int = RESAMPLES) -> Numbers:
    """Return bootstrap samples of the mean scores, shape (resamples, cells x seeds).

    A sample has one mean score for each seed of each cell.
    """
    generator = np.random.default_rng(SEED)
    drawn = [[_draw(each.shape, generator) for each in cells] for _ in range(resamples)]
    means = []
    for results, draws in zip(cells, zip(*drawn, strict=True), strict=True):
        rows, columns = (np.array(each) for each in zip(*draws, strict=True))
        means.append(results[rows[:, :, np.newaxis], columns[:, np.newaxis]].mean(axis=2))
    return np.concatenate(means, axis=1)


def find_interval(drawn: Any) -> Numbers:
    """Return the ends (2, ...) of the 95 % interval of bootstrap samples (resamples, ...)."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    return np.asarray(np.percentile(drawn, (tail, 100.0 - tail), axis=0))


def _draw(shape: tuple[int, ...], generator: np.random.Generator) -> tuple[Integers, ...]:
    """Draw indices of seeds and episodes with replacement. `shape` is (seeds, episodes)."""
    return tuple(generator.integers(count, size=count) for count in shape)


class Board:
    """Results of entries by task and cell; a cell is a set of test episodes."""

    def __init__(self, entries: Sequence[BenchmarkEntry]) -> None:
        self.entries = tuple(entries)
        self._by_name = {each.name: each for each in entries}

    def results(self, entry: BenchmarkEntry, task: str, cell: str) -> Numbers | None:
        """Return an entry's results (seeds, episodes) in a cell, or None if runs lack results."""
        rows = [row for row in entry.rows if (row.task, row.cell) == (task, cell)]
        if not rows or any(row.failure for row in rows):
            return None
        return np.array([row.scores for row in rows])

    @cached_property
    def references(self) -> dict[tuple[str, str], tuple[float, float]]:
        """Mean results of the fixed layout and of the best rule, by task and cell.

        A cell is left out if a result is missing, or if the rule is not better than the layout.
        """
        found = {}
        for task, names in read_protocol()["references"].items():
            for cell in CELLS:
                both = [
                    self.results(self._by_name[name], task, cell)
                    for name in names
                    if name in self._by_name
                ]
                means = [float(each.mean()) for each in both if each is not None]
                if len(means) == 2 and means[1] > means[0]:
                    found[task, cell] = (means[0], means[1])
        return found

    def normalised(self, entry: BenchmarkEntry, task: str, cell: str) -> Numbers | None:
        """Return an entry's scores (seeds, episodes) in a cell; None if a result is missing."""
        results, limits = self.results(entry, task, cell), self.references.get((task, cell))
        if results is None or limits is None:
            return None
        return np.asarray((results - limits[0]) / (limits[1] - limits[0]))

    def whole(self, entry: BenchmarkEntry, task: str) -> list[Numbers]:
        """Return an entry's scores (seeds, episodes) in each cell, or [] if a cell is missing."""
        cells = [self.normalised(entry, task, cell) for cell in CELLS]
        whole = [each for each in cells if each is not None]
        return whole if len(whole) == len(cells) else []

    def score(self, entry: BenchmarkEntry, task: str) -> Score:
        """Return an entry's score over all cells of a task, or NaN if a cell is missing."""
        cells = self.whole(entry, task)
        return score_cells(cells) if cells else Score(math.nan, math.nan, math.nan)

    def table(self, task: str) -> Table | None:
        """Return a task's table with the best entry first, or None if the task has no entry."""
        ranked = []
        for entry in self.entries:
            rows = [row for row in entry.rows if row.task == task]
            if rows:
                score = self.score(entry, task)
                place = -math.inf if math.isnan(score.value) else score.value
                ranked.append((-place, entry.name, self._line(entry, rows, score)))
        if not ranked:
            return None
        header = ("entry", "score", *CELLS, "seeds", "training periods", "decision time")
        return Table(task, "", header, tuple(line for *_, line in sorted(ranked)))

    def _line(self, entry: BenchmarkEntry, rows: Sequence[Row], score: Score) -> tuple[str, ...]:
        digits = ".0f" if _is_stream(rows[0].task) else ".3f"
        means = []
        for cell in CELLS:
            results = self.results(entry, rows[0].task, cell)
            failed = any(row.failure for row in rows if row.cell == cell)
            mean = None if results is None else float(results.mean())
            means.append("failed" if failed else number(mean, digits))
        name = f"[{entry.name}]({entry.link})" if entry.link else entry.name
        times = [row.decision_time for row in rows if not row.failure]
        return (
            name, str(score), *means, str(len({row.seed for row in rows})),
            number(1e-6 * entry.interactions or None, ".1f", "\u00a0M"),
            number(1e6 * float(np.median(times)) if times else None, ".0f", "\u00a0us"),
        )  # fmt: skip

    def merged(self, title: str, tasks: Sequence[str]) -> list[Table]:
        """Return a list with one table for all `tasks`, or an empty list if there is no entry."""
        tables = [found for task in tasks if (found := self.table(task)) is not None]
        rows = [
            (each.heading if row is each.rows[0] else "", *row)
            for each in tables
            for row in each.rows
        ]
        return [Table(title, "", ("task", *tables[0].header), tuple(rows), 2)] if rows else []

    def sources(self) -> Table:
        """Return the table of entries with their kinds, authors and sources."""
        groups: dict[tuple[str, str], list[str]] = {}
        for entry in sorted(self.entries, key=lambda each: each.name):
            text = entry.name if entry.name == entry.source else f"{entry.name}: `{entry.source}`"
            groups.setdefault((entry.kind, entry.by or NOTHING), []).append(text)
        rows = tuple((*group, "; ".join(texts)) for group, texts in sorted(groups.items()))
        caption = (
            "An entry without a source is the shipped agent of that name. The files of "
            "surface_gym's entries are in `examples/entries`; `sb3_ppo.py` saves the .zip files."
        )
        return Table("entries", caption, ("kind", "by", "entries, with their sources"), rows, 3)


def _is_stream(task: str) -> bool:
    return PERIODS[task] is None


def make_page(board: Board) -> str:
    """Return the board as a Markdown page: tables of all tasks, and a table of the entries."""
    tables = [
        *board.merged("one parcel", [task for task in PERIODS if not _is_stream(task)]),
        *board.merged("streams", [task for task in PERIODS if _is_stream(task)]),
        board.sources(),
    ]
    ((zero, one),) = {tuple(each) for each in read_protocol()["references"].values()}
    title = TITLE.format(zero=zero, one=one)
    return "\n\n".join([title, *(each.markdown().strip() for each in tables)]) + "\n"


THRESHOLDS = 101  # points of a performance profile
MOST = 10  # entries in a figure: rliable's palette has as many colours


def compute_profile(scores: Numbers, thresholds: Numbers) -> Numbers:
    """Compute the share (..., thresholds) of scores (..., runs) above each threshold."""
    return np.asarray((scores[..., np.newaxis] > thresholds).mean(axis=-2))


def plot_board(board: Board, folder: Path) -> list[Path]:
    """Draw each task's best entries into TASK-scores.png and TASK-profile.png; return the files.

    The profile shows the share of runs above each score. A run is one training seed in one cell.

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
