"""The command behind `python evaluate.py`: compare every controller and agent on every task."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from surface_gym import checks, parallel
from surface_gym.cli import parse_options
from surface_gym.executors import WorkError, describe_error
from surface_gym.randomisation import Actuators
from surface_gym.registration import SHIPPED, TASKS

if TYPE_CHECKING:
    from rich.console import Console

    from .scenario import ScenarioJob

TASK_NAMES = tuple(SHIPPED)
EXIT_NAMES = ("sides", "chutes")
OUT = Path("runs/evaluation")
SETTINGS = "settings.json"  # settings of the results in a folder
INTERRUPTED = 130  # exit code after Ctrl-C
QUICK_NOTE = "Quick: few starts, streams, levels and seeds, which say little of who is better."


@dataclass(frozen=True)
class EvaluateConfig:
    """Compare fixed layouts, rules, planners and shipped agents on every task.

    On the task Flow, also compare schedulers that turn whole zones, columns or single modules.
    """

    out: Path = OUT
    """Folder for results.csv, tables, plots, videos and report.html; the default of a quick
    comparison ends in "-quick".
    """
    tasks: tuple[str, ...] = TASK_NAMES
    """Compared tasks; "flow" sorts streams of parcels; "singulate", "merge" and "sequence" are on
    streams on a slope.
    """
    exits: tuple[str, ...] = ("sides",)
    """Exits of the streams: "sides" (one per side, as long as the line), "chutes" (two per side),
    or both.
    """
    task: str | None = None
    """Compare one task only: a task of the package, or a custom task as path/to/file.py:Class, with
    the latest policies of its runs.
    """
    runs: Path = Path("runs")
    """Folder with the runs of these policies."""
    algo: tuple[str, ...] = ()
    """Your own algorithms of runs, each as path/to/file.py:NAME. Runs of other algorithms of
    yours are left out.
    """
    run: Path | None = None
    """Folder of a training run: compare its policies with the fixed layout instead.

    For a custom task, --task names the code to execute.
    """
    workers: int = parallel.usable_cores()
    """Number of processes; results do not depend on it."""
    cluster: str | None = None
    """Address of a Ray cluster to use instead; "auto" for the cluster of this machine."""
    resume: bool = False
    """Keep the existing results in the folder, and compute the missing ones."""
    quick: bool = False
    """Fewer starts, streams, levels and seeds: the same tables in a few minutes."""
    robustness: bool = False
    """Study robustness instead: success of rules and agents if one factor differs from training,
    and by parcel shape in the lab; for streams, agent and scheduler on lines without training.
    """
    modules: bool = False
    """Compare kinds of modules instead: idle rotors beside driven modules."""
    turn_energy: float = 0.0
    """Kinds of modules: energy of a turn of an axis [J], by its data sheet."""
    starts: int = 240
    """Robustness study: starts at each level of each factor."""

    def __post_init__(self) -> None:
        checks.integer("starts", self.starts, least=1)
        Actuators(turn_energy=self.turn_energy)
        if self.robustness and self.modules:
            raise ValueError("modules must not be given beside robustness, got both")
        if self.robustness and self.run is not None:
            raise ValueError(f"run must be None where robustness is swept, got {self.run}")
        if self.run is not None and self.out != OUT:
            raise ValueError(f"out must not be given beside run, got {self.run} and {self.out}")
        for name, given in (("tasks", self.tasks), ("exits", self.exits)):
            if not given:
                raise ValueError(f"{name} must be at least one, got {given!r}")
        for exits in self.exits:
            checks.one_of("exits", exits, EXIT_NAMES)
        for task in self.tasks:
            checks.one_of("tasks", task, TASKS)
        parallel.choose_workers(self.cluster, self.workers)

    @property
    def folder(self) -> Path:
        """The folder of results."""
        return OUT.with_name(f"{OUT.name}-quick") if self.quick and self.out == OUT else self.out


def evaluate(config: EvaluateConfig, console: "Console") -> None:
    """Run the comparison, and write results, tables, plots, videos and a page to a folder."""
    from ..library import find_algorithm, task_files

    for algo in config.algo:
        find_algorithm(algo)
    files = task_files(config.task, *config.algo)
    workers = parallel.choose_workers(config.cluster, config.workers, files)
    if config.run is not None:
        from .run_report import evaluate_run

        evaluate_run(config.run, config.task, workers, console)
        return
    from .drives import drive_jobs, write_tables
    from .method import find_benchmark, unloaded_runs
    from .report import Selection, write_report, write_sweep
    from .results import FILE, compute, show_progress
    from .scenario import QUICK, WHOLE

    extent = QUICK if config.quick else replace(WHOLE, level_starts=config.starts)
    selection = Selection(config.tasks, config.exits, extent=extent)
    if config.task is not None:
        find_benchmark(config.task)
        selection = Selection((config.task,), config.exits, config.runs, extent)
        for run, algo in unloaded_runs(config.task, config.runs).items():
            console.print(f"{run} is left out: to compare it, add --algo {algo}", style="yellow")
    if config.modules:
        jobs = drive_jobs(config.tasks, extent)
    else:
        jobs = selection.sweep_jobs() if config.robustness else selection.jobs()
    _prepare(config, jobs)
    note = QUICK_NOTE if config.quick else ""
    title = "sweeping" if config.robustness else "comparing"
    with show_progress(console, title, len(jobs)) as advance:
        table = compute(jobs, workers, config.folder / FILE, advance)
        show = partial(advance, len(jobs), len(jobs))
        if config.modules:
            write_tables(config.tasks, table, config.folder, console, note, config.turn_energy)
        elif config.robustness:
            write_sweep(selection, table, config.folder, console, note)
        else:
            write_report(selection, table, config.folder, console, show, note)
    page = "" if config.robustness or config.modules else f"; open {config.folder / 'report.html'}"
    console.print(f"everything is in {config.folder}{page}")


def _prepare(config: EvaluateConfig, jobs: "Sequence[ScenarioJob]") -> None:
    """Make the results folder. Raise a ValueError if its results were made with other options.

    Also raise a ValueError if the folder has results of some of the `jobs`, unless `config.resume`
    is true.
    """
    from .results import FILE, read_results
    from .scenario import KEY

    settings = {"quick": config.quick, "starts": config.starts}
    file = config.folder / SETTINGS
    if (config.folder / FILE).is_file():
        if file.is_file() and json.loads(file.read_text()) != settings:
            raise ValueError(
                f"out must be a folder with results of the same --quick and --starts, "
                f"got {config.folder} with {file.read_text().strip()}"
            )
        kept = read_results(config.folder / FILE)
        known = set(kept[list(KEY)].drop_duplicates().itertuples(index=False, name=None))
        if not config.resume and any(job.key in known for job in jobs):
            raise ValueError(
                f"out must be a folder without these results, got {config.folder}: add --resume to "
                "go on with them, or --out for another folder"
            )
    config.folder.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(settings) + "\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. If it fails, print the error in one line."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not {"-h", "--help"} & set(given):
        print("loading what compares", flush=True)
    try:
        from rich.console import Console

        evaluate(parse_options(EvaluateConfig, "evaluate", given), Console())
    except (ValueError, WorkError) as error:
        sys.exit(f"error: {describe_error(error)}")
    except KeyboardInterrupt:
        print("interrupted; --resume goes on with what is there", file=sys.stderr)
        sys.exit(INTERRUPTED)
