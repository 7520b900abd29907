"""The command line of train.py: defaults of the task, runs gone on with, refusals."""

from dataclasses import replace
from pathlib import Path

import pytest

from agents.learning.command import SWEEP, Search, find_search, open_run, take_cluster
from agents.learning.config import DQNConfig, PPOConfig
from agents.learning.hyperparams import defaults, write_hyperparams


def test_defaults_are_those_of_task_and_algorithm(tmp_path: Path) -> None:
    arguments = ["--task", "track", "--algo", "dqn", "--seed", "3", "--out", str(tmp_path)]
    config, folder = open_run(arguments)
    default = defaults("track", "dqn")
    assert isinstance(config, DQNConfig)
    assert (config.task, config.seed, config.steps) == ("track", 3, default.steps)
    assert folder.parent == tmp_path
    assert folder.name.startswith("track-dqn-seed3-")
    assert (folder / "command.txt").read_text().startswith("python ")


def test_modules_learn_to_sort(tmp_path: Path) -> None:
    config, folder = open_run(["--algo", "modules", "--out", str(tmp_path)])
    assert config == replace(defaults("sort", "modules"), out=tmp_path)
    assert folder.name.startswith("sort-modules-seed0-")


def test_a_run_is_gone_on_with_as_it_was_asked_for(tmp_path: Path) -> None:
    config, folder = open_run(["--lanes", "32", "--out", str(tmp_path), "--name", "a"])
    assert isinstance(config, PPOConfig)
    assert open_run(["--resume", str(folder)]) == (config, folder)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--steps", "0"], "steps"),
        (["--gamma", "2"], "gamma"),
        (["--algo", "dqn", "--actions", "window"], "actions"),
        (["--algo", "modules", "--task", "slow"], "task must be one of 'sort'"),
        (["--resume", "nowhere"], "nowhere"),
        (["--resume", "nowhere", "--steps", "5"], "--resume must stand alone"),
    ],
)
def test_refusals_name_what_is_wrong(
    arguments: list[str],
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, SystemExit)) as raised:
        open_run(arguments)
    assert named in str(raised.value) + capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_folder_is_not_written_over(tmp_path: Path) -> None:
    arguments = ["--out", str(tmp_path), "--name", "a"]
    open_run(arguments)
    with pytest.raises(ValueError, match="--resume"):
        open_run(arguments)


@pytest.mark.parametrize("wrong", [["--task", "juggle"], ["--algo", "sac"], ["--hidden", "x"]])
def test_unknown_choices_end_the_program(
    wrong: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, SystemExit)):
        open_run(wrong)


def test_a_file_of_ones_own_gives_the_defaults(tmp_path: Path) -> None:
    own = replace(defaults("slow", "ppo"), gamma=0.9)
    write_hyperparams(own, tmp_path / "own.yml")
    flags = ["--task", "slow", "--hyperparams", str(tmp_path / "own.yml"), "--out", str(tmp_path)]
    config, _ = open_run([*flags, "--seed", "4"])
    assert config == replace(own, seed=4, out=tmp_path)


def test_the_cluster_is_no_part_of_a_run() -> None:
    assert take_cluster(["--task", "slow"]) == (None, ["--task", "slow"])
    assert take_cluster(["--cluster", "auto", "--seeds", "2"]) == ("auto", ["--seeds", "2"])


def test_a_search_is_new_or_gone_on_with(tmp_path: Path) -> None:
    file, folder = tmp_path / "wide.yml", tmp_path / "search-wide"
    assert find_search(["--task", "slow"]) is None
    asked = find_search(["--search", str(file), "--out", str(tmp_path)])
    assert asked == Search(file, folder, None)
    folder.mkdir()
    assert find_search(["--resume", str(folder)]) is None  # a run's, as far as this tells
    (folder / SWEEP).touch()
    assert find_search(["--resume", str(folder)]) == Search(folder / SWEEP, folder, None)


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--search", "wide.yml", "--steps", "5"], "--search must stand alone"),
        (["--search", "wide.yml", "--resume", "there"], "--search must stand alone"),
        (["--search", "wide.yml", "--out", ".", "--name", "there"], "--resume there goes on"),
        (["--resume", "there", "--steps", "5"], "--resume must stand alone"),
    ],
)
def test_what_does_not_go_with_a_search_is_refused(
    more: list[str], named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there").mkdir()
    Path("there", SWEEP).touch()
    with pytest.raises(ValueError, match=named):
        find_search(more)
