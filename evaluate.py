"""Compare every controller and agent on every task: `python evaluate.py --help`."""

import sys

import tyro
from rich.console import Console

from agents.evaluation.command import EvaluateConfig, evaluate
from surface_gym.sharing import WorkFailed


def main() -> None:
    """Compare."""
    config = tyro.cli(EvaluateConfig)
    try:
        evaluate(config, Console())
    except (ValueError, WorkFailed) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted; --resume goes on with what is there")


if __name__ == "__main__":
    main()
