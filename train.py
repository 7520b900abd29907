"""Train an agent and compare it with the paper's fixed layout: `python train.py --help`."""

import sys

from rich.console import Console

from agents.learning.command import open_run, open_search, take_cluster
from agents.learning.finish import finish
from agents.learning.seeds import train_seeds
from agents.search.command import search
from agents.workers import workers_of
from surface_gym.cores import usable_cores
from surface_gym.sharing import WorkFailed


def main() -> None:
    """Train, save, compare; or search hyper-parameters."""
    try:
        train(sys.argv[1:], Console())
    except (ValueError, WorkFailed) as error:
        sys.exit(f"error: {error}")


def train(arguments: list[str], console: Console) -> None:
    """What the arguments ask for."""
    cluster, arguments = take_cluster(arguments)
    asked = open_search(arguments)
    if asked is not None:
        workers = workers_of(cluster, usable_cores(), asked.task)
        search(asked.file, asked.folder, workers, console, asked.task)
        return
    workers_of(cluster, usable_cores(), None)  # refused before there is a folder
    config, folder = open_run(arguments)
    workers = workers_of(cluster, usable_cores(), config.task)
    learned = train_seeds(config, folder, console, workers)
    finish(config, folder, learned, console, workers)


if __name__ == "__main__":
    main()
