"""Train an agent and compare it with the paper's fixed layout; or search hyper-parameters."""

import sys

from rich.console import Console

from surface_gym.cores import usable_cores
from surface_gym.sharing import WorkFailed, workers_of

from ..search.command import search
from ..tasks import files_of
from .command import find_search, open_run, take_cluster
from .finish import finish
from .seeds import train_seeds


def main() -> None:
    """Train, save, compare; an error ends it with one line."""
    try:
        train(sys.argv[1:], Console())
    except (ValueError, WorkFailed) as error:
        sys.exit(f"error: {error}")


def train(arguments: list[str], console: Console) -> None:
    """What the arguments ask for."""
    cluster, arguments = take_cluster(arguments)
    asked = find_search(arguments)
    if asked is not None:
        workers = workers_of(cluster, usable_cores(), files_of(asked.task))
        search(asked.file, asked.folder, workers, console, asked.task)
        return
    workers_of(cluster, usable_cores())  # refused before there is a folder
    config, folder = open_run(arguments)
    workers = workers_of(cluster, usable_cores(), files_of(config.task))
    learned = train_seeds(config, folder, console, workers)
    finish(config, folder, learned, console, workers)
