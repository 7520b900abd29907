"""The command line of `train.py`: a new run's configuration, or an old run to go on with."""

import argparse
import inspect
from pathlib import Path
from typing import Any

import tyro

from agents.learning.config import CONFIGS, TrainConfig
from agents.learning.folder import make_folder, open_folder
from agents.learning.hyperparams import defaults
from agents.policy_card import FLOW_TASK

RESUME = (
    "--resume DIR, alone, goes on with a run that was broken off, from its last checkpoint; "
    "--task, too, says whose code is to be run where it is a task of one's own."
)


def open_run(arguments: list[str]) -> tuple[TrainConfig, Path]:
    """The configuration and the folder that the arguments ask for.

    `--task` and `--algo` are read first: the defaults of all other flags are theirs.

    Raises:
        ValueError: a field is out of its range, or the folder cannot be used.
    """
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--task")
    first.add_argument("--algo")
    first.add_argument("--resume", type=Path)
    chosen, _ = first.parse_known_args(arguments)
    if chosen.resume is not None:
        if len(arguments) > (2 if chosen.task is None else 4):
            raise ValueError(f"--resume must stand alone, got {' '.join(arguments)}")
        return open_folder(chosen.resume, chosen.task), chosen.resume
    task = chosen.task or "sort"
    usual = "parcels" if task == FLOW_TASK else "ppo"
    algo = chosen.algo if chosen.algo in CONFIGS else usual
    default = defaults(task, algo)
    kind: type[Any] = type(default)
    config = tyro.cli(
        kind,
        default=default,
        args=arguments,
        prog="train.py",
        description=f"{inspect.getdoc(kind)}\n\n{RESUME}",
    )
    return config, make_folder(config)
