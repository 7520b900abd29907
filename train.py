"""Train an agent and compare it with the paper's fixed layout: `python train.py --help`."""

import sys

from rich.console import Console

from agents.learning.command import open_run
from agents.learning.finish import finish
from agents.learning.seeds import train_seeds


def main() -> None:
    """Train, save, compare."""
    console = Console()
    try:
        config, folder = open_run(sys.argv[1:])
        learned = train_seeds(config, folder, console)
    except ValueError as error:
        sys.exit(f"error: {error}")
    finish(config, folder, learned, console)


if __name__ == "__main__":
    main()
