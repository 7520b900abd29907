"""`surface-gym`, the one command of the package, and `python -m` of its parts."""

import runpy
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

from surface_gym import __version__
from surface_gym.cli import COMMANDS, main
from tests.environments import run_python

# The validation and the design ask for matplotlib when they draw, after their runs.
MISSING = [
    ("paper", "matplotlib"), ("paper", "rich"), ("paper", "tyro"),
    ("validation", "rich"), ("design", "tyro"),
]  # fmt: skip


ROOT = Path(__file__).parents[1]
Printed = pytest.CaptureFixture[str]


def ended(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return int(end.value.code or 0)


@pytest.mark.parametrize(
    "typed",
    [
        "train.py", "evaluate.py", "-m surface_gym.design", "-m surface_gym.design columns",
        "-m surface_gym.paper", "-m surface_gym.play", "-m surface_gym.validation", "-m benchmarks",
    ],
)  # fmt: skip
def test_a_usage_line_names_the_command_that_was_typed(typed, capsys, monkeypatch):
    program, *arguments = typed.removeprefix("-m ").split()
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "argv", [program, *arguments, "--help"])
    for each in (program, f"{program}.__main__"):  # as in a process of its own
        monkeypatch.delitem(sys.modules, each, raising=False)
    by_name = partial(runpy.run_module, alter_sys=True)
    run = by_name if typed.startswith("-m ") else runpy.run_path
    with pytest.raises(SystemExit):
        run(program, run_name="__main__")
    assert f"usage: python {typed} [" in " ".join(capsys.readouterr().out.split())


# What comes with the extra `agents` and not with `tools`.
ABSENT = ("torch", "stable_baselines3", "pandas", "moviepy", "tqdm", "tensorboard")
# As where they are not installed: tyro imports those whose names are in `sys.modules`.
WITHOUT = f"""
import importlib, pkgutil, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ABSENT!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
from surface_gym.cli import main
"""


def test_design_answers_without_torch(tmp_path):
    arguments = ["design", "columns", "--parcel", "S", "--draws", "2", "--out", str(tmp_path)]
    run_python("-c", f"{WITHOUT}main({arguments!r})")
    assert (tmp_path / "columns.png").is_file()


def test_no_module_of_a_tool_needs_torch():
    tools = ["design", "paper", "play"]
    program = (
        f"{WITHOUT}for tool in {tools}:\n"
        "    top = importlib.import_module('surface_gym.' + tool)\n"
        "    for each in pkgutil.walk_packages(getattr(top, '__path__', []), top.__name__ + '.'):\n"
        "        importlib.import_module(each.name)\n"
        "    try: main([tool, '--help'])\n"
        "    except SystemExit: pass\n"
    )
    printed = run_python("-c", program)
    assert all(f"usage: surface-gym {tool} [" in printed for tool in tools)


def test_help_lists_all_commands_and_there_is_a_version(capsys):
    assert ended("--help") == 0
    printed = capsys.readouterr().out
    assert all(f"\n  {name} " in printed for name in COMMANDS)
    main([])
    assert capsys.readouterr().out == printed
    main(["--version"])
    assert capsys.readouterr().out == f"surface-gym {__version__}\n"


def test_another_command_is_refused(capsys):
    assert ended("juggle") == 2
    assert "COMMAND" in capsys.readouterr().err


def test_a_command_gets_its_own_arguments(monkeypatch):
    given: list[Sequence[str]] = []
    before = list(sys.argv)
    monkeypatch.setattr("surface_gym.play.main", given.append)
    main(["play", "--task", "slow"])
    assert given == [["--task", "slow"]]
    assert sys.argv == before


def test_a_missing_library_is_reported_in_one_line(tmp_path):
    program = (
        f"import runpy, sys\nfor name, library in {MISSING}:\n"
        "    for each in list(sys.modules):\n"
        "        if each.startswith(f'surface_gym.{name}'): del sys.modules[each]\n"
        "    there, sys.modules[library] = sys.modules.get(library), None\n"
        "    sys.argv = ['it', '--figures', 'f']\n"
        "    try: runpy.run_module(f'surface_gym.{name}', run_name='__main__')\n"
        "    except SystemExit as end: print(end.code)\n"
        "    if there is None: del sys.modules[library]\n"
        "    else: sys.modules[library] = there\n"
    )
    assert run_python("-c", program, folder=tmp_path).splitlines() == [
        f"error: surface-gym {name} needs {library}, which is not installed: "
        f"pip install 'surface_gym[{COMMANDS[name].extra}]'"
        for name, library in MISSING
    ]


def test_another_missing_module_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "surface_gym.play", None)
    with pytest.raises(ModuleNotFoundError):
        main(["play"])
