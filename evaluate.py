"""Compare a saved policy with the paper's fixed layout: `python evaluate.py --help`."""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console

from agents.policy import load_policy
from agents.run import report


@dataclass(frozen=True)
class EvaluateConfig:
    """Compare a saved policy with the paper's fixed layout."""

    run: Path
    """Folder of a run, as `train.py` leaves it."""
    out: Path | None = None
    """Folder for table, plot and video; by default the run's `evaluation`."""


def main() -> None:
    """Load, compare."""
    config = tyro.cli(EvaluateConfig)
    try:
        policy = load_policy(config.run)
    except ValueError as error:
        sys.exit(f"error: {error}")
    folder = config.out or config.run / "evaluation"
    folder.mkdir(parents=True, exist_ok=True)
    report(policy, folder, Console())


if __name__ == "__main__":
    main()
