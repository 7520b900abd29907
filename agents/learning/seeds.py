"""The seeds of a run, shared among workers, with a bar for each."""

from contextlib import suppress
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from surface_gym.sharing import Cluster, Job, Tell, Workers, share

from .config import TrainConfig
from .elsewhere import Elsewhere, put_files
from .folder import parts
from .legs import Learned, News
from .start import start


def train_seeds(
    config: TrainConfig, folder: Path, console: Console, workers: Workers
) -> list[Learned]:
    """Train every seed of a configuration, each in its folder; how each ended, in their order.

    An interrupt ends all of them, each with what it has learned so far; then there are fewer.

    Args:
        config: of the run.
        folder: of the run, which nodes of a cluster need not see.
        console: to show bars on.
        workers: processes to share the seeds among, or a cluster.

    Raises:
        ValueError: a checkpoint is damaged, or of another configuration.
    """
    runs = parts(config, folder)
    for _, own in runs:
        own.mkdir(exist_ok=True)
    jobs: list[Job[Learned]] = [
        Elsewhere(*run) if isinstance(workers, Cluster) else partial(_train, *run) for run in runs
    ]
    with _bars(console) as bars:
        rows = [bars.add_task(f"seed {run.seed}", total=run.steps, success="-") for run, _ in runs]

        def heard(place: int, news: News) -> None:
            put_files(news.files, runs[place][1])
            bars.update(rows[place], completed=news.steps)
            if news.success is not None:
                bars.update(rows[place], success=f"{news.success:.3f}")

        found: dict[int, Learned] = {}
        with suppress(KeyboardInterrupt):
            found.update(share(jobs, workers, heard))
        return [found[place] for place in sorted(found)]


def _train(config: TrainConfig, folder: Path, tell: Tell) -> Learned:
    return start(config, folder, lambda steps, success: tell(News(steps, success)))


def _bars(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
        TextColumn("success {task.fields[success]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )
