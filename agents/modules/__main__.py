"""Train modules that decide for themselves: `python -m agents.modules --help`."""

import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import tyro
from rich.console import Console

from agents.cores import usable_cores
from agents.evaluation.contenders import rules, trained
from agents.evaluation.report import compare_run
from agents.learning.card import write_card
from agents.modules.config import ModulesConfig
from agents.modules.training import train_modules
from surface_gym import checks


@dataclass(frozen=True, kw_only=True)
class Command(ModulesConfig):
    """Train modules that decide for themselves to sort, by PPO with draws they share.

    A folder that holds a run broken off is gone on with.
    """

    seeds: int = 1
    """Trained one after the other."""
    out: Path = Path("runs/sort-modules")
    """Folder for a folder a seed, and the comparison with the fixed layout."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.integer("seeds", self.seeds, least=1)


def main() -> None:
    """Train, compare."""
    command = tyro.cli(Command)
    console = Console()
    folders = {
        seed: command.out / f"seed-{seed}"
        for seed in range(command.seed, command.seed + command.seeds)
    }
    learned = []
    try:
        for seed, folder in folders.items():
            folder.mkdir(parents=True, exist_ok=True)
            learned.append(train_modules(replace(command, seed=seed), folder, console))
            if learned[-1].interrupted:
                sys.exit("interrupted: the same command goes on from the last checkpoint")
    except ValueError as error:
        sys.exit(f"error: {error}")
    agent = trained(folders)
    summaries = compare_run(rules("sort")[0], agent, usable_cores(), command.out, console)
    words = shlex.join(["python", "-m", "agents.modules", *sys.argv[1:]])
    write_card(words, list(folders), learned, summaries, agent, command.out)
    console.print(f"everything is in {command.out}")


if __name__ == "__main__":
    main()
