"""The command behind `python evaluate.py`: compare every controller and agent on every task."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro
from rich.console import Console

from surface_gym import checks, parallel
from surface_gym.cli import typed
from surface_gym.registration import FLOW_TASK, ON_SLOPES, PERIODS

if TYPE_CHECKING:
    from .methods import Method
    from .report import Section

TASK_NAMES = (FLOW_TASK, *(name for name in PERIODS if name != FLOW_TASK))
SINGLE = tuple(name for name, periods in PERIODS.items() if periods is not None)
EXIT_NAMES = ("sides", "chutes")
LOADING = "loading what compares"
STARTS = 240  # of the sweep, at each level


@dataclass(frozen=True)
class EvaluateConfig:
    """Compare fixed layouts, rules, a planner and the shipped agents on every task; and zones,
    columns and modules, each with its scheduler, on streams of parcels.
    """

    out: Path = Path("runs/evaluation")
    """Folder for tables, plots, videos and report.html."""
    tasks: tuple[str, ...] = TASK_NAMES
    """Tasks to compare on; "flow" is of streams of parcels; "singulate", "merge" and "sequence" of
    streams on a slope.
    """
    exits: tuple[str, ...] = ("sides",)
    """Exits of the streams: "sides", one as long as the line on either side; "chutes", two on
    either side; or both.
    """
    task: str | None = None
    """Compare on this one task, of the package or of your own as path/to/file.py:Class, and the
    latest policies of its runs.
    """
    runs: Path = Path("runs")
    """Folder of the runs that are searched for these policies."""
    run: Path | None = None
    """Folder of a training run: compare its policies with the fixed layout instead.

    For a task of your own, --task says which code is run.
    """
    workers: int = parallel.usable_cores()
    """Processes to share the work among; results do not depend on it."""
    cluster: str | None = None
    """Address of a Ray cluster to share it among instead, "auto" for this machine's."""
    resume: bool = False
    """Keep the results that the folder has already, and go on."""
    robustness: bool = False
    """Sweep instead: success of rules and agents where one thing at a time differs from training,
    and in the lab by shape of parcel; and the agent of streams beside the scheduler, on lines that
    it never trained on.
    """
    starts: int = STARTS
    """Of the sweep: starts at each level of each factor."""

    def __post_init__(self) -> None:
        checks.integer("starts", self.starts, least=1)
        if self.robustness and self.run is not None:
            raise ValueError(f"run must be None where robustness is swept, got {self.run}")
        for name, given in (("tasks", self.tasks), ("exits", self.exits)):
            if not given:
                raise ValueError(f"{name} must be at least one, got {given!r}")
        for exits in self.exits:
            checks.one_of("exits", exits, EXIT_NAMES)
        for task in self.tasks:
            checks.one_of("tasks", task, TASK_NAMES)
        if self.task is not None:
            from ..library import find_task

            find_task(self.task)
        parallel.choose_workers(self.cluster, self.workers)


def evaluate(config: EvaluateConfig, console: Console) -> None:
    """Compare, and leave a folder with tables, plots, videos and a page."""
    from ..library import task_files

    workers = parallel.choose_workers(config.cluster, config.workers, task_files(config.task))
    if config.run is not None:
        with console.status(LOADING):
            from .report import evaluate_run

        evaluate_run(config.run, config.task, workers, console)
        return
    config.out.mkdir(parents=True, exist_ok=True)
    if config.robustness:
        _sweep(config, workers, console)
    else:
        _compare(config, workers, console)


def _compare(config: EvaluateConfig, workers: parallel.Workers, console: Console) -> None:
    with console.status(LOADING):
        from . import benchmark, material_flow, material_flow_report, report, streams

    _forget(config, benchmark.FILE, streams.FILE, material_flow.FILE)
    methods = chosen_methods(config)
    with benchmark.show_progress(console, "comparing") as advance:
        sections: list[Section] = []
        if config.task is None and FLOW_TASK in config.tasks:
            several = streams.stream_methods()
            rows = streams.compute_streams(several, workers, config.out, advance, config.exits)
            sections = report.write_stream_report(several, rows, config.out, console)
        on_slopes = [name for name in ON_SLOPES if name in config.tasks]
        if config.task is None and on_slopes:
            found = material_flow.compute_material_flow(on_slopes, workers, config.out, advance)
            tables = material_flow_report.write_material_flow(found, config.out, console)
            for task, table in zip(on_slopes, tables, strict=True):
                advance(len(found), len(found), f"filming {task}")
                shown = [
                    each
                    for preset in ("exact", "lab")
                    for each in material_flow_report.film(task, preset, config.out)
                ]
                sections.append(report.Section(table, shown))
        results = benchmark.compute_results(methods, workers, config.out, advance)
        report.write_report(
            methods,
            results,
            config.out,
            console,
            lambda part: advance(len(results), len(results), part),
            sections,
        )
    console.print(f"everything is in {config.out}; open {config.out / 'report.html'}")


def _sweep(config: EvaluateConfig, workers: parallel.Workers, console: Console) -> None:
    with console.status(LOADING):
        from . import benchmark, generalisation, robustness, robustness_report

    _forget(config, robustness.FILE, generalisation.FILE)
    methods = robustness.can_sweep(chosen_methods(config))
    with benchmark.show_progress(console, "sweeping") as advance:
        if config.task is None and FLOW_TASK in config.tasks:
            found = generalisation.compute_generalisation(workers, config.out, advance)
            generalisation.write_generalisation(found, config.out, console)
        if methods:
            rows = robustness.compute_sweep(methods, config.starts, workers, config.out, advance)
            robustness_report.write_sweep(rows, config.out, console)
    console.print(f"everything is in {config.out}")


def chosen_methods(config: EvaluateConfig) -> "list[Method]":
    """List the methods of single parcels that a command asks for."""
    from .methods import all_methods, of_runs

    if config.task is None:
        tasks = [task for task in config.tasks if task in SINGLE]
        return [method for task in tasks for method in all_methods(task)]
    known = all_methods(config.task)
    names = {method.name for method in known}
    found = [each for each in of_runs(config.task, config.runs) if each.name not in names]
    return [*known, *found]


def _forget(config: EvaluateConfig, *files: str) -> None:
    if not config.resume:
        for file in files:
            (config.out / file).unlink(missing_ok=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare; an error ends it with one line."""
    config = tyro.cli(EvaluateConfig, prog=typed("evaluate"), args=arguments)
    try:
        evaluate(config, Console())
    except (ValueError, parallel.WorkError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("interrupted; --resume goes on with what is there")
