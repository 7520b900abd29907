"""The table of results: one row per method, seed, scenario and episode.

Rows are computed in parallel and stored at once, so that an interrupted comparison can be resumed.
A sample holds the rows of one method under one scenario. A replication is one episode of a stream.
"""

import io
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich import progress as bars
from rich.console import Console
from scipy import special  # stats takes half a second to import

from surface_gym.files import DAMAGE, describe_damage, replacing
from surface_gym.flow.arrivals import HOUR
from surface_gym.parallel import Workers, map_jobs, without_report

from ..base import Booleans, Numbers
from .method import is_on_streams
from .scenario import KEY, Key, Row, ScenarioJob

CONFIDENCE = 0.95
FILE = "results.csv"
TEXTS = ("task", "scenario", "preset", "method", "kind", "shape")  # all other columns are numbers

# Numbers are read exactly, which is the default from pandas 3.1.
_VERSION = tuple(map(int, pd.__version__.split(".")[:2]))
_EXACT: dict[str, Any] = {"float_precision": "round_trip"} if _VERSION < (3, 1) else {}

GRACE = 0.0  # [s] for interrupted jobs, whose rows are lost
EVERY = 5.0  # [s] between lines of progress where there is no terminal
SLOW_BY = 0.75  # [-] share of the jobs after which no slow job begins
Advance = Callable[[int, int, str], None]  # called with finished jobs, all jobs, and the latest job


def interval(success: Booleans) -> tuple[float, float]:
    """Compute the 95 % interval of a success rate over seeds and starts.

    The interval is Wilson's interval, but an effective number of starts replaces the number of
    episodes. The effective number accounts for differences between seeds: if one seed always fails,
    its episodes do not count as independent failures.

    Args:
        success: shape (seeds, starts), with the same starts for every seed.
    """
    seeds, starts = success.shape
    share = float(success.mean())
    spread = _variance_of_mean(success.mean(axis=0))
    if seeds > 1:
        spread += _variance_of_mean(success.mean(axis=1))
    count = share * (1.0 - share) / spread if spread > 0.0 else float(starts)
    return wilson(share, min(count, float(success.size)))


def wilson(share: float, count: float) -> tuple[float, float]:
    """Compute Wilson's score interval of a share of `count` trials. `count` need not be whole."""
    z = float(special.ndtri(0.5 + CONFIDENCE / 2.0))
    centre = (share + z * z / (2.0 * count)) / (1.0 + z * z / count)
    half = z * np.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count**2))
    half /= 1.0 + z * z / count
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def half_interval(values: Numbers) -> float:
    """Compute half the width of Student's 95 % interval of the mean, or NaN for a single value."""
    count = len(values)
    if count < 2:
        return math.nan
    spread = float(values.std(ddof=1)) / math.sqrt(count)
    return float(special.stdtrit(count - 1, 0.5 + CONFIDENCE / 2.0)) * spread


def is_ahead(difference: Numbers) -> bool:
    """Return whether the mean of paired differences is significantly positive (95 % confidence)."""
    return bool(difference.mean() > half_interval(difference))


def _variance_of_mean(values: Numbers) -> float:
    return float(values.var(ddof=1)) / len(values) if len(values) > 1 else 0.0


@dataclass(frozen=True, eq=False)
class Sample:
    """All episodes of a method under one scenario; arrays are (seeds, episodes)."""

    rows: pd.DataFrame

    @cached_property
    def seeds(self) -> tuple[int, ...]:
        return tuple(dict.fromkeys(self.rows["seed"].tolist()))

    @property
    def kind(self) -> str:
        """Kind of the method, e.g. "rule" or "planner"."""
        return str(self.rows["kind"].iloc[0])

    def values(self, name: str) -> Numbers:
        """Return a column (seeds, episodes). Entries without a measurement are NaN."""
        if name not in self.rows:
            return np.full((len(self.seeds), len(self.rows) // len(self.seeds)), np.nan)
        return self.rows[name].to_numpy(dtype=np.float64).reshape(len(self.seeds), -1)

    def constant(self, name: str) -> float:
        """Return the value of the column `name`, which must be the same in all episodes."""
        return float(self.values(name)[0, 0])

    # Results of starts; see `surface_gym.tasks.benchmark.Runs`.

    @property
    def success(self) -> Booleans:
        return self.values("success") > 0.5

    @property
    def time(self) -> Numbers:
        return self.values("time")

    def metric(self, name: str) -> Numbers:
        return np.abs(self.values(name))

    @property
    def rate(self) -> float:
        """[-] success rate."""
        return float(self.success.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """[-] 95 % interval of the success rate."""
        return interval(self.success)

    # Results of streams.

    @property
    def is_sustained(self) -> bool:
        """Whether the method sustains some rate of arrivals with every seed."""
        return bool(np.isfinite(self.values("correct")).all())

    @cached_property
    def of_seeds(self) -> Numbers:
        """Rates (seeds, replications) [parcels/h] of correct deliveries."""
        return HOUR * self.values("correct") / self.values("counted")

    @cached_property
    def rates(self) -> Numbers:
        """Rates (replications,) [parcels/h] of correct deliveries, averaged over seeds."""
        return np.asarray(self.of_seeds.mean(axis=0))

    @property
    def throughput(self) -> float:
        """[parcels/h] rate of correct deliveries; 0 if no rate is sustained."""
        return float(self.rates.mean()) if self.is_sustained else 0.0

    @property
    def margin(self) -> float:
        """[parcels/h] half of the 95 % interval of the throughput."""
        return half_interval(self.rates)

    @property
    def share_correct(self) -> float:
        """[-] correct deliveries / all deliveries. If there is no delivery, the share is 0."""
        return float(self.values("correct").sum() / max(1.0, self.values("delivered").sum()))

    @property
    def jams(self) -> float:
        """Number of replications that ended in a jam, averaged over seeds."""
        return float(self.values("jam").sum() / len(self.seeds))

    @property
    def turns(self) -> float:
        """[-] number of turns of actuators per correct delivery, over whole episodes.

        If the results have no column "modules", every axis has its own actuator.
        """
        turns = float(self.values("turns").sum() / max(1.0, self.values("sorted").sum()))
        modules = self.constant("modules")
        return turns if math.isnan(modules) else turns / modules

    @property
    def touches(self) -> float:
        """Number of touches in all episodes. Episodes without a departed parcel add 0."""
        touches = self.values("touches_per_1000") * self.values("delivered") / 1000.0
        return float(np.where(np.isfinite(touches), touches, 0.0).sum())

    def mean(self, name: str) -> float:
        values, delivered = self.values(name), self.values("delivered")
        some = np.isfinite(values)
        if not some.any():
            return math.nan
        return float(np.average(values[some], weights=np.maximum(1.0, delivered)[some]))

    def most(self, name: str) -> float:
        return float(self.values(name).max())


class Results:
    """A table of results, grouped into one `Sample` per task, scenario, preset and method."""

    def __init__(self, table: pd.DataFrame) -> None:
        groups = table.groupby(list(KEY[:-1]), sort=False, observed=True)
        self.samples: dict[Key, Sample] = {key: Sample(rows) for key, rows in groups}

    def at(self, task: str, scenario: str, preset: str) -> dict[str, Sample]:
        """Return the samples of a scenario under a preset. The keys are names of methods."""
        return {key[3]: each for key, each in self.among(task, scenario) if key[2] == preset}

    def among(self, task: str, scenario: str | None = None) -> Iterator[tuple[Key, Sample]]:
        """Yield keys and samples of a task, for one scenario or for all scenarios."""
        for key, sample in self.samples.items():
            if key[0] == task and scenario in (None, key[1]):
                yield key, sample

    def methods(self, task: str, scenario: str | None = None) -> list[str]:
        """List a task's methods in the order of rows. If `scenario` is None, use all scenarios."""
        return list(dict.fromkeys(key[3] for key, _ in self.among(task, scenario)))


def read_results(file: Path) -> pd.DataFrame:
    """Read the complete rows of a file; ignore an incomplete last line. A missing file has no rows.

    Raises:
        ValueError: the file holds something else than results.
    """
    try:
        text = file.read_bytes()
        whole = text[: text.rfind(b"\n") + 1]
        if not whole:
            return pd.DataFrame(columns=list(KEY))
        header = whole.split(b"\n", 1)[0].decode().split(",")
        lacking = [name for name in KEY if name not in header]
        if lacking:
            raise ValueError(f"columns must include {', '.join(KEY)}, got no {lacking[0]}")
        kinds: dict[str, Any] = {name: np.float64 for name in header if name not in TEXTS}
        kinds |= {"seed": np.int64, "episode": np.int64} | {n: "str" for n in TEXTS if n in header}
        table = pd.read_csv(
            io.BytesIO(whole), dtype=kinds, keep_default_na=False, **_EXACT,
            na_values={name: [""] for name in header if name not in TEXTS},
        )  # fmt: skip
        _check_numbers(table)
        return table
    except FileNotFoundError:
        return pd.DataFrame(columns=list(KEY))
    except DAMAGE as error:
        raise ValueError(
            f"{file} holds something else than results: {describe_damage(error)}; remove the file, "
            "and they are computed again"
        ) from None


def _check_numbers(table: pd.DataFrame) -> None:
    """Raise a ValueError for infinite numbers and negative seeds."""
    for name in (each for each in table if each not in TEXTS):
        values = table[name].to_numpy(dtype=np.float64)
        wrong = np.flatnonzero(np.isinf(values) | ((values < 0.0) & (name == "seed")))
        if len(wrong):
            allowed, place = "at least 0" if name == "seed" else "finite", wrong[0]
            raise ValueError(f"{name} must be {allowed}, got {values[place]:g} in line {place + 2}")


def write_results(table: pd.DataFrame, file: Path) -> None:
    """Write a whole table."""
    with replacing(file) as part:
        table.to_csv(part, index=False)


def make_rows(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Make a table of rows. Numbers have the same types as in a table from `read_results`."""
    table = pd.DataFrame(rows)
    numbers = [name for name in table if name not in (*TEXTS, "seed", "episode")]
    return table.astype(dict.fromkeys(numbers, np.float64))


def compute(
    jobs: Sequence[ScenarioJob],
    workers: Workers,
    file: Path | None = None,
    advance: Advance = lambda *_: None,
) -> pd.DataFrame:
    """Compute the missing results of jobs on `workers`; return all rows in the order of the jobs.

    Args:
        file: file of results. Jobs with complete rows in this file are not computed again.
    """
    known = {job.key: job for job in jobs}
    tables: dict[Key, pd.DataFrame] = {}
    if file is not None:  # rows of incomplete jobs are left out, so they are computed again
        for key, stored in read_results(file).groupby(list(KEY), sort=False):
            if key not in known or len(stored) == known[key].episodes:
                tables[key] = stored
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
    """Order jobs: spread slow jobs among quick ones, so that the first results come early.

    No slow job is among the last jobs, because other processes would wait for it. Quick jobs with
    one parcel come first, because their kernels compile faster than kernels of streams.
    """
    slow = [job for job in jobs if job.is_slow]
    quick = [job for job in jobs if not job.is_slow]
    quick.sort(key=lambda job: is_on_streams(job.scenario.task))
    places = [(SLOW_BY * (k + 1) / (len(slow) + 1), job) for k, job in enumerate(slow)]
    places += [(k / len(quick), job) for k, job in enumerate(quick)]
    return [job for _, job in sorted(places, key=itemgetter(0))]


def _describe(job: ScenarioJob) -> str:
    task, scenario, preset, method, _ = job.key
    return ", ".join((task, method, preset, scenario))


def _columns(file: Path, tables: dict[Key, pd.DataFrame]) -> list[str]:
    """Replace the file's rows by the `tables` of finished jobs. Return the names of the columns."""
    if not tables:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.unlink(missing_ok=True)
        return []
    whole = pd.concat(list(tables.values()), ignore_index=True)
    write_results(whole, file)
    return list(whole.columns)


def _keep(tables: dict[Key, pd.DataFrame], key: Key, columns: list[str], file: Path) -> list[str]:
    """Append the rows `tables[key]` of a job to a file. Return the columns that the file then has.

    `columns` are the file's present columns. If the rows have a column that is not in `columns`,
    the file is rewritten from all tables.
    """
    rows = tables[key]
    if set(rows.columns) <= set(columns):
        with file.open("a") as kept:
            rows.reindex(columns=columns).to_csv(kept, header=False, index=False)
        return columns
    return _columns(file, tables)


@contextmanager
def show_progress(console: Console, title: str, total: int) -> Iterator[Advance]:
    """Show the progress of `total` jobs; yield a function that updates the progress (`Advance`).

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
