"""Train an agent and compare it with the paper's fixed layout: `python train.py --help`."""

import sys

from rich.console import Console

from agents.learning.command import find_search, open_run, take_cluster
from agents.learning.finish import finish
from agents.learning.seeds import train_seeds
from agents.search.command import search
from agents.tasks import files_of
from surface_gym.cores import usable_cores
from surface_gym.sharing import WorkFailed, workers_of


def main() -> None:
    """Train, save, compare; or search hyper-parameters."""
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


if __name__ == "__main__":
    main()
