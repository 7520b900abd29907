"""The report: what the page says is what the trials are, however few came to an end."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from agents.learning.hyperparams import defaults
from agents.search.report import write_report
from agents.search.study import carry_out
from agents.search.sweep import Sweep
from agents.search.tried import COMPLETE, PRUNED, REFUSED, Tried, best_of
from tests.agents.search.cheap import SMALL, cheap_trial

SWEEP = replace(SMALL, trials=24, seeds=2)


def worked(orders: Sequence[object]) -> list[Tried]:
    return [cheap_trial(order, lambda _: None) for order in orders]  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def trials() -> list[Tried]:
    return carry_out(SWEEP, {}, worked)


def table(page: str, head: str) -> list[list[str]]:
    """The rows of the table of a page that begins with a column's name."""
    lines = page.splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith(f"| {head} |"))
    rows = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_the_page_tells_of_every_trial_and_the_best(trials: list[Tried], tmp_path: Path) -> None:
    write_report(SWEEP, trials, tmp_path)
    page = (tmp_path / "report.md").read_text()
    best = best_of(trials)
    assert best is not None
    assert f"## Best: trial {best.number}, success {best.value:.4g}" in page
    rows = table(page, "trial")
    assert [row[:2] for row in rows] == [[str(each.number), each.state] for each in trials]
    assert float(rows[best.number][2]) == pytest.approx(best.value, rel=1e-3)
    shares = [float(share.removesuffix(" %")) for _, share in table(page, "hyper-parameter")[3:]]
    assert sum(shares) == pytest.approx(100.0, abs=2.0) or not shares
    names = [row[0] for row in table(page[page.index("## Importance") :], "hyper-parameter")]
    assert sorted(names) == sorted(SWEEP.space)
    for picture in ("history.png", "curves.png", "importance.png"):
        assert f"![]({picture})" in page
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


def test_the_best_configuration_learns_as_long_as_usual(
    trials: list[Tried], tmp_path: Path
) -> None:
    write_report(SWEEP, trials, tmp_path)
    best = best_of(trials)
    assert best is not None
    config = defaults(SWEEP.task, SWEEP.algo, tmp_path / "best.yml")
    usual = defaults(SWEEP.task, SWEEP.algo)
    assert config == replace(SWEEP.config(best.params), steps=usual.steps, seed=usual.seed)


def test_the_same_trials_make_the_same_report(trials: list[Tried], tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
        write_report(SWEEP, [replace(each, seconds=ord(name)) for each in trials], tmp_path / name)
    for each in (tmp_path / "a").iterdir():
        assert each.read_bytes() == (tmp_path / "b" / each.name).read_bytes()


@pytest.mark.parametrize("sweep", [SWEEP, replace(SWEEP, sampler="random", pruner="none")])
def test_where_no_trial_is_complete_there_is_no_best(
    sweep: Sweep, trials: list[Tried], tmp_path: Path
) -> None:
    first, second = (replace(each, value=None) for each in trials[:2])
    refused = replace(first, state=REFUSED, intermediate={}, why="a | b")
    write_report(sweep, [refused, replace(second, state=PRUNED)], tmp_path)
    page = (tmp_path / "report.md").read_text()
    assert "1 pruned, 1 refused; none is complete, so none is best" in page
    assert "It takes 8 complete trials" in page
    assert table(page, "trial")[0][1] == "refused: a / b"
    assert {each.name for each in tmp_path.iterdir()} == {"report.md", "history.png", "curves.png"}


def test_few_trials_tell_nothing_of_importance(trials: list[Tried], tmp_path: Path) -> None:
    complete = [each for each in trials if each.state == COMPLETE][:3]
    write_report(SWEEP, complete, tmp_path)
    assert "It takes 8 complete trials" in (tmp_path / "report.md").read_text()
    assert not (tmp_path / "importance.png").exists()
    assert (tmp_path / "best.yml").is_file()
