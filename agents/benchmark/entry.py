"""Entries: results of one policy on the benchmark, by episode, and the file that holds them."""

import hashlib
import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.files import DAMAGE, describe_damage, read_text, replacing
from surface_gym.flow.arrivals import HOUR
from surface_gym.parallel import Workers, map_jobs, without_report

from ..evaluation.stream_scenario import measure_stream, play_stream
from ..rollout import run_episodes
from .process import Limits, PolicyFailure, PolicyProcess
from .protocol import EPISODES, TASKS, VERSION, WARM_UP, TestCell, test_cells

SIZE = 2**24  # [bytes] maximum size of a file
TEXT = 200  # maximum characters of a text in an entry


@dataclass(frozen=True)
class Row:
    """Results of one training seed of a policy in one cell."""

    task: str
    cell: str
    seed: int  # of training; 0 for policies that do not learn
    digest: str  # of the cell's starts
    env_kwargs: dict[str, Any]  # chosen arguments of the environment
    # (episodes,) 1 for a success and 0 for a failure; on streams, correct deliveries per hour
    scores: tuple[float, ...]
    times: tuple[float, ...]  # (episodes,) [s] duration of the episode
    decision_time: float  # [s] median time of a decision for one environment
    failure: str = ""  # reason; then there are no scores

    def __post_init__(self) -> None:
        TestCell(self.task, self.cell)
        checks.integer("seed", self.seed, least=0)
        checks.not_negative("decision_time", self.decision_time)
        most = 1.0 if not _is_on_streams(self.task) else 1e6
        for name, limit in (("scores", most), ("times", 1e6)):
            values = tuple(checks.not_negative(name, each, limit) for each in getattr(self, name))
            object.__setattr__(self, name, values)
            if len(values) not in (0, EPISODES) or (not values) != bool(self.failure):
                raise ValueError(
                    f"{name} must have {EPISODES} numbers, or none with a failure, "
                    f"got {len(values)}"
                )


@dataclass(frozen=True)
class Entry:
    """An entry of the benchmark: who, how, and the results of each episode."""

    name: str  # unique on the board
    rows: tuple[Row, ...]
    by: str = ""  # author
    link: str = ""  # to code or a publication
    kind: str = "agent"  # "agent", "rule", "planner" or "baseline"
    interactions: int = 0  # control periods of training per seed
    source: str = ""  # name of the policy's file or folder
    source_digest: str = ""  # of the policy's files
    version: str = sg.__version__  # of the package
    machine: str = ""  # processor
    protocol: int = VERSION

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if each.type is str and (not isinstance(value, str) or len(value) > TEXT):
                raise ValueError(f"{each.name} must be a text of at most {TEXT}, got {value!r:.60}")
        if not self.name:
            raise ValueError("name must not be empty")
        checks.one_of("kind", self.kind, KINDS)
        checks.one_of("protocol", self.protocol, (VERSION,))
        checks.integer("interactions", self.interactions, least=0)
        keys = [(row.task, row.cell, row.seed) for row in self.rows]
        if len(set(keys)) < len(keys):
            raise ValueError("rows must be one per task, cell and seed, got one twice")


KINDS = ("baseline", "rule", "planner", "agent")


def _is_on_streams(task: str) -> bool:
    return EnvConfig(task=task).task.is_stream


@dataclass(frozen=True)
class CellJob:
    """A training seed of a policy in one cell."""

    test: TestCell
    source: str  # of `PolicyProcess`; "{seed}" stands for the seed
    seed: int
    given: tuple[tuple[str, Any], ...] = ()  # arguments of the environment from the command line
    limits: Limits = Limits()
    episodes: int = EPISODES

    def __call__(self) -> Row:
        """Run the policy in its own process; a failure of the policy is a result."""
        test = self.test
        kwargs: dict[str, Any] = {}
        try:
            with PolicyProcess(self.source, self.seed, self.limits) as policy:
                kwargs = {**policy.env_kwargs(test.task), **dict(self.given)}
                config = test.config(kwargs)
                if test.compute_digest(config) != test.digest:
                    raise PolicyFailure("changed the test starts by its arguments")
                policy.begin(test.task, test.cell, kwargs, self.episodes)
                scores, times = _play(test, config, policy, self.episodes)
                seconds = policy.decision_time
        except (PolicyFailure, ValueError) as error:
            reason = " ".join(str(error).split())[:TEXT]
            return Row(test.task, test.cell, self.seed, test.digest, kwargs, (), (), 0.0, reason)
        return Row(test.task, test.cell, self.seed, test.digest, kwargs, scores, times, seconds)


Values = tuple[float, ...]


def _play(test: TestCell, config: EnvConfig, policy: Any, count: int) -> tuple[Values, Values]:
    """Run the first episodes of a cell; return scores and durations [s]."""
    if config.task.is_stream:
        batch = play_stream(config, policy, count, seed=test.seed)
        assert batch is not None
        found = measure_stream(batch, WARM_UP)
        scores = [HOUR * row["correct"] / row["counted"] for row in found]
        return _rounded(scores, 1), _rounded(batch.streams.clock, 2)
    starts: list[dict[str, Any]] = [{}] * count
    episodes = run_episodes(policy, config, starts, test.seed, test.periods(config))
    return _rounded(episodes.success, 0), _rounded(episodes.time, 3)


def _rounded(values: Any, digits: int) -> Values:
    return tuple(np.round(np.asarray(values, dtype=np.float64), digits).tolist())


def run_entry(
    entry: Entry, jobs: Sequence[CellJob], workers: Workers, advance: Callable[[int, int, str], None]
) -> Entry:
    """Run jobs, and return the entry with their rows after its own.

    Args:
        advance: called with finished jobs, all jobs, and the latest job.
    """
    rows: dict[int, Row] = {}

    def name(place: int) -> str:
        test = jobs[place].test
        return f"{test.task}, {test.cell}, seed {jobs[place].seed}"

    work = [partial(without_report, job) for job in jobs]
    for place, row in map_jobs(work, workers, name=name):
        rows[place] = row
        advance(len(rows), len(jobs), name(place) + (f": {row.failure}" if row.failure else ""))
    own = {each.name: getattr(entry, each.name) for each in fields(entry)}
    return Entry(**{**own, "rows": (*entry.rows, *(rows[place] for place in sorted(rows)))})


def make_jobs(
    source: str, tasks: Sequence[str], seeds: Sequence[int], given: dict[str, Any], limits: Limits
) -> list[CellJob]:
    """List the jobs of a policy: each cell of each task, for each training seed."""
    chosen = tuple(given.items())
    return [
        CellJob(test, source.replace("{seed}", str(seed)), seed, chosen, limits)
        for test in test_cells(tuple(checks.one_of("tasks", task, TASKS) for task in tasks))
        for seed in seeds
    ]


def digest_source(sources: Sequence[str]) -> str:
    """Compute the digest of the files of a policy; "" for a name without a file."""
    made, found = hashlib.sha256(), False
    for source in dict.fromkeys(sources):
        place = Path(source.rpartition(":")[0] or source)
        files = sorted(place.rglob("*")) if place.is_dir() else [place]
        for file in files:
            if file.is_file():
                made.update(file.name.encode() + file.read_bytes())
                found = True
    return made.hexdigest()[:16] if found else ""


def describe_machine() -> str:
    """Name the processor of this machine."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()[:TEXT]
    return f"{platform.machine()} {platform.system()}"


def write_entry(entry: Entry, file: Path) -> None:
    """Write an entry as JSON, with one line per row."""
    head = {name: value for name, value in asdict(entry).items() if name != "rows"}
    lines = [json.dumps(asdict(row), separators=(",", ":")) for row in entry.rows]
    text = json.dumps(head, indent=1)[:-2] + ',\n "rows": [\n' + ",\n".join(lines) + "\n]\n}\n"
    with replacing(file) as part:
        part.write_text(text)


def read_entry(file: Path) -> Entry:
    """Read an entry.

    Raises:
        ValueError: the file holds something else; the message names the file and the reason.
    """
    try:
        found = json.loads(read_text(file, SIZE))
        for row in found["rows"]:
            row["scores"], row["times"] = tuple(row["scores"]), tuple(row["times"])
        return Entry(**{**found, "rows": tuple(Row(**row) for row in found["rows"])})
    except FileNotFoundError:
        raise ValueError(f"{file} does not exist") from None
    except DAMAGE as error:
        raise ValueError(f"{file} holds no entry: {describe_damage(error)}") from None


def read_entries(folder: Path) -> list[Entry]:
    """Read all entries of a folder, in order of their names.

    Raises:
        ValueError: a file holds no entry, or two have the same name.
    """
    found = [read_entry(file) for file in sorted(folder.glob("*.json"))]
    names = [each.name for each in found]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"name must be unique on the board, got {name!r} twice in {folder}")
    return sorted(found, key=lambda each: (KINDS.index(each.kind), each.name))
