"""The command of a search, the folder it works in, and the report that it leaves."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import optuna
import pytest
from optuna.trial import FrozenTrial, TrialState, create_trial
from rich.console import Console

from surface_gym.agents.learning.config import PPOConfig, defaults
from surface_gym.agents.tuning import sweep as cli
from surface_gym.agents.tuning.study import (
    MIN_COMPLETE,
    REASON,
    best_trial,
    finished_trials,
    importance,
    open_study,
    plain_params,
    write_report,
)
from surface_gym.agents.tuning.sweep import Choices, Span, Sweep, main, open_folder, search
from tests.agents.tuning.cheap import QUIET, SMALL, searched

SHORT = """
task: slow
trials: 2
steps: 20000
evaluations: 1
space: {learning_rate: {low: 0.0001, high: 0.003}}
fixed: {hidden: [8], n_epochs: 1}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "short.yml"
    file.write_text(SHORT)
    return file


class TestCommand:
    def test_it_leaves_a_configuration_that_learns(self, file, tmp_path, monkeypatch) -> None:
        monkeypatch.setattr("surface_gym.agents.tuning.study.STARTS", 16)
        with open(os.devnull, "w") as nowhere:
            console = Console(record=True, width=200, file=nowhere)
            search(file, tmp_path / "a", 1, console)
            printed = console.export_text()
        assert "the best is trial" in printed
        assert "report.md and best.yml" in printed
        with open_study(SMALL, tmp_path / "a") as kept:
            best = best_trial(finished_trials(kept))
        config = defaults("slow", "ppo", tmp_path / "a" / "best.yml")
        usual = defaults("slow", "ppo")
        assert isinstance(usual, PPOConfig)
        rate = best.params["learning_rate"]
        assert config == replace(usual, hidden=(8,), n_epochs=1, learning_rate=rate)
        texts = {name: (tmp_path / "a" / name).read_bytes() for name in ("report.md", "best.yml")}
        assert {each.name for each in (tmp_path / "a").iterdir()} == {
            "sweep.yml", "study.db", "report.md", "best.yml", "history.png", "curves.png",
        }  # fmt: skip
        main([str(file), "--out", str(tmp_path), "--name", "a"])  # which has nothing left to do
        assert {name: (tmp_path / "a" / name).read_bytes() for name in texts} == texts

    def test_an_interrupt_is_reported(self, file, tmp_path, monkeypatch) -> None:
        def stop(*_: object) -> Iterator[None]:
            raise KeyboardInterrupt

        monkeypatch.setattr("surface_gym.agents.tuning.study.run_trial", stop)
        with open(os.devnull, "w") as nowhere:
            console = Console(record=True, width=200, file=nowhere)
            search(file, tmp_path / "a", 1, console)
            printed = console.export_text()
        assert f"holds 0 trials; python train.py --resume {tmp_path / 'a'} resumes it" in printed

    def test_a_folder_of_another_search_is_refused(self, file, tmp_path) -> None:
        first = open_folder(file, tmp_path / "a")
        assert open_folder(file, tmp_path / "a") == first
        assert (tmp_path / "a" / "sweep.yml").read_text() == SHORT
        file.write_text(SHORT + "seed: 5\n")
        with pytest.raises(SystemExit, match=r"folder must be of this search.*seed is 0 there, 5"):
            main([str(file), "--out", str(tmp_path), "--name", "a"])
        for folder in (tmp_path, file):
            with pytest.raises(ValueError, match="folder must be new, or a search's"):
                search(file, folder, 1, QUIET)

    def test_without_optuna_it_says_what_to_install(self, file, tmp_path, monkeypatch) -> None:
        monkeypatch.setattr(cli, "find_spec", lambda _: None)
        with pytest.raises(ValueError, match=r"pip install 'surface_gym\[search\]'"):
            search(file, tmp_path / "a", 1, QUIET)
        assert not (tmp_path / "a").exists()

    def test_it_takes_a_worker(self, file, tmp_path) -> None:
        with pytest.raises(ValueError, match="workers"):
            search(file, tmp_path / "a", 0, QUIET)


SWEEP = replace(SMALL, trials=24, seeds=2)


def in_memory(*trials: FrozenTrial) -> optuna.Study:
    study = optuna.create_study(direction="maximize")
    study.add_trials(trials)
    return study


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[FrozenTrial]:
    return searched(SWEEP, tmp_path_factory.mktemp("report"))


def table(page: str, head: str) -> list[list[str]]:
    """The rows of the table of a page that begins with a column's name."""
    lines = page.splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith(f"| {head} |"))
    rows = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([value.strip() for value in line.strip("|").split("|")])
    return rows


class TestReport:
    def test_the_page_lists_every_trial_and_the_best(self, trials, tmp_path) -> None:
        interrupted = create_trial(state=TrialState.FAIL)
        write_report(SWEEP, in_memory(*trials, interrupted), tmp_path)
        page = (tmp_path / "report.md").read_text()
        best = best_trial(trials)
        assert f"## Best: trial {best.number}, success {best.value:.4g}" in page
        rows = table(page, "trial")
        assert [row[:2] for row in rows] == [[str(t.number), t.state.name.lower()] for t in trials]
        assert float(rows[best.number][2]) == pytest.approx(best.value, rel=1e-3)
        names = [row[0] for row in table(page[page.index("## Importance") :], "hyper-parameter")]
        assert sorted(names) == sorted(SWEEP.space)
        for picture in ("history.png", "curves.png", "importance.png"):
            assert f"![]({picture})" in page
            assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
        config = defaults(SWEEP.task, SWEEP.algo, tmp_path / "best.yml")
        usual = defaults(SWEEP.task, SWEEP.algo)
        found = SWEEP.config(plain_params(SWEEP, best))
        assert config == replace(found, steps=usual.steps, seed=usual.seed)

    def test_without_a_complete_trial_there_is_no_best(self, trials, tmp_path) -> None:
        given = {"params": trials[0].params, "distributions": trials[0].distributions}
        refused = create_trial(
            state=TrialState.FAIL, user_attrs={REASON: "refused: a | b"}, **given
        )
        pruned = create_trial(state=TrialState.PRUNED, intermediate_values={1: 0.5}, **given)
        write_report(SWEEP, in_memory(refused, pruned), tmp_path)
        page = (tmp_path / "report.md").read_text()
        assert "1 pruned, 1 refused; none is complete, so none is best" in page
        assert f"It takes {MIN_COMPLETE} complete trials" in page
        assert table(page, "trial")[0][1] == "refused: a / b"
        names = {each.name for each in tmp_path.iterdir()}
        assert names == {"report.md", "history.png", "curves.png"}


class TestImportance:
    sweep = Sweep(
        trials=60,
        pruner="none",
        sampler="random",
        space={
            "learning_rate": Span(1e-4, 1e-2),
            "gae_lambda": Span(0.0, 1.0),
            "n_epochs": Span(1, 9),
            "hidden": Choices([[8], [8, 8]]),
        },
    )

    def test_what_counts_has_the_largest_share(self, tmp_path) -> None:
        trials = searched(self.sweep, tmp_path)
        shares = importance(self.sweep, in_memory(*trials))
        assert next(iter(shares)) == "learning_rate"
        assert shares["learning_rate"] > 0.5
        assert sum(shares.values()) == pytest.approx(1.0)
        assert set(shares) == set(self.sweep.space)
        assert list(shares.values()) == sorted(shares.values(), reverse=True)
        assert importance(self.sweep, in_memory(*trials[:MIN_COMPLETE])) is not None
        assert importance(self.sweep, in_memory(*trials[: MIN_COMPLETE - 1])) is None
        for each in trials:
            each.value = 0.0
        assert importance(self.sweep, in_memory(*trials)) is None
        trials[0].value = 1.0
        assert importance(self.sweep, in_memory(*trials)) is None
