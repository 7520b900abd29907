"""The runner of the comparison: parallel jobs with stored results, so that runs resume."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pandas as pd
from rich import progress as bars
from rich.console import Console

from surface_gym.parallel import Workers, map_jobs, without_report

from .method import PLANNER
from .results import KEY, Key, make_rows, read_results, write_results
from .robustness import FEWER
from .scenario import ScenarioJob

GRACE = 1.0  # [s] short, since rows of interrupted jobs are lost
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
    remaining = sorted((job for key, job in known.items() if key not in tables), key=_place)
    if remaining:
        advance(len(known) - len(remaining), len(known), "compiling")
    work = [partial(without_report, job) for job in remaining]
    columns: list[str] = [] if file is None else _columns(file, tables)
    played = map_jobs(work, workers, grace=GRACE)
    for done, (place, rows) in enumerate(played, len(known) - len(remaining) + 1):
        key = remaining[place].key
        tables[key] = make_rows(rows)
        if file is not None:
            columns = _keep(tables, key, columns, file)
        advance(done, len(known), ", ".join(map(str, (key[0], key[3], key[2], key[1]))))
    if not known:
        return pd.DataFrame(columns=list(KEY))
    return pd.concat([tables[key] for key in known], ignore_index=True)


def _place(job: ScenarioJob) -> tuple[bool, bool, bool]:
    """Sort key of jobs: the slowest first, to use all cores."""
    slow = job.method.kind == PLANNER or job.method.most is not None
    return not slow, job.method.name not in FEWER, "gate" in job.method.arguments


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
def show_progress(console: Console, title: str) -> Iterator[Advance]:
    """Show a progress bar; yield a function that updates it with the latest part."""
    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
        bars.TimeRemainingColumn(),
    )
    with bars.Progress(*columns, console=console) as shown:
        bar = shown.add_task(title, total=None)
        yield lambda done, total, latest: shown.update(
            bar, completed=done, total=total, description=latest
        )
