"""Each command that a page shows is accepted by its own program; none is run."""

import argparse
import runpy
import shlex
import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import tyro

from surface_gym import cli
from surface_gym.agents.tuning import read_sweep
from tests.docs.reading import PAGES, ROOT, code_blocks

SHELL = ("sh", "")
# Programs of others, and learners that need environments of their own.
OTHERS = ("pip", "ray", "export", "source", "jupyter", "pytest", "git", "cd")
APART = ("rl_zoo3.train", "venv", "examples/learners/")
# Stand-ins for files that only a reader has.
STAND_INS = {
    "path/to/file.py:Class": "examples/reach.py:Reach",
    "runs/search-sweep/best.yml": "agents/hyperparams/ppo.yml",
}
BY_ARGPARSE = ("play", "web")  # commands that parse so
RESUMED = ("runs/NAME", "runs/search-sweep", "runs/first")


class Parsed(BaseException):
    """A program has parsed its arguments, and would begin."""


def find_commands(page: str) -> Iterator[str]:
    """Yield each command of a page by itself, without comments and line breaks."""
    for language, text in code_blocks(page):
        if language in SHELL:
            for line in text.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                for part in shlex.join(words).replace("'&&'", "&&").split("&&"):
                    if part.strip():
                        yield part.strip()


COMMANDS = sorted({each: page for page in PAGES for each in find_commands(page)}.items())


def then_stop(parse: Callable[..., Any]) -> Callable[..., Any]:
    def parse_and_stop(*args: Any, **kwargs: Any) -> Any:
        parsed = parse(*args, **kwargs)
        if kwargs.get("return_unknown_args") and parsed[1]:
            return parsed  # which are parsed next, or refused
        raise Parsed

    return parse_and_stop


@pytest.fixture
def stopping(monkeypatch):
    """Make programs stop when they have parsed their arguments."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(tyro, "cli", then_stop(tyro.cli))
    by_name = tyro.extras.subcommand_cli_from_dict
    monkeypatch.setattr(tyro.extras, "subcommand_cli_from_dict", then_stop(by_name))
    monkeypatch.syspath_prepend(ROOT / "docs")
    return monkeypatch


@pytest.mark.parametrize(("command", "page"), COMMANDS)
def test_a_program_accepts_the_command(command, page, stopping):
    words = [STAND_INS.get(word, word) for word in shlex.split(command)]
    if words[0] in OTHERS or "zensical" in words or "QUESTION" in words:
        return
    if "--cluster" in words:  # which asks whether Ray is there
        place = words.index("--cluster")
        words = words[:place] + words[place + 2 :]
    if words[0] == "surface-gym":
        program, arguments, begin = words[1], words[2:], partial(cli.main, words[1:])
        if program == "--help":
            return
        if program in BY_ARGPARSE:  # as `cli.main` does
            begin = partial(import_module(cli.COMMANDS[program].module).main, arguments)
    else:
        assert words[0] == "python", page
        is_module = words[1] == "-m"
        program, *arguments = words[1 + is_module :]
        if program.startswith(APART):
            assert is_module or (ROOT / program).is_file()
            return
        stopping.setattr(sys, "argv", [program, *arguments])
        stopping.delitem(sys.modules, program, raising=False)  # runpy begins with a fresh one
        run = runpy.run_module if is_module else runpy.run_path
        begin = partial(run, program, run_name="__main__")
    if program in ("train.py", "train") and "--resume" in arguments:
        assert arguments[:2] in [["--resume", folder] for folder in RESUMED]
        assert arguments[2:] in ([], ["--algo", "examples/reinforce.py:REINFORCE"])
        return
    if "--search" in arguments:
        assert read_sweep(Path(arguments[1])).trials > 0
        assert len(arguments) == 2
        return
    if program == "docs/pictures.py":
        return
    if words[0] == "python" or program in BY_ARGPARSE:
        take = argparse.ArgumentParser.parse_args
        stopping.setattr(argparse.ArgumentParser, "parse_args", then_stop(take))
    with pytest.raises(Parsed):
        begin()


def test_the_commands_are_found_and_an_unknown_flag_is_refused(stopping, capsys):
    commands = [command for command, _ in COMMANDS]
    for program in ("train.py", "evaluate.py", "surface-gym design", "surface-gym paper"):
        assert any(program in command for command in commands)
    stopping.setattr(sys, "argv", ["train.py", "--no-such-flag", "3"])
    with pytest.raises(SystemExit):
        runpy.run_path(str(ROOT / "train.py"), run_name="__main__")
    assert "no-such-flag" in "".join(capsys.readouterr())
