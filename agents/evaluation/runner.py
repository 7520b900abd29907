"""The runner of the comparison: parallel jobs with stored results, so that runs resume."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from operator import itemgetter
from pathlib import Path

import pandas as pd
from rich import progress as bars
from rich.console import Console

from surface_gym.parallel import Workers, map_jobs, without_report

from .method import PLANNER, Method, is_on_streams
from .results import KEY, Key, make_rows, read_results, write_results
from .robustness import FEWER
from .scenario import Row, ScenarioJob

GRACE = 0.0  # [s] for interrupted jobs, whose rows are lost
EVERY = 5.0  # [s] between lines of progress where there is no terminal
SLOW_BY = 0.75  # [-] share of the jobs after which no slow job begins
Advance = Callable[[int, int, str], None]  # called with finished jobs, all jobs, and the latest job


def compute(
    jobs: Sequence[ScenarioJob],
    workers: Workers,
    file: Path | None = None,
    advance: Advance = lambda *_: None,
) -> pd.DataFrame:
    """Compute the missing results of jobs; return the rows of all jobs in order.

    Args:
        file: file of results. Jobs with complete rows are not computed again.
    """
    known = {job.key: job for job in jobs}
    tables = {} if file is None else _read_whole(file, known)
    remaining = order_jobs([job for key, job in known.items() if key not in tables])
    columns: list[str] = [] if file is None else _columns(file, tables)
    done, compiled = len(known) - len(remaining), set[str]()

    def begin() -> Iterator[partial[list[Row]]]:
        for job in remaining:
            phase = "running" if job.scenario.task in compiled else "compiling"
            advance(done, len(known), f"{phase} {_describe(job)}")
            yield partial(without_report, job)

    for place, rows in map_jobs(
        begin(), workers, grace=GRACE, name=lambda place: _describe(remaining[place])
    ):
        job = remaining[place]
        tables[job.key] = make_rows(rows)
        if file is not None:
            columns = _keep(tables, job.key, columns, file)
        done += 1
        compiled.add(job.scenario.task)
        advance(done, len(known), f"finished {_describe(job)}")
    if not known:
        return pd.DataFrame(columns=list(KEY))
    return pd.concat([tables[key] for key in known], ignore_index=True)


def order_jobs(jobs: Sequence[ScenarioJob]) -> list[ScenarioJob]:
    """Spread slow jobs among the others, so that results come from the beginning.

    Slow jobs do not come last, where a single one would keep the other processes waiting. Quick
    jobs with one parcel come first, since their kernels compile faster than kernels of streams.
    """
    slow = [job for job in jobs if _is_slow(job.method)]
    quick = [job for job in jobs if not _is_slow(job.method)]
    quick.sort(key=lambda job: is_on_streams(job.scenario.task))
    places = [(SLOW_BY * (k + 1) / (len(slow) + 1), job) for k, job in enumerate(slow)]
    places += [(k / len(quick), job) for k, job in enumerate(quick)]
    return [job for _, job in sorted(places, key=itemgetter(0))]


def _is_slow(method: Method) -> bool:
    several = method.kind == PLANNER or method.most is not None
    return several or method.name in FEWER or "gate" in method.arguments


def _describe(job: ScenarioJob) -> str:
    task, scenario, preset, method, _ = job.key
    return ", ".join((task, method, preset, scenario))


def _read_whole(file: Path, known: dict[Key, ScenarioJob]) -> dict[Key, pd.DataFrame]:
    """Read stored results; incomplete jobs are left out, and computed again."""
    tables = {}
    for key, rows in read_results(file).groupby(list(KEY), sort=False):
        if key not in known or len(rows) == known[key].episodes:
            tables[key] = rows
    return tables


def _columns(file: Path, tables: dict[Key, pd.DataFrame]) -> list[str]:
    """Rewrite stored results, so that an incomplete last line does not corrupt the next one."""
    if not tables:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.unlink(missing_ok=True)
        return []
    whole = pd.concat(list(tables.values()), ignore_index=True)
    write_results(whole, file)
    return list(whole.columns)


def _keep(tables: dict[Key, pd.DataFrame], key: Key, columns: list[str], file: Path) -> list[str]:
    """Append the rows of a job to the file; rewrite the file if there are new columns."""
    rows = tables[key]
    if set(rows.columns) <= set(columns):
        with file.open("a") as kept:
            rows.reindex(columns=columns).to_csv(kept, header=False, index=False)
        return columns
    return _columns(file, tables)


@contextmanager
def show_progress(console: Console, title: str, total: int) -> Iterator[Advance]:
    """Show the progress of jobs; yield a function that updates it, see `Advance`.

    A terminal shows a bar. Files and pipes get a line from time to time.
    """
    if not console.is_terminal:
        yield _show_lines(console, title, total)
        return
    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
        bars.TimeRemainingColumn(),
    )
    with bars.Progress(*columns, console=console) as shown:
        bar = shown.add_task(title, total=total)
        yield lambda done, total, latest: shown.update(
            bar, completed=done, total=total, description=latest
        )


def _show_lines(console: Console, title: str, total: int) -> Advance:
    latest = -EVERY
    console.print(f"{title}: 0/{total}")

    def advance(done: int, total: int, part: str) -> None:
        nonlocal latest
        if (now := time.monotonic()) - latest >= EVERY or done == total:
            latest = now
            console.print(f"{title}: {done}/{total}, {part}", soft_wrap=True)

    return advance
