"""`surface-gym`, the one command of an installed package."""

import sys

import pytest

from surface_gym import __version__
from surface_gym.cli import COMMANDS, main


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_tells_what_it_takes(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert not ended.value.code
    assert "usage:" in capsys.readouterr().out


def test_its_own_help_lists_them_all(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert not ended.value.code
    told = capsys.readouterr().out
    assert all(f"\n  {name} " in told for name in COMMANDS)


def test_it_tells_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"surface-gym {__version__}\n"


@pytest.mark.parametrize("arguments", [[], ["juggle"]])
def test_another_command_is_refused(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert "COMMAND" in capsys.readouterr().err


def test_what_stands_behind_the_name_is_the_commands_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    heard: list[list[str]] = []
    monkeypatch.setattr("surface_gym.play.main", lambda: heard.append(sys.argv))
    main(["play", "--task", "slow"])
    assert heard == [["surface-gym play", "--task", "slow"]]


def test_a_missing_library_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setattr("surface_gym.play.main", fails)
    with pytest.raises(SystemExit) as ended:
        main(["play"])
    assert ended.value.code == (
        "error: surface-gym play needs torch, which is not installed: "
        "pip install 'surface_gym[agents]'"
    )
