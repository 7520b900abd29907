"""`surface-gym`: every command of the package by one name, once it is installed."""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

from surface_gym.commands import run
from surface_gym.find_agents import import_agents

NAME = "surface-gym"


@dataclass(frozen=True)
class Command:
    """One of the commands."""

    told: str  # what it does, in a line
    importing: Callable[[str], ModuleType]  # of its module, which has a `main`
    module: str
    extra: str = "agents"  # of surface_gym, which brings its libraries

    def main(self) -> None:
        """Import it, only now, and run it."""
        self.importing(self.module).main()


COMMANDS = {
    "train": Command("train an agent, or search hyper-parameters", import_agents, "learning.main"),
    "evaluate": Command(
        "compare controllers and agents on every task", import_agents, "evaluation.main"
    ),
    "design": Command(
        "which surface a parcel of your own needs", import_module, "surface_gym.design.cli"
    ),
    "export": Command("an agent as ONNX and as C, checked", import_agents, "export.command"),
    "runtime": Command(
        "run an agent in real time, on a simulator of its own or a device",
        import_agents,
        "runtime.command",
    ),
    "play": Command(
        "push a parcel with the mouse, turn axes by keys", import_module, "surface_gym.play"
    ),
    "paper": Command("the study's tables beside ours", import_module, "surface_gym.paper.command"),
    "validation": Command(
        "the model beside MuJoCo", import_module, "surface_gym.validation.command", "validation"
    ),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command that is asked for, with all that stands behind its name.

    Args:
        arguments: of the command line; None: those of the process.
    """
    from surface_gym import __version__

    given = list(sys.argv[1:] if arguments is None else arguments)
    width = max(map(len, COMMANDS))
    parser = argparse.ArgumentParser(
        prog=NAME,
        description="A smart surface that steers parcels by friction.",
        epilog="commands:\n"
        + "\n".join(f"  {name:{width}}  {each.told}" for name, each in COMMANDS.items())
        + f"\n\n`{NAME} COMMAND --help` tells what each takes.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"{NAME} {__version__}")
    parser.add_argument("command", choices=COMMANDS, metavar="COMMAND", help="one of those below")
    name = parser.parse_args(given[:1]).command
    asked = COMMANDS[name]
    sys.argv = [f"{NAME} {name}", *given[1:]]
    run(asked.main, f"{NAME} {name}", asked.extra)
