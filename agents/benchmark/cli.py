"""`surface-gym benchmark`: run a policy on the benchmark, or make the board of all entries."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from surface_gym import checks, parallel
from surface_gym.cli import parse_options
from surface_gym.executors import WorkError, describe_error
from surface_gym.registration import PERIODS

from . import TASKS

if TYPE_CHECKING:
    from rich.console import Console

    from .board import Board

TABLE, PLOT = "table", "plot"  # first argument of the other forms
RESULTS = Path("benchmarks/results")
SINGLES = tuple(name for name in TASKS if PERIODS[name] is not None)
INTERRUPTED = 130  # exit code after Ctrl-C


@dataclass(frozen=True)
class BenchmarkConfig:
    """Run a policy on the test episodes of the benchmark, and write an entry.

    Policies run in processes of their own with bounded time and memory. `surface-gym benchmark
    table` makes the board of all entries; `surface-gym benchmark plot` draws its plots.
    """

    policy: str
    """FILE.py:Class, the folder of a policy, a shipped agent, a model.onnx, or a model.zip of
    Stable-Baselines3. "{task}" and "{seed}" stand for a task and a training seed.
    """
    tasks: tuple[str, ...] = SINGLES
    """Tasks, four cells each."""
    seeds: tuple[int, ...] = ()
    """Training seeds of the policy, at least 5 for a policy that learned; the default is 0, or all
    seeds of a shipped agent.
    """
    name: str = ""
    """Name on the board; the default is the policy's."""
    by: str = ""
    """Your name."""
    link: str = ""
    """Link to code or a publication."""
    kind: str = "agent"
    """"agent", "rule", "planner" or "baseline"."""
    interactions: int = 0
    """Control periods of training per seed: at most 1 000 000, or at most 10 000 000."""
    actions: str | None = None
    """Kind of action, for a model.zip."""
    control_period: float | None = None
    """[s] between decisions, for a model.zip."""
    out: Path = RESULTS
    """Folder of entries."""
    seconds: float = 60.0
    """[s] maximum time of a policy in one cell, without the simulation."""
    memory: float = 4.0
    """[GiB] maximum memory of a policy."""
    workers: int = parallel.usable_cores()
    """Number of processes; results do not depend on it."""

    def __post_init__(self) -> None:
        for seed in self.seeds:
            checks.integer("seeds", seed, least=0)
        if not self.tasks:
            raise ValueError("tasks must be at least one, got ()")
        parallel.check_workers(self.workers)

    @property
    def title(self) -> str:
        """Name of the entry; the default is the policy's name."""
        return self.name or Path(self.policy).stem.replace(":", " ")


@dataclass(frozen=True)
class TableConfig:
    """Make the board of all entries."""

    results: Path = RESULTS
    """Folder of entries."""
    out: Path | None = None
    """Markdown file to write; the default prints the board."""


@dataclass(frozen=True)
class PlotConfig:
    """Draw confidence intervals and performance profiles of all entries (package rliable)."""

    out: Path
    """Folder to write; it is made if there is none."""
    results: Path = RESULTS
    """Folder of entries."""


def benchmark(config: BenchmarkConfig, console: "Console") -> None:
    """Run a policy, and write its entry."""
    from ..evaluation.results import show_progress
    from .entry import (
        BenchmarkEntry,
        describe_machine,
        keep_rows,
        make_jobs,
        run_entry,
        write_entry,
    )
    from .process import PolicyLimits

    chosen = {"actions": config.actions, "control_period": config.control_period}
    given = {name: value for name, value in chosen.items() if value is not None}
    limits = PolicyLimits(memory=config.memory, seconds=config.seconds)
    jobs = make_jobs(config.policy, config.tasks, config.seeds, given, limits)
    entry = BenchmarkEntry(
        config.title, (), config.by, config.link, config.kind, config.interactions,
        Path(config.policy).name, machine=describe_machine(),
    )  # fmt: skip
    file = config.out / f"{config.title.lower().replace(' ', '-').replace('/', '-')}.json"
    entry = keep_rows(entry, file, config.policy, jobs)
    kept = entry.rows
    with show_progress(console, "benchmark", len(jobs)) as advance:
        entry = run_entry(entry, jobs, config.workers, advance)
    write_entry(entry, file)
    rows = entry.rows[len(kept) :]
    failed = [row for row in rows if row.failure]
    for row in failed:
        console.print(f"{row.task}, {row.cell}, seed {row.seed} failed: {row.failure}")
    console.print(f"the entry is in {file}; surface-gym benchmark table shows the board")
    if len(failed) == len(rows):
        raise ValueError(f"policy must run, got {config.policy}: {failed[0].failure}")


def read_board(results: Path) -> "Board":
    """Read the board from a folder of entries. If the folder has no entry, raise a ValueError."""
    from .board import Board
    from .entry import read_entries

    entries = read_entries(results)
    if not entries:
        raise ValueError(f"results must be a folder with entries, got {results}")
    return Board(entries)


def show_board(config: TableConfig, console: "Console") -> None:
    """Print or write the board."""
    from .board import make_page

    board = read_board(config.results)
    page = make_page(board)
    if config.out is None:
        print(page)
        return
    config.out.write_text(page)
    console.print(f"the board of {len(board.entries)} entries is in {config.out}")


def draw_board(config: PlotConfig) -> None:
    """Write the plots of the board."""
    from .board import plot_board

    board = read_board(config.results)
    if find_spec("rliable") is None:
        raise ValueError("plot needs rliable: pip install 'surface_gym[plots]'")
    config.out.mkdir(parents=True, exist_ok=True)
    for file in plot_board(board, config.out):
        print(file)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. If it fails, print the error in one line."""
    from rich.console import Console

    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        if given[:1] == [TABLE]:
            show_board(parse_options(TableConfig, "benchmark", given[1:]), Console())
        elif given[:1] == [PLOT]:
            draw_board(parse_options(PlotConfig, "benchmark", given[1:]))
        else:
            benchmark(parse_options(BenchmarkConfig, "benchmark", given), Console())
    except (ValueError, WorkError) as error:
        sys.exit(f"error: {describe_error(error)}")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
