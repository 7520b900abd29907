"""`surface-gym dataset`: record episodes as a data set of Minari."""

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from surface_gym import checks, parallel
from surface_gym.cli import parse_options
from surface_gym.executors import WorkError, describe_error

if TYPE_CHECKING:
    from rich.console import Console

EPISODES = 10_000
MAX_EPISODES = 10**7
MAX_SEED = 10**9  # of the first episode; seeds of the benchmark's episodes are larger
NAMESPACE = "smart-surface"
INTERRUPTED = 130  # exit code after Ctrl-C


@dataclass(frozen=True)
class DatasetConfig:
    """Record episodes of a task as a data set of Minari, for offline learning.

    `minari.load_dataset(NAME)` loads the data set, which also contains reference scores.
    """

    task: tyro.conf.Positional[str]
    """Task of the package."""
    policy: str = "rule"
    """Who acts: a recipe ("random", "rule", "planner", "agent", "mixed", "lab"), a method of the
    task as "event rule", a shipped agent as "sort-ppo", or the folder of a run.
    """
    episodes: int = EPISODES
    """Number of episodes."""
    seed: int = 0
    """Seed of the first episode; episode k has this seed plus k."""
    preset: str | None = None
    """Sensors, randomisation and actuators, e.g. "lab"; the default is the recipe's."""
    name: str = ""
    """Name of the data set; the default is smart-surface/TASK/POLICY-v0."""
    workers: int = parallel.usable_cores()
    """Number of processes; the data set does not depend on it."""

    def __post_init__(self) -> None:
        checks.integer("episodes", self.episodes, least=1, most=MAX_EPISODES)
        checks.integer("seed", self.seed, least=0, most=MAX_SEED)
        parallel.check_workers(self.workers)

    @property
    def title(self) -> str:
        policy = re.sub(r"\W+", "-", Path(self.policy).name.lower()).strip("-")
        preset = "" if self.preset is None else f"-{self.preset}"
        return self.name or f"{NAMESPACE}/{self.task}/{policy}{preset}-v0"


def record(config: DatasetConfig, console: "Console") -> None:
    """Write a data set, show a progress bar, and print the mean results of the episodes."""
    from .datasets import find_recipe, plan_episodes, plan_references, write_dataset
    from .evaluation.results import show_progress

    recipe, name = find_recipe(config.task, config.policy, config.preset), config.title
    planned = plan_episodes(recipe, config.seed, config.episodes)
    with show_progress(console, "dataset", len(plan_references(recipe)) + len(planned)) as advance:
        score = write_dataset(name, recipe, config.seed, config.episodes, config.workers, advance)
    console.print(
        f"{score.episodes} episodes: mean return {score.mean_return:.2f}, "
        f"success {score.success:.3f}; load them by minari.load_dataset({name!r})",
        soft_wrap=True,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; after an error, print one line and exit."""
    from rich.console import Console

    try:
        record(parse_options(DatasetConfig, "dataset", arguments), Console())
    except (ValueError, WorkError) as error:
        sys.exit(f"error: {describe_error(error)}")
    except KeyboardInterrupt:
        print(
            "interrupted: no data set was written; the same command begins again", file=sys.stderr
        )
        sys.exit(INTERRUPTED)
