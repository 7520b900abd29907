"""A run's folder: what it was asked for, and where each seed's files lie."""

import sys
from datetime import datetime
from pathlib import Path

from ..programs import TRAIN, typed
from ..tasks import label_of
from .config import TrainConfig
from .hyperparams import of_seed, read_config, write_config

CONFIG = "config.yaml"
COMMAND = "command.txt"


def make_folder(config: TrainConfig) -> Path:
    """A new folder that holds the resolved configuration and the command.

    Raises:
        ValueError: the folder exists.
    """
    which = f"seed{config.seed}" if config.seeds == 1 else f"{config.seeds}seeds"
    name = (
        config.name
        or f"{label_of(config.task)}-{config.algo}-{which}-{datetime.now():%Y%m%d-%H%M%S}"
    )
    folder = config.out / name
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise ValueError(
            f"name must be that of a new folder, got {folder}; --resume {folder} goes on with it"
        ) from None
    write_config(config, folder / CONFIG)
    (folder / COMMAND).write_text(typed(TRAIN, *sys.argv[1:]) + "\n")
    return folder


def open_folder(folder: Path, task: str | None = None) -> TrainConfig:
    """The configuration of a run to go on with.

    Args:
        folder: of the run.
        task: that it must be of; None: one of the package, since a file must not say what code is
            run.

    Raises:
        ValueError: the folder holds no run, or one of another task.
    """
    return read_config(folder / CONFIG, task)


def parts(config: TrainConfig, folder: Path) -> list[tuple[TrainConfig, Path]]:
    """Each seed's configuration and folder, which is the run's own where there is only one."""
    if config.seeds == 1:
        return [(config, folder)]
    return [
        (of_seed(config, seed), folder / f"seed-{seed}")
        for seed in range(config.seed, config.seed + config.seeds)
    ]
