"""A search: the same whoever carries it out, and however often it is broken off."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from agents.learning.config import PPOConfig
from agents.learning.hyperparams import defaults
from agents.search import command
from agents.search.command import go_on, open_search, search
from agents.search.study import Order
from agents.search.tried import FILE, PRUNED, Tried, best_of, read_tried, write_tried
from surface_gym.sharing import Tell
from tests.agents.search.cheap import SMALL, cheap_trial

ROOT = Path(__file__).parents[3]
QUIET = Console(quiet=True)
SHORT = """
task: slow
trials: 3
generation: 2
steps: 20000
evaluations: 1
space: {learning_rate: {low: 0.0001, high: 0.003}}
fixed: {hidden: [8], n_epochs: 1}
"""


def kept(folder: Path) -> list[dict[str, Any]]:
    """The trials of a search, but for how long they took."""
    plain = [json.loads(line) for line in (folder / FILE).read_text().splitlines()]
    assert all(each.pop("seconds") > 0.0 for each in plain)
    return plain


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    go_on(SMALL, folder, 1, QUIET, cheap_trial)
    return folder


def stopping(at: int, order: Order, tell: Tell) -> Tried:
    if order.number == at:
        raise KeyboardInterrupt
    return cheap_trial(order, tell)


def test_two_processes_come_to_what_one_does(whole: Path, tmp_path: Path) -> None:
    first = list(read_tried(whole).values())[:4]  # a generation that nothing can be pruned by
    write_tried(first, tmp_path)
    go_on(replace(SMALL, trials=8), tmp_path, 2, QUIET, cheap_trial)
    assert kept(tmp_path) == kept(whole)[:8]
    assert PRUNED in {each["state"] for each in kept(tmp_path)}


@pytest.mark.parametrize("at", [0, 2, 9, 13])
def test_broken_off_and_gone_on_with_it_is_the_same(at: int, whole: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        go_on(SMALL, tmp_path, 1, QUIET, partial(stopping, at))
    before = read_tried(tmp_path)
    assert len(before) == at
    trials = go_on(SMALL, tmp_path, 1, QUIET, cheap_trial)
    assert trials[:at] == list(before.values())  # nothing is done twice
    assert kept(tmp_path) == kept(whole)
    best = best_of(trials)
    assert best is not None
    assert best.number == max(kept(whole), key=lambda each: each["value"] or 0.0)["number"]


def test_killed_and_gone_on_with_it_is_the_same(whole: Path, tmp_path: Path) -> None:
    call = (
        "import sys; from pathlib import Path; from tests.agents.search.cheap import slow_search\n"
        "if __name__ == '__main__': slow_search(Path(sys.argv[1]))"
    )
    (tmp_path / "go.py").write_text(call)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "go.py"), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    while process.poll() is None and len(read_tried(tmp_path)) < 2:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL  # before it was done
    assert 2 <= len(read_tried(tmp_path)) < SMALL.trials
    go_on(SMALL, tmp_path, 1, QUIET, cheap_trial)
    assert kept(tmp_path) == kept(whole)


class TestWholeSearch:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        file = tmp_path / "short.yml"
        file.write_text(SHORT)
        return file

    def test_it_leaves_a_configuration_that_learns(
        self, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("agents.search.trial.STARTS", 16)
        console = Console(record=True, width=200, file=open(os.devnull, "w"))  # noqa: SIM115
        search(file, tmp_path / "a", 1, console)
        console.file.close()
        told = console.export_text()
        assert "the best is trial" in told
        assert "report.md and best.yml" in told
        (best,) = [best_of(read_tried(tmp_path / "a").values())]
        assert best is not None
        config = defaults("slow", "ppo", tmp_path / "a" / "best.yml")
        usual = defaults("slow", "ppo")
        assert isinstance(usual, PPOConfig)
        learning_rate = best.params["learning_rate"]
        assert config == replace(usual, hidden=(8,), n_epochs=1, learning_rate=learning_rate)
        first = {each.name: each.read_bytes() for each in (tmp_path / "a").iterdir()}
        assert set(first) == {
            "sweep.yml", "trials.jsonl", "report.md", "best.yml", "history.png", "curves.png",
        }  # fmt: skip
        search(file, tmp_path / "a", 1, QUIET)  # which has nothing left to do
        assert {each.name: each.read_bytes() for each in (tmp_path / "a").iterdir()} == first

    def test_an_interrupt_is_told_of(
        self, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def stop(*_: object) -> Iterator[Tried]:
            raise KeyboardInterrupt

        monkeypatch.setattr("agents.search.trial.run_trial", stop)
        with open(os.devnull, "w") as nowhere:
            console = Console(record=True, width=200, file=nowhere)
            search(file, tmp_path / "a", 1, console)
            told = console.export_text()
            assert f"holds 0 trials; python train.py --resume {tmp_path / 'a'} goes on" in told

    def test_a_folder_of_another_search_is_refused(self, file: Path, tmp_path: Path) -> None:
        first = open_search(file, tmp_path / "a")
        assert open_search(file, tmp_path / "a") == first
        assert (tmp_path / "a" / "sweep.yml").read_text() == SHORT
        file.write_text(SHORT + "seed: 5\n")
        with pytest.raises(ValueError, match=r"folder must be of this search.*seed is 0 there, 5"):
            search(file, tmp_path / "a", 1, QUIET)

    def test_a_folder_of_something_else_is_refused(self, file: Path, tmp_path: Path) -> None:
        for folder in (tmp_path, file):
            with pytest.raises(ValueError, match="folder must be new, or a search's"):
                search(file, folder, 1, QUIET)

    def test_without_optuna_it_says_what_to_install(
        self, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(command, "find_spec", lambda _: None)
        with pytest.raises(ValueError, match=r"pip install 'surface_gym\[search\]'"):
            search(file, tmp_path / "a", 1, QUIET)
        assert not (tmp_path / "a").exists()

    def test_it_takes_a_worker(self, file: Path, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match="workers"):
            search(file, tmp_path / "a", 0, QUIET)


class TestKept:
    def test_they_come_back_as_they_were(self, whole: Path, tmp_path: Path) -> None:
        trials = read_tried(whole)
        write_tried(reversed(trials.values()), tmp_path)
        assert read_tried(tmp_path) == trials
        assert (tmp_path / FILE).read_bytes() == (whole / FILE).read_bytes()
        assert read_tried(tmp_path / "nowhere") == {}

    @pytest.mark.parametrize(
        ("change", "named"),
        [({"state": "lost"}, "state must be one of"), ({"value": None}, "complete trials alone")],
    )
    def test_what_is_no_trial_is_named(
        self, change: dict[str, Any], named: str, whole: Path, tmp_path: Path
    ) -> None:
        write_tried([replace(read_tried(whole)[0], **change)], tmp_path)
        with pytest.raises(ValueError, match=named):
            read_tried(tmp_path)

    @pytest.mark.parametrize("line", ["{", "3", "[]", '{"number": 1}', '{"intermediate": 3}'])
    def test_damage_is_named(self, line: str, tmp_path: Path) -> None:
        (tmp_path / FILE).write_text(line + "\n")
        with pytest.raises(ValueError, match=r"trials\.jsonl is damaged"):
            read_tried(tmp_path)
