"""`train.py`: train an agent, resume a run, or search hyper-parameters."""

import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields, make_dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import tyro

from surface_gym.cli import TRAIN, command_line, parse_options
from surface_gym.executors import Cluster, Processes, WorkError, describe_error
from surface_gym.parallel import Workers, choose_workers, usable_cores
from surface_gym.registration import DEFAULT_TASK, TASKS

from .learning import config as configs
from .learning.algorithms import PPOConfig
from .learning.config import SWEEP, TrainConfig
from .library import ALGORITHMS, find_task, task_files

LOADED = 6  # maximum number of processes that load while a policy trains: one for each result


@dataclass(frozen=True)
class Options:
    """Options of the command that are not part of a run's configuration."""

    resume: Path | None = None
    """Resume an interrupted run or search. Custom tasks and algorithms must also be named by --task
    or --algo, since a file must not select code to execute.
    """
    search: Path | None = None
    """Search hyper-parameters as defined by this file; only with --task, --out and --name."""
    hyperparams: Path | None = None
    """File of hyper-parameters with the defaults."""
    cluster: str | None = None
    """Address of a Ray cluster to use instead; "auto" for the cluster of this machine."""


@dataclass(frozen=True)
class _Selection(Options):
    """Options that determine the defaults of all other options."""

    task: str | None = None
    algo: str | None = None
    preset: str | None = None
    device: str | None = None
    out: Path = Path("runs")
    name: str | None = None


@dataclass(frozen=True)
class Request:
    """What a command line asks for: a search or a training run."""

    cluster: str | None
    task: str | None  # as on the command line
    algo: str | None = None  # as on the command line
    search: Path | None = None  # file of a search
    config: TrainConfig | None = None  # configuration of a run
    folder: Path | None = None  # folder of a search, or of a run to resume; None: a new run


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; after an error, print one line and exit."""
    from rich.console import Console

    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        carry_out(parse_arguments(given), given, Console())
    except (ValueError, WorkError) as error:
        sys.exit(f"error: {describe_error(error)}")
    gc.freeze()  # a last collection of all that was loaded would take a second


def parse_arguments(arguments: Sequence[str]) -> Request:
    """Parse a command line.

    Task, algorithm, preset, device and file of hyper-parameters are parsed first, since they
    determine the defaults of all other options.
    """
    selection, others = tyro.cli(
        _Selection, args=arguments, return_unknown_args=True, add_help=False
    )
    task = selection.task
    if selection.search is not None:
        _check_alone("search", ("task", "out", "name"), selection, others)
        folder = selection.out / (selection.name or f"search-{selection.search.stem}")
        if folder.exists():
            raise ValueError(
                f"name must be a new folder, got {folder}; --resume {folder} goes on with it"
            )
        return Request(selection.cluster, task, search=selection.search, folder=folder)
    if selection.resume is not None:
        _check_alone("resume", ("task", "algo"), selection, others)
        folder = selection.resume
        if (folder / SWEEP).is_file():
            return Request(selection.cluster, task, search=folder / SWEEP, folder=folder)
        from .learning.runs import CONFIG, read_config

        config = read_config(folder / CONFIG, task, selection.algo)
        return Request(selection.cluster, task, selection.algo, config=config, folder=folder)
    return Request(
        selection.cluster, task, selection.algo, config=_parse_config(selection, arguments)
    )


def carry_out(request: Request, arguments: Sequence[str], console: Any) -> None:
    """Run the search or the training of a command line."""
    workers = choose_workers(
        request.cluster, usable_cores(), task_files(request.task, request.algo)
    )
    if request.search is not None:
        if find_spec("optuna") is None:
            raise ValueError(
                "search needs optuna, which is not installed: pip install 'surface_gym[search]'"
            )
        from .tuning import search

        assert request.folder is not None
        search(request.search, request.folder, workers, console, request.task)
        return
    from .learning.runs import make_folder, train_seeds, write_card

    config, folder = request.config, request.folder
    assert config is not None
    if folder is None:
        if isinstance(config, PPOConfig) and config.device != configs.CPU:
            from .learning.cuda import check_device

            check_device(config)
        folder = make_folder(config, arguments)
    with _comparing(workers, config.seeds) as ready:
        trained = train_seeds(config, folder, console, workers)
        if len(trained) < config.seeds or any(each.interrupted for each in trained):
            own = [("--task", config.task), ("--algo", config.algo)]
            named = [word for each in own if ":" in each[1] for word in each]
            command = command_line(TRAIN, "--resume", str(folder), *named)
            console.print(
                f"interrupted: {folder} holds what was learned so far; "
                f"{command} goes on from the last checkpoint"
            )
            return
        with console.status("loading what compares"):
            from .evaluation.run_report import evaluate_run

        write_card(config, trained, evaluate_run(folder, config.task, ready, console), folder)


@contextmanager
def _comparing(workers: Workers, seeds: int) -> Iterator[Workers]:
    """Yield the workers for the comparison that follows the training.

    Training with a single seed leaves cores idle. In this case, processes on these cores already
    import the code of the comparison.
    """
    if isinstance(workers, Cluster) or workers == 1 or seeds > 1:
        yield workers
        return
    assert isinstance(workers, int)
    with closing(Processes(workers)) as processes:
        processes.load(_load, LOADED)
        yield processes


def _load(_: Any) -> None:
    from . import policy
    from .evaluation import report, run_report

    del policy, report, run_report


def _parse_config(selection: _Selection, arguments: Sequence[str]) -> TrainConfig:
    task = selection.task or DEFAULT_TASK
    given = {name: value for name in ("preset", "device") if (value := getattr(selection, name))}
    algo = selection.algo or usual_algorithm(task)
    default = configs.defaults(task, algo, selection.hyperparams, **given)
    # Names of fields are headings of the help.
    command: Any = make_dataclass("Command", [("training", type(default)), ("command", Options)])
    parsed = parse_options(
        command,
        "train",
        arguments,
        default=command(default, Options()),
        config=(tyro.conf.OmitArgPrefixes,),
        description="Train an agent, resume a run, or search hyper-parameters. "
        f"Tasks: {', '.join(TASKS)}.",
    )
    return parsed.training


def usual_algorithm(task: str) -> str:
    """Return the first algorithm that supports a task."""
    made = find_task(task)
    return next(name for name, each in ALGORITHMS.items() if each.serves(made))


def _check_alone(
    name: str, beside: tuple[str, ...], selection: _Selection, others: list[str]
) -> None:
    """Raise a ValueError if an option is given that may not accompany the option `name`.

    Only the options in `beside` and the option "cluster" may accompany the option `name`.
    """
    allowed = {name, "cluster", *beside}
    more = [
        f"--{each.name}"
        for each in fields(selection)
        if each.name not in allowed and getattr(selection, each.name) != each.default
    ]
    if more or others:
        names = ", ".join(f"--{each}" for each in beside)
        raise ValueError(
            f"--{name} must stand alone, or beside {names} and --cluster, got "
            f"{' '.join([*more, *others])}"
        )
