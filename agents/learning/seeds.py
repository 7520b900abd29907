"""The seeds of a run, each in a process of its own, with a bar for each."""

from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, wait
from multiprocessing import get_context
from pathlib import Path
from queue import Empty
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars

from agents.learning.config import DQNConfig, ModulesConfig, PPOConfig, TrainConfig
from agents.learning.folder import parts
from agents.learning.legs import Learned, Progress
from agents.learning.modules.training import train_modules
from agents.learning.training import train
from surface_gym.cores import usable_cores

POLL = 0.2  # [s] between looks at what the processes report


def train_seeds(config: TrainConfig, folder: Path, console: Console) -> list[Learned]:
    """Train every seed of a configuration; how each ended, in the order of the seeds.

    An interrupt ends all of them, each with what it has learned so far.
    """
    runs = parts(config, folder)
    with _bars(console) as bars:
        rows = [
            bars.add_task(f"seed {run.seed}", total=config.steps, success="-") for run, _ in runs
        ]
        if len(runs) == 1:
            return [_train(*runs[0], _mover(bars, rows[0]))]
        return _train_apart(runs, bars, rows)


def _bars(console: Console) -> Bars:
    return Bars(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
        TextColumn("success {task.fields[success]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )


def _train(config: TrainConfig, folder: Path, progress: Progress) -> Learned:
    if isinstance(config, ModulesConfig):
        return train_modules(config, folder, progress)
    assert isinstance(config, PPOConfig | DQNConfig)
    return train(config, folder, progress)


def _mover(bars: Bars, row: TaskID) -> Callable[[int, float], None]:
    def move(steps: int, success: float) -> None:
        bars.update(row, completed=steps, success=f"{success:.3f}")

    return move


def _train_apart(
    runs: list[tuple[TrainConfig, Path]], bars: Bars, rows: list[TaskID]
) -> list[Learned]:
    context = get_context("spawn")
    workers = min(len(runs), usable_cores())
    with context.Manager() as manager, ProcessPoolExecutor(workers, context) as pool:
        reports = manager.Queue()
        waiting = [
            pool.submit(_train_reported, *run, row, reports)
            for run, row in zip(runs, rows, strict=True)
        ]
        try:
            _follow(waiting, reports, bars)
        except KeyboardInterrupt:  # which the processes have got as well
            for future in waiting:
                future.cancel()
        return [future.result() for future in waiting if not future.cancelled()]


def _follow(waiting: list[Future[Learned]], reports: Any, bars: Bars) -> None:
    """Move the bars as long as a process works."""
    left = set(waiting)
    while left:
        _, left = wait(left, timeout=POLL)
        while True:
            try:
                row, steps, success = reports.get_nowait()
            except Empty:
                break
            _mover(bars, row)(steps, success)


def _train_reported(config: TrainConfig, folder: Path, row: TaskID, reports: Any) -> Learned:
    folder.mkdir(exist_ok=True)
    return _train(config, folder, lambda steps, success: reports.put((row, steps, success)))
