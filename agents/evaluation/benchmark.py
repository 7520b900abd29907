"""The results of methods on the starts of a task, in each preset, and intervals of their means."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, is_dataclass
from functools import partial
from pathlib import Path
from types import UnionType
from typing import Any, Protocol, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from rich import progress as bars
from rich.console import Console
from scipy import stats

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.files import DAMAGE, describe_at_line, read_lines, replacing
from surface_gym.parallel import Workers, map_jobs, without_report
from surface_gym.tasks.benchmark import Benchmark, Column

from ..base import Booleans, Numbers
from ..library import find_task
from ..rollout import Episodes, run_episodes, run_sequentially
from .methods import Method

CONFIDENCE = 0.95


def interval(success: Booleans) -> tuple[float, float]:
    """Compute the 95 % interval of a success rate over seeds and starts.

    Wilson's interval, at the number of independent starts that would spread the mean as the seeds
    and the starts together do: a seed that fails everywhere must not count as many starts.

    Args:
        success: (seeds, starts) the same starts for every seed.
    """
    seeds, starts = success.shape
    share = float(success.mean())
    spread = _variance_of_mean(success.mean(axis=0))
    if seeds > 1:
        spread += _variance_of_mean(success.mean(axis=1))
    count = share * (1.0 - share) / spread if spread > 0.0 else float(starts)
    return wilson(share, min(count, float(success.size)))


def wilson(share: float, count: float) -> tuple[float, float]:
    """Compute Wilson's score interval of a share of `count` trials, which need not be whole."""
    z = float(stats.norm.ppf(0.5 + CONFIDENCE / 2.0))
    centre = (share + z * z / (2.0 * count)) / (1.0 + z * z / count)
    half = z * np.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count**2))
    half /= 1.0 + z * z / count
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def half_interval(values: Numbers) -> float:
    """Compute half of Student's 95 % interval of a mean of independent values, at least two."""
    count = len(values)
    spread = float(values.std(ddof=1)) / math.sqrt(count)
    return float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, count - 1)) * spread


def _variance_of_mean(values: Numbers) -> float:
    return float(values.var(ddof=1)) / len(values) if len(values) > 1 else 0.0


FILE = "results.jsonl"
SEED = 20_261_121  # of every start's draws

Key = tuple[Any, ...]
Advance = Callable[[int, int, str], None]  # how many are done, how many there are, the latest


class Row(Protocol):
    """A result that is kept in a file."""

    @property
    def key(self) -> Key:
        """The job that gave it; the first three say so to a reader."""


AnyRow = TypeVar("AnyRow", bound=Row)


@dataclass(frozen=True)
class Result:
    """The episodes of one seed of a method; plain lists, as a file keeps them."""

    task: str
    method: str
    preset: str
    seed: int
    success: list[bool]  # (starts,)
    time: list[float]  # (starts,) [s]
    metrics: dict[str, list[float]]  # the task's own, (starts,) each
    decision_time: float  # [s] a decision of one environment

    def __post_init__(self) -> None:
        checks.integer("seed", self.seed, least=0)
        for values in (self.time, *self.metrics.values()):
            if len(values) != len(self.success):
                raise ValueError(f"each start must have its time and its metrics, got {values}")

    @property
    def key(self) -> tuple[str, str, str, int]:
        return (self.task, self.method, self.preset, self.seed)


@dataclass(frozen=True, eq=False)
class Summary:
    """All seeds of one method on a task under one preset."""

    results: tuple[Result, ...]

    @property
    def success(self) -> Booleans:
        """(seeds, starts)."""
        return np.array([result.success for result in self.results])

    @property
    def rate(self) -> float:
        return float(self.success.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """[-] 95 % of the rate."""
        return interval(self.success)

    @property
    def time(self) -> Numbers:
        """(seeds, starts) [s] until the end."""
        return np.array([result.time for result in self.results])

    @property
    def decision_time(self) -> float:
        """[s] of one environment's decision."""
        return float(np.mean([result.decision_time for result in self.results]))

    def metric(self, name: str) -> Numbers:
        """Collect sizes (seeds, starts) of one of the task's metrics."""
        return np.abs(np.array([result.metrics[name] for result in self.results]))

    def value(self, column: Column, fixed: "Summary") -> float:
        """Compute a column's number, unscaled, beside the fixed layout's results.

        nan where it has none: it needs every start of both boxes, and this method ran on some, or
        on other parcels.
        """
        fewer = self.success.shape[1] != fixed.success.shape[1]
        others = bool(PRESETS[self.results[0].preset].parcels)
        if column.every_start and (fewer or others):
            return float("nan")
        return column.value(self, fixed)


Summaries = dict[tuple[str, str, str], Summary]  # by task, method and preset


def summarise(results: Sequence[Result]) -> Summaries:
    """Put the seeds of each method together, in the order of the results."""
    found: dict[tuple[str, str, str], list[Result]] = {}
    for result in results:
        found.setdefault(result.key[:3], []).append(result)
    return {key: Summary(tuple(group)) for key, group in found.items()}


def find_benchmark(task: str) -> Benchmark:
    """Find the benchmark of a task, the package's or the user's own."""
    return find_task(task).benchmark()


def choose_starts(
    benchmark: Benchmark, count: int | None, preset: Preset
) -> tuple[dict[str, Any], ...]:
    """Choose the starts of a benchmark under a preset.

    Args:
        count: of starts, spread evenly over all; None: all of them.
        preset: one with parcels of its own leaves open which parcel a start has.
    """
    starts = benchmark.starts
    if count is not None:
        places = np.linspace(0, len(starts) - 1, min(count, len(starts))).round()
        starts = tuple(starts[place] for place in places.astype(int).tolist())
    if not preset.parcels:
        return starts
    return tuple({key: start[key] for key in start if key != "parcel"} for start in starts)


def play(method: Method, seed: int, preset_name: str) -> tuple[Result, Episodes]:
    """Run a method's seed on its task under a preset."""
    preset, benchmark = PRESETS[preset_name], find_benchmark(method.task)
    starts = choose_starts(benchmark, method.starts, preset)
    config = method.config(benchmark.task, preset)
    controller = method.make(config, seed)
    run = run_episodes if method.starts is None else run_sequentially
    episodes = run(controller, config, starts, SEED)
    result = Result(
        task=method.task,
        method=method.name,
        preset=preset_name,
        seed=seed,
        success=episodes.success.tolist(),
        time=episodes.time.tolist(),
        metrics={name: values.tolist() for name, values in episodes.metrics.items()}
        | _path_metrics(config, episodes, starts),
        decision_time=episodes.decision_time,
    )
    return result, episodes


def compute(method: Method, seed: int, preset: str) -> Result:
    """`play` in a process of its own."""
    return play(method, seed, preset)[0]


def _path_metrics(
    config: EnvConfig, episodes: Episodes, starts: Sequence[dict[str, Any]]
) -> dict[str, list[float]]:
    """Compute what the task measures on whole paths; most tasks measure nothing there."""
    task, line = config.task, config.chosen_line
    found: dict[str, list[float]] = {}
    if type(task).path_metrics is sg.tasks.Task.path_metrics:
        return found
    for k, parcel in enumerate(drawn_parcels(config, starts, SEED)):
        for name, value in task.path_metrics(episodes.path(k), parcel, line, None).items():
            found.setdefault(name, []).append(value)
    return found


def drawn_parcels(
    config: EnvConfig, starts: Sequence[dict[str, Any]], seed: int
) -> tuple[sg.Parcel, ...]:
    """List the parcel of each start; start k draws from `seed` + k."""
    env = sg.SmartSurfaceVectorEnv(num_envs=len(starts), **config.arguments())
    env.reset(seed=seed, options=list(starts))
    parcels = tuple(env.batch.parcel(i) for i in range(len(starts)))
    env.close()
    return parcels


def list_jobs(methods: Sequence[Method]) -> list[tuple[Method, int, str]]:
    """Every method, seed and preset to compute; the slowest first, to fill the cores."""
    found = [
        (method, seed, preset)
        for method in methods
        for seed in method.seeds
        for preset in PRESETS
        if method.presets is None or preset in method.presets
    ]
    return sorted(found, key=lambda job: job[0].starts is None)


def compute_results(
    methods: Sequence[Method],
    workers: Workers,
    folder: Path | None = None,
    advance: Advance = lambda *_: None,
) -> list[Result]:
    """Compute the results of all methods, in an order that does not depend on the processes."""
    jobs = {
        (method.task, method.name, preset, seed): partial(compute, method, seed, preset)
        for method, seed, preset in list_jobs(methods)
    }
    file = None if folder is None else folder / FILE
    found = compute_kept(jobs, Result, workers, file, advance)
    order = {(method.task, method.name): k for k, method in enumerate(methods)}
    presets = list(PRESETS)
    return sorted(
        found.values(), key=lambda row: (order[row.key[:2]], presets.index(row.preset), row.seed)
    )


@contextmanager
def show_progress(console: Console, title: str) -> Iterator[Advance]:
    """Show a bar for work under way; what it yields moves the bar, and names the latest part."""
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


def compute_kept(
    jobs: Mapping[Any, Callable[[], AnyRow]],
    make: Callable[..., AnyRow],
    workers: Workers,
    file: Path | None,
    advance: Advance,
) -> dict[Any, AnyRow]:
    """Compute the results that are not kept yet.

    Args:
        jobs: to do, by the key of the dataclass that each gives; they do not depend on each other.
        file: where results are kept, one in a line; those found there are not computed again.
    """
    found: dict[Key, AnyRow] = {}
    if file is not None:
        found = {each.key: each for each in read_kept(file, make)}
        # A line that was broken off must not spoil the next.
        with replacing(file) as part:
            part.write_text("".join(map(_line, found.values())))
    left = [partial(without_report, job) for key, job in jobs.items() if key not in found]
    for done, (_, each) in enumerate(map_jobs(left, workers), len(jobs) - len(left) + 1):
        found[each.key] = each
        if file is not None:
            with file.open("a") as kept:
                kept.write(_line(each))
        advance(done, len(jobs), ", ".join(map(str, each.key[:3])))
    return {key: found[key] for key in jobs}


def read_kept(file: Path, make: Callable[..., AnyRow]) -> list[AnyRow]:
    """Read the results kept in a file; a last line that was broken off is left out.

    There are none where there is no file.

    Raises:
        ValueError: a line holds no result; the error names the file and the line.
    """
    found: list[AnyRow] = []
    try:
        for line in read_lines(file, cut=r"\{.*"):
            row = make(**json.loads(line))
            _check_fields(row)
            found.append(row)
    except FileNotFoundError:
        return []
    except DAMAGE as error:
        reason = describe_at_line(error, len(found) + 1)
        raise ValueError(
            f"{file} holds something else than results: {reason}; where the line, or the file, is "
            "removed, they are computed again"
        ) from None
    return found


def _check_fields(row: Any) -> None:
    """Raise a ValueError where a field of a dataclass is not of its type."""
    for name, kind in get_type_hints(type(row)).items():
        _check_kind(name, getattr(row, name), kind)


def _check_kind(name: str, value: Any, kind: Any) -> None:
    outer = get_origin(kind) or kind
    if outer is UnionType:
        outer = kind = next((each for each in get_args(kind) if _is_of(value, each)), kind)
    if not _is_of(value, outer):
        raise ValueError(f"{name} must be of {kind}, got {value!r:.60}")
    if kind is float and value == value:  # nan: there was nothing to measure
        checks.number(name, value)
    for each in value if outer is list else value.values() if outer is dict else ():
        _check_kind(name, each, get_args(kind)[-1])
    if is_dataclass(kind):
        _check_fields(value)


def _is_of(value: Any, kind: Any) -> bool:
    if isinstance(kind, UnionType):
        return False
    return isinstance(value, (int, float) if kind is float else kind) and (
        kind is bool or not isinstance(value, bool)
    )


def _line(each: Any) -> str:
    return json.dumps(asdict(each)) + "\n"
