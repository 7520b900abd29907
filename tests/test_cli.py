"""`surface-gym`, the one command of the package, and `python -m` of its parts."""

import subprocess
import sys
from collections.abc import Sequence

import pytest

from surface_gym import __version__
from surface_gym.cli import COMMANDS, main

# The validation and the design ask for matplotlib when they draw, after their runs.
MISSING = [
    ("paper", "matplotlib"), ("paper", "rich"), ("paper", "tyro"),
    ("validation", "rich"), ("design", "tyro"),
]  # fmt: skip


Printed = pytest.CaptureFixture[str]


def ended(*arguments: str) -> int:
    """The exit status that a command ends with."""
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return int(end.value.code or 0)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name, capsys):
    assert ended(name, "--help") == 0
    assert "usage:" in capsys.readouterr().out


def test_help_lists_all_commands_and_there_is_a_version(capsys):
    assert ended("--help") == 0
    printed = capsys.readouterr().out
    assert all(f"\n  {name} " in printed for name in COMMANDS)
    main(["--version"])
    assert capsys.readouterr().out == f"surface-gym {__version__}\n"


@pytest.mark.parametrize("arguments", [[], ["juggle"]])
def test_another_command_is_refused(arguments, capsys):
    assert ended(*arguments) == 2
    assert "COMMAND" in capsys.readouterr().err


def test_a_command_gets_its_own_arguments(monkeypatch):
    given: list[Sequence[str]] = []
    before = list(sys.argv)
    monkeypatch.setattr("surface_gym.play.main", given.append)
    main(["play", "--task", "slow"])
    assert given == [["--task", "slow"]]
    assert sys.argv == before


@pytest.mark.parametrize(("name", "library"), MISSING)
def test_a_missing_library_is_reported_in_one_line(name, library, tmp_path):
    program = (
        f"import runpy, sys; sys.modules[{library!r}] = None; sys.argv = ['it', '--figures', 'f']; "
        f"runpy.run_module('surface_gym.{name}', run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 1
    assert done.stderr == (
        f"error: surface-gym {name} needs {library}, which is not installed: "
        f"pip install 'surface_gym[{COMMANDS[name].extra}]'\n"
    )


def test_another_missing_module_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "surface_gym.play", None)
    with pytest.raises(ModuleNotFoundError):
        main(["play"])
