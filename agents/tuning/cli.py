"""Start or resume a search of hyper-parameters, as `train.py --search sweep.yml` does."""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from surface_gym import files, parallel
from surface_gym.cli import TRAIN, command_line

if TYPE_CHECKING:
    from rich.console import Console

    from .sweep import SearchConfig

FILE = "sweep.yml"  # in a search's folder


def search(
    file: Path, folder: Path, workers: parallel.Workers, console: "Console", task: str | None = None
) -> None:
    """Search hyper-parameters and leave a report in a folder, or resume a search there."""
    parallel.check_workers(workers)
    if find_spec("optuna") is None:
        raise ValueError(
            "search needs optuna, which is not installed: pip install 'surface_gym[search]'"
        )
    from . import study

    sweep = open_folder(file, folder, task)
    with study.open_study(sweep, folder) as opened:
        try:
            study.optimize(sweep, opened, workers, console, study.run_trial)
        except KeyboardInterrupt:
            kept = len(study.finished_trials(opened))
            console.print(
                f"interrupted: {folder} holds {kept} trials; "
                f"{command_line(TRAIN, '--resume', str(folder))} resumes it",
                soft_wrap=True,
            )
            return
        study.write_report(sweep, opened, folder)
        trials = study.finished_trials(opened)
    console.print(study.summary(sweep, trials))
    best = "" if study.best_trial(trials) is None else f" and {study.BEST}"
    console.print(f"{folder} holds {study.PAGE}{best}", soft_wrap=True)


def open_folder(file: Path, folder: Path, task: str | None = None) -> "SearchConfig":
    """Read the request of a search and keep it in the search's folder, which is made if need be."""
    from .sweep import differences, read_sweep

    sweep = read_sweep(file, task)
    kept = folder / FILE
    if kept.is_file():
        before = read_sweep(kept, task)
        if found := differences(before, sweep):
            raise ValueError(f"folder must be of this search, got {folder}: {'; '.join(found)}")
        return before
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"folder must be new, or a search's, got {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    with files.replacing(kept) as part:
        part.write_bytes(file.read_bytes())
    return sweep
