"""What `evaluate.py` does."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from surface_gym import checks
from surface_gym.cores import usable_cores
from surface_gym.sharing import Workers, workers_of
from surface_gym.tasks import TASKS

from ..flow import study
from ..flow.contenders import contenders as flow_contenders
from ..flow.report import FlowReport, write_flow_report
from ..flow.trained import compare_parcels, is_of_flow
from ..tasks import files_of, find_task
from .contenders import Contender, contenders, of_run, of_runs, rules
from .report import compare_run, write_report
from .robustness.report import PICTURE, write_sweep
from .robustness.sweep import FILE as SWEPT
from .robustness.sweep import STARTS, compute_sweep, swept
from .table import Summaries
from .work import FILE, Advance, compute_cells

FLOW = "flow"
COMPARED = (FLOW, *TASKS)


@dataclass(frozen=True)
class EvaluateConfig:
    """Compare fixed layouts, rules, a planner and the shipped agents on every task, and on streams
    of parcels.
    """

    out: Path = Path("runs/evaluation")
    """Folder for tables, plots, films and report.html."""
    tasks: tuple[str, ...] = COMPARED
    """Of which to compare; "flow" is of streams of parcels."""
    task: str | None = None
    """Compare on this one task, the package's or one's own as path/to/file.py:Class, and the latest
    policies of its runs."""
    runs: Path = Path("runs")
    """Folder of the runs that are looked through for these policies."""
    run: Path | None = None
    """Folder of a training run: compare its policies with the fixed layout instead. Of a task of
    one's own, --task says whose code is to be run."""
    workers: int = usable_cores()
    """Processes to share the work among; results do not depend on it."""
    cluster: str | None = None
    """Address of a Ray cluster to share it among instead, "auto" for this machine's."""
    resume: bool = False
    """Keep what the folder has already, and go on."""
    robustness: bool = False
    """Sweep instead: success of rules and agents where one thing at a time is otherwise than as
    trained, and in the lab by shape of parcel."""
    starts: int = STARTS
    """Of the sweep: starts at each level of each factor."""

    def __post_init__(self) -> None:
        checks.integer("starts", self.starts, least=1)
        if self.robustness and self.run is not None:
            raise ValueError(f"run must be None where robustness is swept, got {self.run}")
        for task in self.tasks:
            checks.one_of("tasks", task, COMPARED)
        if self.task is not None:
            find_task(self.task)
        if not self.tasks:
            raise ValueError(f"tasks must be at least one, got {self.tasks!r}")
        checks.integer("workers", self.workers, least=1)
        workers_of(self.cluster, self.workers)


def evaluate(config: EvaluateConfig, console: Console) -> None:
    """Compare, and leave a folder with all that came of it.

    Raises:
        ValueError: the run holds no policy, or a damaged one.
    """
    workers = workers_of(config.cluster, config.workers, files_of(config.task))
    if config.robustness:
        sweep_robustness(config, workers, console)
        return
    if config.run is not None and is_of_flow(config.run):
        compare_parcels(config.run, workers, console)
        return
    if config.run is not None:
        evaluate_run(config.run, config.task, workers, console)
        return
    config.out.mkdir(parents=True, exist_ok=True)
    if not config.resume:
        for kept in (FILE, study.FILE):
            (config.out / kept).unlink(missing_ok=True)
    chosen = _chosen(config)
    with _progress(console) as progress:
        bar = progress.add_task("comparing", total=None)

        def advance(done: int, total: int, latest: str) -> None:
            progress.update(bar, completed=done, total=total, description=latest)

        flow = _flow(config, workers, console, advance) if _has_flow(config) else None
        cells = compute_cells(chosen, workers, config.out, advance)
        progress.update(bar, description="drawing")
        write_report(
            chosen,
            cells,
            config.out,
            console,
            lambda part: progress.update(bar, description=part),
            flow,
        )
    console.print(f"everything is in {config.out}; open {config.out / 'report.html'}")


def _progress(console: Console) -> Progress:
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
    )  # fmt: skip
    return Progress(*columns, console=console)


def sweep_robustness(config: EvaluateConfig, workers: Workers, console: Console) -> None:
    """Sweep, and leave tables and the picture in the folder."""
    config.out.mkdir(parents=True, exist_ok=True)
    if not config.resume:
        (config.out / SWEPT).unlink(missing_ok=True)
    with _progress(console) as progress:
        bar = progress.add_task("sweeping", total=None)

        def advance(done: int, total: int, latest: str) -> None:
            progress.update(bar, completed=done, total=total, description=latest)

        cells = compute_sweep(swept(_chosen(config)), workers, config.out, config.starts, advance)
        progress.update(bar, description="drawing")
        write_sweep(cells, config.out, console)
    console.print(f"everything is in {config.out}; see {config.out / PICTURE}")


def _has_flow(config: EvaluateConfig) -> bool:
    return config.task is None and FLOW in config.tasks


def _flow(
    config: EvaluateConfig, workers: Workers, console: Console, advance: Advance
) -> FlowReport:
    """Compare on streams of parcels."""
    chosen = flow_contenders()
    cells = study.compute_flows(chosen, workers, config.out, advance)
    return write_flow_report(chosen, cells, config.out, console)


def _chosen(config: EvaluateConfig) -> list[Contender]:
    if config.task is None:
        tasks = [task for task in config.tasks if task != FLOW]
        return [contender for task in tasks for contender in contenders(task)]
    known = contenders(config.task)
    names = {contender.name for contender in known}
    found = [each for each in of_runs(config.task, config.runs) if each.name not in names]
    return [*known, *found]


def evaluate_run(
    run: Path, task: str | None, workers: Workers, console: Console
) -> tuple[Contender, Summaries]:
    """Compare the policies of a run with the fixed layout of its task, into the run's folder.

    Args:
        run: its folder.
        task: of one's own that it is of; None: one of the package.
        workers: processes to share the work among, or a cluster.
        console: to show on.

    Returns:
        The policies as they were compared, and the comparison.

    Raises:
        ValueError: the folder holds no policy, or a damaged one, or one of another task.
    """
    agent = of_run(run, task)
    summaries = compare_run(rules(agent.task)[0], agent, workers, run, console)
    console.print(f"everything is in {run}")
    return agent, summaries
