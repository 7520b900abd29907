"""Train an agent and compare it with the paper's fixed layout: `python train.py --help`."""

import sys

import tyro
from rich.console import Console

from agents.config import TrainConfig
from agents.policy import save_policy
from agents.run import make_run_folder, report
from agents.training import train


def main() -> None:
    """Train, save, compare."""
    console = Console()
    try:
        config = tyro.cli(TrainConfig)
        folder = make_run_folder(config)
    except ValueError as error:
        sys.exit(f"error: {error}")
    policy, card, model = train(config, folder, console)
    save_policy(model.policy, card, folder)
    report(policy, folder, console)


if __name__ == "__main__":
    main()
