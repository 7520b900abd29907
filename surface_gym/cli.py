"""`surface-gym`: every command of the package. A command imports its libraries when it runs."""

import argparse
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

NAME = "surface-gym"
# A file of the checkout, or a command of the installed package.
IN_CHECKOUT = (Path(__file__).parents[1] / "train.py").is_file()
TRAIN = ("python", "train.py") if IN_CHECKOUT else (NAME, "train")
AGENTS = "surface_gym.agents."
# Libraries that come with an extra.
OPTIONAL = (
    "matplotlib", "minari", "moviepy", "mujoco", "pandas", "rich", "stable_baselines3", "torch",
    "tyro", "yaml",
)  # fmt: skip


@dataclass(frozen=True)
class Command:
    """A command of the package."""

    summary: str
    module: str  # with `main(arguments)`
    extra: str = "agents"  # extra of surface_gym with its libraries


COMMANDS = {
    "train": Command("train an agent, or search hyper-parameters", AGENTS + "train_cli"),
    "evaluate": Command("compare controllers and agents on every task", AGENTS + "evaluation.cli"),
    "benchmark": Command("enter a policy into the benchmark", AGENTS + "benchmark.cli"),
    "dataset": Command(
        "record episodes for offline learning", AGENTS + "dataset_cli", "agents,data"
    ),
    "design": Command("choose a surface for your own parcel", "surface_gym.design.cli", "tools"),
    "export": Command("write an agent as ONNX, checked", AGENTS + "export.cli"),
    "runtime": Command("run an agent in real time, simulated or not", AGENTS + "runtime.cli"),
    "identify": Command(
        "learn a surface's friction from logs", "surface_gym.machine.command", "tools"
    ),
    "compile": Command("compile environments and agents beforehand", AGENTS + "export.kernels"),
    "web": Command("compile environments for a browser", "surface_gym.web.build", "web"),
    "play": Command("throw parcels and turn axes, in a browser", "surface_gym.play", "tools"),
    "paper": Command("compare the study's tables with ours", "surface_gym.paper.command", "tools"),
    "validation": Command(
        "compare the model with MuJoCo", "surface_gym.validation.__main__", "validation"
    ),
}  # fmt: skip


def command_line(program: Sequence[str], *arguments: str) -> str:
    """Join a program, e.g. `TRAIN`, and its arguments into a shell command."""
    return shlex.join([*program, *arguments])


def typed(name: str) -> str:
    """Return how a command was typed, e.g. `surface-gym design` or `python train.py`."""
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    if spec is not None and spec.name.startswith("surface_gym."):
        return f"python -m {spec.name.removesuffix('.__main__')}"
    file = Path(sys.argv[0]).name
    return f"python {file}" if file == f"{name}.py" else f"{NAME} {name}"


def parse_options(kind: Any, name: str, arguments: Sequence[str] | None, **settings: Any) -> Any:
    """Parse options by the library tyro. An unknown option ends the program with status 2.

    Args:
        kind: the dataclass of the options, or a union with one dataclass for each subcommand.
        settings: other arguments of `tyro.cli`.
    """
    import tyro

    given = list(sys.argv[1:] if arguments is None else arguments)
    found, unknown = tyro.cli(
        kind, prog=typed(name), args=given, return_unknown_args=True, **settings
    )
    if unknown:
        option = unknown[0].partition("=")[0]
        near = get_close_matches(option, _list_options(found), 1)
        meant = f"; did you mean {near[0]}?" if near else ""
        print(f"error: {typed(name)} has no option {option}{meant}", file=sys.stderr)
        raise SystemExit(2)
    return found


def make_table(title: str, *columns: str, caption: str = "", labels: int = 1) -> Any:
    """Make a `rich.table.Table` with `labels` columns of text, then columns of numbers."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(  # Text, since bracketed units in a str would be markup
        title=Text(title, style="bold not italic"),
        caption=Text(caption, style="not italic not dim") if caption else None,
        title_justify="left",
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for k, column in enumerate(columns):
        number = k >= labels
        table.add_column(Text(column), justify="right" if number else "left", no_wrap=number)
    return table


def _list_options(parsed: Any) -> list[str]:
    """List the options of a parsed dataclass, and of the dataclasses in its fields."""
    names = []
    for each in fields(parsed):
        value = getattr(parsed, each.name)
        inner = _list_options(value) if is_dataclass(value) else []
        names += inner or [f"--{each.name.replace('_', '-')}"]
    return names


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command that the first argument names; the default arguments are `sys.argv[1:]`."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    width = max(map(len, COMMANDS))
    lines = (f"  {name:{width}}  {each.summary}" for name, each in COMMANDS.items())
    parser = argparse.ArgumentParser(
        prog=NAME,
        description="A smart surface that steers parcels by friction.",
        epilog="commands:\n" + "\n".join(lines) + f"\n\nSee also `{NAME} COMMAND --help`.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="show the version and exit")
    parser.add_argument(
        "command", choices=COMMANDS, metavar="COMMAND", help="one of the commands below"
    )
    if given[:1] == ["--version"]:
        from surface_gym import __version__

        print(f"{NAME} {__version__}")
    elif not given:
        parser.print_help()
    else:
        run_command(parser.parse_args(given[:1]).command, given[1:])


def run_command(name: str, arguments: Sequence[str] | None = None) -> None:
    """Run a command; if a library is missing, exit and say which extra of pip installs it."""
    command = COMMANDS[name]
    try:
        import_module(command.module).main(list(sys.argv[1:] if arguments is None else arguments))
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in OPTIONAL:
            raise
        sys.exit(
            f"error: {NAME} {name} needs {library}, which is not installed: "
            f"pip install 'surface_gym[{command.extra}]'"
        )
