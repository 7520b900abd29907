"""Training of a configuration: one run, all its seeds in parallel, or on nodes of a cluster."""

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from surface_gym.files import SUFFIX, replacing
from surface_gym.parallel import Cluster, Job, Report, Workers, map_jobs

from .config import DQNConfig, ModulesConfig, PPOConfig, TrainConfig, on_device
from .runs import CHECKPOINT, OnProgress, Progress, TrainResult, seed_folders


def train(
    config: TrainConfig, folder: Path, on_progress: OnProgress = lambda *_: None
) -> TrainResult:
    """Train one seed by the configuration's algorithm and leave a policy in `folder`.

    A run with a checkpoint is resumed. An interrupt, or `StopTraining` raised by `on_progress`,
    saves the policy as it is.
    """
    if isinstance(config, ModulesConfig):
        from .modules import train_modules

        return train_modules(config, folder, on_progress)
    if on_device(config):
        from .cuda import train_on_device

        return train_on_device(config, folder, on_progress)
    from .sb3 import train_sb3

    assert isinstance(config, PPOConfig | DQNConfig)
    return train_sb3(config, folder, on_progress)


def train_seeds(
    config: TrainConfig, folder: Path, console: Console, workers: Workers
) -> list[TrainResult]:
    """Train every seed of a configuration, each in its folder; return their results in order.

    An interrupt ends all of them, each with what it has learned so far; then there are fewer.
    """
    runs = seed_folders(config, folder)
    for _, own in runs:
        own.mkdir(exist_ok=True)
    jobs: list[Job[TrainResult]] = [
        RemoteRun(*run) if isinstance(workers, Cluster) else partial(_train, *run) for run in runs
    ]
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
        TextColumn("success {task.fields[success]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=console) as bars:
        rows = [bars.add_task(f"seed {run.seed}", total=run.steps, success="-") for run, _ in runs]

        def on_report(index: int, progress: Progress) -> None:
            put_files(progress.files, runs[index][1])
            bars.update(rows[index], completed=progress.steps)
            if progress.success is not None:
                bars.update(rows[index], success=f"{progress.success:.3f}")

        found: dict[int, TrainResult] = {}
        with suppress(KeyboardInterrupt):
            found.update(map_jobs(jobs, workers, on_report))
        return [found[index] for index in sorted(found)]


def _train(config: TrainConfig, folder: Path, report: Report) -> TrainResult:
    return train(config, folder, lambda steps, success: report(Progress(steps, success)))


@dataclass(frozen=True)
class RemoteRun:
    """A run for a node of a cluster, which works in a temporary folder of its own.

    It is sent with the files that its folder holds at that moment, so that it is resumed from its
    last checkpoint if a node has died. Files that it writes are sent back with its progress.
    """

    config: TrainConfig
    folder: Path

    def __call__(self, report: Report) -> TrainResult:
        return _train_remotely(self.config, read_files(self.folder), report)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial, (_train_remotely, self.config, read_files(self.folder))


def read_files(folder: Path) -> dict[str, bytes]:
    """Read all files of a folder, by their names in it."""
    return {name: (folder / name).read_bytes() for name in _stamps(folder)}


def put_files(files: dict[str, bytes], folder: Path) -> None:
    """Write files, each whole or not at all; the checkpoint last, since the others belong to it."""
    for name in sorted(files, key=lambda name: name == CHECKPOINT):
        with replacing(folder / name) as part:
            part.write_bytes(files[name])


def _train_remotely(config: TrainConfig, files: dict[str, bytes], report: Report) -> TrainResult:
    with TemporaryDirectory() as name:
        folder = Path(name)
        put_files(files, folder)
        sent = _stamps(folder)

        def changed() -> dict[str, bytes]:
            nonlocal sent
            before, sent = sent, _stamps(folder)
            return {
                name: (folder / name).read_bytes()
                for name, stamp in sent.items()
                if before.get(name) != stamp
            }

        result = train(
            config, folder, lambda steps, success: report(Progress(steps, success, changed()))
        )
        report(Progress(result.steps, None, changed()))
        return result


def _stamps(folder: Path) -> dict[str, tuple[int, int]]:
    return {
        file.relative_to(folder).as_posix(): (file.stat().st_mtime_ns, file.stat().st_size)
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file.suffix != SUFFIX
    }
