"""`surface-gym`: every command of the package by one name, once it is installed."""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module

from surface_gym.commands import run
from surface_gym.find_agents import import_agents

NAME = "surface-gym"


@dataclass(frozen=True)
class Command:
    """One of the commands."""

    told: str  # what it does, in a line
    module: str  # whose `main` it runs
    by_agents: bool = False  # the module is one of the package of agents
    extra: str = ""  # of surface_gym, which brings its libraries

    def main(self) -> Callable[[], None]:
        """Its function, imported only now."""
        found = import_agents(self.module) if self.by_agents else import_module(self.module)
        main: Callable[[], None] = found.main
        return main


COMMANDS = {
    "train": Command("train an agent, or search hyper-parameters", "learning.main", True, "agents"),
    "evaluate": Command(
        "compare controllers and agents on every task", "evaluation.main", True, "agents"
    ),
    "design": Command(
        "which surface a parcel of your own needs", "surface_gym.design.command", extra="agents"
    ),
    "play": Command(
        "push a parcel with the mouse, turn axes by keys", "surface_gym.play", extra="agents"
    ),
    "paper": Command("the study's tables beside ours", "surface_gym.paper.command", extra="agents"),
    "validation": Command(
        "the model beside MuJoCo", "surface_gym.validation.command", extra="validation"
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
    run(lambda: asked.main()(), f"{NAME} {name}", asked.extra)
