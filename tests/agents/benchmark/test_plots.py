"""Plots of the board: rliable's intervals are the board's, and figures are drawn."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.benchmark import TASKS, cli
from surface_gym.agents.benchmark.board import (
    Board,
    compute_iqm,
    compute_profile,
    plot_board,
    score_cells,
)
from surface_gym.agents.benchmark.entry import read_entries

RESULTS = Path(__file__).parents[3] / "benchmarks/results"


def needs_rliable() -> None:
    pytest.importorskip("rliable", reason="rliable, of the extra `plots`, is missing")


def test_rliable_finds_the_board_s_scores_and_intervals(monkeypatch: Any) -> None:
    """Seeds and episodes of each cell are its two samples, which it draws independently."""
    needs_rliable()
    try:
        from rliable import library, metrics
    except TypeError:  # arch 7, the last that rliable takes, needs an older pandas
        pytest.skip("rliable's bootstrap needs pandas 2")

    # Its own draws come from NumPy's global state.
    monkeypatch.setattr(np.random, "choice", np.random.default_rng(0).choice)
    board = Board(read_entries(RESULTS))
    entries = {entry.name: entry for entry in board.entries}
    for name in ("orient-ppo", "best rule", "fixed layout"):
        cells = board.whole(entries[name], "orient")
        seeds, episodes = (
            np.tile(np.arange(cells[0].shape[axis])[:, np.newaxis], len(cells)) for axis in (0, 1)
        )

        def aggregate(seeds: Any, episodes: Any, cells: Any = cells) -> Any:
            drawn = [
                each[np.ix_(seeds[:, k], episodes[:, k])].mean(axis=1)
                for k, each in enumerate(cells)
            ]
            return np.array([metrics.aggregate_iqm(np.stack(drawn, axis=1))])

        point, interval = library.get_interval_estimates(
            {name: [seeds, episodes]}, aggregate, reps=2000
        )
        score = score_cells(cells)
        assert point[name] == pytest.approx([score.value])
        assert interval[name][:, 0] == pytest.approx([score.low, score.high], abs=0.015)


def test_its_interquartile_mean_is_rliable_s() -> None:
    needs_rliable()
    from rliable import metrics

    scores = np.random.default_rng(0).random((5, 4))
    assert metrics.aggregate_iqm(scores) == compute_iqm(scores)


def test_a_profile_is_the_share_of_runs_above() -> None:
    scores = np.array([[0.1, 0.5, 0.9], [0.5, 0.6, 0.7]])
    profile = compute_profile(scores, np.array([0.0, 0.5, 0.8]))
    np.testing.assert_allclose(profile, [[1.0, 1 / 3, 1 / 3], [1.0, 2 / 3, 0.0]])


def test_each_task_with_entries_has_two_figures(tmp_path: Path, capsys: Any) -> None:
    needs_rliable()
    cli.main(["plot", "--out", str(tmp_path / "plots")])
    names = {file.name for file in (tmp_path / "plots").iterdir()}
    assert {"orient-scores.png", "orient-profile.png"} <= names
    assert capsys.readouterr().out.count(".png") == len(names) == 2 * len(TASKS)
    assert plot_board(Board([]), tmp_path) == []


def test_the_command_says_how_rliable_is_installed(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(cli, "find_spec", lambda _: None)
    with pytest.raises(SystemExit, match=r"error: plot needs rliable: pip install 'surface_gym"):
        cli.main(["plot", "--out", str(tmp_path)])
