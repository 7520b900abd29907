"""Each command that a page shows is one that its own program takes; none is run."""

import argparse
import runpy
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import tyro

from surface_gym.agents.tuning.sweep import read_sweep
from tests.docs.reading import PAGES, ROOT, blocks_of

SHELL = ("sh", "")
# Programs of others, and learners that need environments of their own.
OTHERS = ("pip", "ray", "export", "source", "zensical", "jupyter", "pytest", "git", "cd")
APART = ("rl_zoo3.train", "venv", "examples/learners/")
STANDS_FOR = {
    "path/to/file.py:Class": "examples/reach.py:Reach",
    "runs/search-sweep/best.yml": "agents/hyperparams/ppo.yml",
}
GONE_ON_WITH = ("runs/NAME", "runs/search-sweep", "runs/first")  # folders that only a reader has


class Parsed(BaseException):
    """A program has taken its arguments, and would begin."""


def commands_of(page: str) -> Iterator[str]:
    """Each command of a page by itself, comments and broken lines taken away."""
    for language, text in blocks_of(page):
        if language in SHELL:
            for line in text.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                for part in shlex.join(words).replace("'&&'", "&&").split("&&"):
                    if part.strip():
                        yield part.strip()


COMMANDS = sorted({(page, command) for page in PAGES for command in commands_of(page)})


def then_stop(parse: Callable[..., Any]) -> Callable[..., Any]:
    def parse_and_stop(*args: Any, **kwargs: Any) -> Any:
        parse(*args, **kwargs)
        raise Parsed

    return parse_and_stop


@pytest.fixture
def parsing_alone(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Programs stop when their arguments are taken."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(tyro, "cli", then_stop(tyro.cli))
    by_name = tyro.extras.subcommand_cli_from_dict
    monkeypatch.setattr(tyro.extras, "subcommand_cli_from_dict", then_stop(by_name))
    monkeypatch.syspath_prepend(ROOT / "docs")
    return monkeypatch


def program_of(words: list[str]) -> tuple[str, bool, list[str]]:
    """Of `python ...`: the file or module, whether it is a module, and the arguments."""
    if words[1] == "-m":
        return words[2], True, words[3:]
    return words[1], False, words[2:]


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_a_program_takes_the_command(
    page: str, command: str, parsing_alone: pytest.MonkeyPatch
) -> None:
    words = [STANDS_FOR.get(word, word) for word in shlex.split(command)]
    if words[0] in OTHERS:
        return
    if words[0] == "surface-gym":
        from surface_gym.cli import COMMANDS as known

        assert words[1] == "--help" or words[1] in known, page
        return
    assert words[0] == "python", page
    program, is_module, arguments = program_of(words)
    if program.startswith(APART):
        assert is_module or (ROOT / program).is_file()
        return
    if "--cluster" in arguments:  # which asks whether Ray is there
        place = arguments.index("--cluster")
        arguments = arguments[:place] + arguments[place + 2 :]
    if "--resume" in arguments and program == "train.py":
        assert arguments in [["--resume", folder] for folder in GONE_ON_WITH]
        return
    if "--search" in arguments:
        assert read_sweep(Path(arguments[1])).trials > 0
        assert len(arguments) == 2
        return
    if "QUESTION" in arguments or program == "docs/pictures.py":
        return
    take = argparse.ArgumentParser.parse_args
    parsing_alone.setattr(argparse.ArgumentParser, "parse_args", then_stop(take))
    parsing_alone.setattr(sys, "argv", [program, *arguments])
    parsing_alone.delitem(sys.modules, program, raising=False)  # runpy begins with a fresh one
    begin = runpy.run_module if is_module else runpy.run_path
    with pytest.raises(Parsed):
        begin(program if is_module else str(ROOT / program), run_name="__main__")


def test_the_commands_are_found() -> None:
    told = [command for _, command in COMMANDS]
    for program in ("train.py", "evaluate.py", "surface_gym.design", "surface_gym.paper"):
        assert any(program in command for command in told)


def test_a_flag_that_there_is_not_is_refused(
    parsing_alone: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    parsing_alone.setattr(sys, "argv", ["train.py", "--no-such-flag", "3"])
    with pytest.raises(SystemExit):
        runpy.run_path(str(ROOT / "train.py"), run_name="__main__")
    assert "no-such-flag" in "".join(capsys.readouterr())
