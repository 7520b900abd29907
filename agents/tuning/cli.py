"""The command that starts or resumes a search of hyper-parameters: `surface-gym tune sweep.yml`, or
`train.py --search sweep.yml`.
"""

import argparse
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from surface_gym import files, parallel
from surface_gym.cli import TRAIN, command_line, typed

from ..library import task_files
from .sweep import Sweep, differences, read_sweep

if TYPE_CHECKING:
    from rich.console import Console

FILE = "sweep.yml"  # in a search's folder


def main(arguments: Sequence[str] | None = None) -> None:
    """Search hyper-parameters; an error ends it with one line."""
    parser = argparse.ArgumentParser(prog=typed("tune"), description=main.__doc__)
    parser.add_argument("file", type=Path, help="what to search, as docs/search.md says")
    parser.add_argument("--task", help="custom task of the search, as path/to/file.py:Class")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="folder for searches")
    parser.add_argument("--name", help="folder in there, which is resumed if it holds the search")
    parser.add_argument("--cluster", help="address of a Ray cluster to share the trials among")
    given = parser.parse_args(arguments)
    from rich.console import Console

    folder = given.out / (given.name or f"search-{given.file.stem}")
    try:
        workers = parallel.choose_workers(
            given.cluster, parallel.usable_cores(), task_files(given.task)
        )
        search(given.file, folder, workers, Console(), given.task)
    except (ValueError, parallel.WorkFailed) as error:
        sys.exit(f"error: {error}")


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


def open_folder(file: Path, folder: Path, task: str | None = None) -> Sweep:
    """Read the request of a search and keep it in the search's folder, which is made if need be."""
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
