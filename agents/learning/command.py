"""The command line of `train.py`: a new run's configuration, an old run to go on with, a search."""

import argparse
import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import tyro

from ..policy_card import FLOW_TASK
from ..programs import TRAIN, typed
from ..search.command import FILE as SWEEP
from .config import CONFIGS, CPU, NOMINAL, ConditionName, DeviceName, TrainConfig, on_device
from .device.training import check_device
from .folder import make_folder, open_folder
from .hyperparams import defaults

MORE = (
    "--resume DIR, alone, goes on with a run or a search that was broken off, from what is there; "
    "--task, too, says whose code is to be run where it is a task of one's own. "
    "--hyperparams FILE takes the defaults from a file of one's own. "
    "--search FILE, alone, searches hyper-parameters as the file says. "
    "--cluster ADDRESS shares the work of any of these among the nodes of a Ray cluster, "
    "auto for the one that this machine has joined."
)


@dataclass(frozen=True)
class Search:
    """A search of hyper-parameters that is asked for."""

    file: Path  # what to search
    folder: Path
    task: str | None  # of one's own, whose code may be run


def take_cluster(arguments: list[str]) -> tuple[str | None, list[str]]:
    """The cluster's address, if one is given, and the other arguments."""
    first = _parser()
    first.add_argument("--cluster")
    chosen, others = first.parse_known_args(arguments)
    return chosen.cluster, others


def find_search(arguments: list[str]) -> Search | None:
    """The search that the arguments ask for, new or to go on with; None: they ask for none.

    Raises:
        ValueError: other arguments stand beside it, or the folder of a new one exists.
    """
    first = _parser()
    first.add_argument("--search", type=Path)
    first.add_argument("--resume", type=Path)
    first.add_argument("--task")
    first.add_argument("--out", type=Path, default=Path("runs"))
    first.add_argument("--name")
    chosen, others = first.parse_known_args(arguments)
    if chosen.search is None:
        if chosen.resume is None or not (chosen.resume / SWEEP).is_file():
            return None
        _alone(arguments, chosen.task)
        return Search(chosen.resume / SWEEP, chosen.resume, chosen.task)
    if others or chosen.resume is not None:
        raise ValueError(
            f"--search must stand alone, or beside --task, --out and --name, got "
            f"{' '.join(arguments)}"
        )
    folder = chosen.out / (chosen.name or f"search-{chosen.search.stem}")
    if folder.exists():
        raise ValueError(
            f"name must be that of a new folder, got {folder}; --resume {folder} goes on with it"
        )
    return Search(chosen.search, folder, chosen.task)


def open_run(arguments: list[str]) -> tuple[TrainConfig, Path]:
    """The configuration and the folder that the arguments ask for.

    `--task`, `--algo`, `--condition`, `--device` and `--hyperparams` are read first: the defaults
    of all other flags are theirs.

    Raises:
        ValueError: a field is out of its range, or the device or the folder cannot be used.
    """
    first = _parser()
    first.add_argument("--task")
    first.add_argument("--algo")
    first.add_argument("--condition")
    first.add_argument("--device")
    first.add_argument("--resume", type=Path)
    chosen, _ = first.parse_known_args(arguments)
    if chosen.resume is not None:
        _alone(arguments, chosen.task)
        return open_folder(chosen.resume, chosen.task), chosen.resume
    own = _parser()
    own.add_argument("--hyperparams", type=Path)
    of_file, arguments = own.parse_known_args(arguments)
    task = chosen.task or "sort"
    usual = "parcels" if task == FLOW_TASK else "ppo"
    algo = chosen.algo if chosen.algo in CONFIGS else usual
    condition = chosen.condition if chosen.condition in get_args(ConditionName) else NOMINAL
    device = chosen.device if chosen.device in get_args(DeviceName) else CPU
    default = defaults(task, algo, of_file.hyperparams, condition, device)
    kind: type[Any] = type(default)
    config = tyro.cli(
        kind,
        default=default,
        args=arguments,
        prog=typed(TRAIN),
        description=f"{inspect.getdoc(kind)}\n\n{MORE}",
    )
    if on_device(config):
        check_device(config)
    return config, make_folder(config)


def _parser() -> argparse.ArgumentParser:
    return argparse.ArgumentParser(add_help=False, allow_abbrev=False)


def _alone(arguments: list[str], task: str | None) -> None:
    if len(arguments) > (2 if task is None else 4):
        raise ValueError(f"--resume must stand alone, got {' '.join(arguments)}")
