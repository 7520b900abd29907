"""The benchmark's protocol, and entries: an entry holds one policy's results of all episodes.

A task has four cells. A cell is a set of 128 test episodes, or of 32 streams. The first three cells
have the same starts and exact sensors; their axes turn by 90 deg in 0, 100 and 200 ms. The fourth
cell is the lab, with other parcels, friction, sensors and actuators. An episode's start follows
from the protocol's seed, the cell and the episode's number. The file `protocol-1.json` holds a
digest of the first 128 starts of every cell. If the installed package draws other starts, the
benchmark raises an error.
"""

import hashlib
import json
import math
import platform
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.files import DAMAGE, describe_damage, read_text, replacing
from surface_gym.flow.arrivals import HOUR
from surface_gym.parallel import Workers, map_jobs, without_report
from surface_gym.randomisation import Actuators
from surface_gym.registration import PERIODS

from .. import library
from ..evaluation.streams import measure_stream, play_stream
from ..rollout import run_episodes
from ..scheduling.scheduler import begin_streams
from . import FILE, TASKS, VERSION
from .process import ENV_KWARGS, PolicyFailure, PolicyLimits, PolicyProcess

EPISODES = 128  # per cell and training seed, of one parcel
STREAMS = 32  # streams per cell and training seed: at least as many decisions
SEED = 20_261_126_000  # seed of the first episode; training uses small seeds
WARM_UP = 20.0  # [s] of a stream, before deliveries count


def _slower(quarter_turn: float) -> Preset:
    """Return the preset "exact" with slower axes. A turn by 90 deg takes `quarter_turn` [s]."""
    actuators = Actuators(axis_speed=0.5 * math.pi / quarter_turn)
    return replace(PRESETS["exact"], actuators=actuators)


# Sensors, randomisation and actuators of each cell.
CELLS = {
    "0 ms": PRESETS["exact"], "100 ms": _slower(0.1), "200 ms": _slower(0.2), "lab": PRESETS["lab"],
}  # fmt: skip


@dataclass(frozen=True)
class TestCell:
    """A cell: the test episodes of a task under one preset."""

    __test__ = False  # for pytest

    task: str
    cell: str

    def __post_init__(self) -> None:
        checks.one_of("task", self.task, TASKS)
        checks.one_of("cell", self.cell, CELLS)

    @property
    def seed(self) -> int:
        """Seed of the first episode. The seed of episode k is this number plus k.

        All cells with exact sensors have the same starts. These cells differ in the speed of axes.
        """
        place = list(PRESETS).index(CELLS[self.cell].name)
        return SEED + 10_000 * TASKS.index(self.task) + 1000 * place

    @property
    def episodes(self) -> int:
        """Number of episodes per training seed."""
        return STREAMS if PERIODS[self.task] is None else EPISODES

    @property
    def digest(self) -> str:
        """Digest of the first 128 starts. The protocol's file contains this digest."""
        found: str = read_protocol()["digests"][self.task][self.cell]
        return found

    def config(self, chosen: dict[str, Any]) -> EnvConfig:
        """Return the configuration of the cell's environment.

        Args:
            chosen: arguments that the policy chooses; see `ENV_KWARGS`.

        Raises:
            ValueError: an argument is not in `ENV_KWARGS`, or has an invalid value.
        """
        for name in chosen:
            checks.one_of("env_kwargs", name, ENV_KWARGS)
        try:
            return EnvConfig(task=self.task, preset=CELLS[self.cell], **chosen)
        except TypeError as error:
            raise ValueError(str(error)) from None

    def periods(self, config: EnvConfig) -> int:
        """Return the time limit in control periods; all policies have the same limit in seconds."""
        usual = EnvConfig(task=self.task)
        return math.ceil(usual.periods * usual.control_period / config.control_period - 1e-9)

    def compute_digest(self, config: EnvConfig, count: int = EPISODES) -> str:
        """Compute the digest of the first `count` starts of an environment."""
        if config.task.is_stream:
            streams = begin_streams(config, count, self.seed).streams
            arrays = [
                getattr(streams, name)[i, :arrived]
                for i, arrived in enumerate(streams.arrivals.tolist())
                for name in ("time", "start", "body", "exit")
            ]
        else:
            env = sg.SmartSurfaceVectorEnv(num_envs=count, **config.arguments())
            _, info = env.reset(seed=self.seed)
            arrays = [info[name] for name in ("pose", "velocity", "parcel")]
            arrays += [env.batch.parcels.goal.copy(), env.batch.parcels.path.copy()]
            env.close()
        made = hashlib.sha256()
        for array in arrays:  # single precision is the same on every machine
            made.update(np.ascontiguousarray(array, dtype=np.float32).tobytes())
        return made.hexdigest()[:16]


@lru_cache
def read_protocol() -> dict[str, Any]:
    """Read the protocol's file: version, digests, and references."""
    found: dict[str, Any] = json.loads(FILE.read_text())
    return found


SIZE = 2**24  # [bytes] maximum size of a file
TEXT = 200  # maximum characters of a text in an entry


@dataclass(frozen=True)
class Row:
    """Results of one training seed of a policy on the test episodes of one cell (`TestCell`)."""

    task: str
    cell: str
    seed: int  # of training; 0 for policies that do not learn
    digest: str  # of the cell's starts
    env_kwargs: dict[str, Any]  # chosen arguments of the environment
    # (episodes,) 1 for a success and 0 for a failure; on streams, correct deliveries per hour
    scores: tuple[float, ...]
    times: tuple[float, ...]  # (episodes,) [s] duration of the episode
    decision_time: float  # [s] mean time of a decision for one environment, with its process
    failure: str = ""  # reason; then there are no scores
    source_digest: str = ""  # of the policy's files for this task and seed; "": not known

    def __post_init__(self) -> None:
        count = TestCell(self.task, self.cell).episodes
        checks.integer("seed", self.seed, least=0)
        checks.not_negative("decision_time", self.decision_time)
        most = 1e6 if PERIODS[self.task] is None else 1.0
        for name, limit in (("scores", most), ("times", 1e6)):
            values = tuple(checks.not_negative(name, each, limit) for each in getattr(self, name))
            object.__setattr__(self, name, values)
            if len(values) not in (0, count) or (not values) != bool(self.failure):
                raise ValueError(
                    f"{name} must have {count} numbers, or none with a failure, got {len(values)}"
                )


@dataclass(frozen=True)
class BenchmarkEntry:
    """An entry of the benchmark: a policy, its author, and the result of each episode."""

    name: str  # unique on the board
    rows: tuple[Row, ...]
    by: str = ""  # author
    link: str = ""  # to code or a publication
    kind: str = "agent"  # "agent", "rule", "planner" or "baseline"
    interactions: int = 0  # control periods of training per seed
    source: str = ""  # name of the policy's file or folder
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


@dataclass(frozen=True)
class PolicyJob:
    """A job that runs one training seed of a policy in several cells, one after the other."""

    tests: tuple[TestCell, ...]
    source: str  # of `PolicyProcess`
    seed: int
    given: tuple[tuple[str, Any], ...] = ()  # arguments of the environment from the command line
    limits: PolicyLimits = field(default_factory=PolicyLimits)

    @property
    def name(self) -> str:
        """Name of the job in reports of progress."""
        return f"{', '.join(dict.fromkeys(test.task for test in self.tests))}, seed {self.seed}"

    def __call__(self) -> list[Row]:
        """Run the policy in its own process. After a failure in a cell, the cell's row says why."""
        rows, source_digest = [], digest_source(self.source)
        with ExitStack() as processes:
            policy = None
            for test in self.tests:
                kwargs: dict[str, Any] = {}
                try:
                    if policy is None:
                        policy = processes.enter_context(PolicyProcess(self.source, self.limits))
                    kwargs = policy.env_kwargs(test.task, CELLS[test.cell].name)
                    kwargs |= dict(self.given)
                    rows.append(self._run(policy, test, kwargs))
                except PolicyFailure as error:
                    policy = None  # its process has ended
                    key = (test.task, test.cell, self.seed, test.digest, kwargs)
                    rows.append(Row(*key, (), (), 0.0, str(error)[:TEXT]))
        return [replace(row, source_digest=source_digest) for row in rows]

    def _run(self, policy: PolicyProcess, test: TestCell, kwargs: dict[str, Any]) -> Row:
        scores, times = play_cell(test, policy, self.seed, kwargs)
        decisions = len(times) * max(times) / test.config(kwargs).control_period
        seconds = float(f"{policy.decided / decisions:.2g}")
        return Row(test.task, test.cell, self.seed, test.digest, kwargs, scores, times, seconds)


Values = tuple[float, ...]


def play_cell(
    test: TestCell,
    policy: PolicyProcess,
    seed: int,
    kwargs: dict[str, Any],
    count: int | None = None,
) -> tuple[Values, Values]:
    """Run the first episodes of a cell; return the score and the duration [s] of each episode.

    Args:
        seed: training seed.
        kwargs: environment arguments that the policy chose.
        count: number of episodes; the default is all episodes of the cell.

    Raises:
        PolicyFailure: the policy failed.
        ValueError: the starts differ from the protocol's starts, or an argument is not allowed.
    """
    config = test.config(kwargs)
    if (found := test.compute_digest(config)) != test.digest:
        raise ValueError(
            f"starts of {test.task}, {test.cell}, must have the digest {test.digest}, got {found}"
        )
    count = test.episodes if count is None else count
    policy.begin(config.arguments(), seed)
    if config.task.is_stream:
        batch = play_stream(config, policy, count, seed=test.seed)
        assert batch is not None
        rows = measure_stream(batch, WARM_UP)
        scores = [HOUR * row["correct"] / row["counted"] for row in rows]
        return _rounded(scores, 1), _rounded(batch.streams.clock, 2)
    starts: list[dict[str, Any]] = [{}] * count
    episodes = run_episodes(policy, config, starts, test.seed, test.periods(config))
    return _rounded(episodes.success, 0), _rounded(episodes.time, 3)


def _rounded(values: Any, digits: int) -> Values:
    return tuple(np.round(np.asarray(values, dtype=np.float64), digits).tolist())


def run_entry(
    entry: BenchmarkEntry,
    jobs: Sequence[PolicyJob],
    workers: Workers,
    advance: Callable[[int, int, str], None],
) -> BenchmarkEntry:
    """Run jobs on `workers`. Return a copy of the entry with the rows of the jobs appended.

    Args:
        advance: called with the number of finished jobs, the number of jobs, and the latest job's
            name.
    """
    found: dict[int, list[Row]] = {}
    work = [partial(without_report, job) for job in jobs]
    for place, rows in map_jobs(work, workers, name=lambda place: jobs[place].name):
        found[place] = rows
        advance(len(found), len(jobs), jobs[place].name)
    more = tuple(row for place in sorted(found) for row in found[place])
    return replace(entry, rows=entry.rows + more)


def make_jobs(
    source: str,
    tasks: Sequence[str],
    seeds: Sequence[int],
    given: dict[str, Any],
    limits: PolicyLimits,
) -> list[PolicyJob]:
    """List the jobs of a policy, one per task and training seed.

    A job runs all cells of its task; a cell is a set of test episodes.

    Args:
        source: see `PolicyProcess`. "{task}" and "{seed}" stand for a task and a training seed.
        seeds: training seeds. An empty sequence means all seeds of a shipped agent, or
            seed 0 of another policy.
        given: arguments of the environment. They override the arguments that the policy requests.
    """
    if source in library.names():
        seeds = seeds or library.seeds(source)
    return [
        PolicyJob(
            tuple(TestCell(checks.one_of("tasks", task, TASKS), cell) for cell in CELLS),
            find_source(source, task, seed), seed, tuple(given.items()), limits,
        )
        for task in tasks
        for seed in seeds or (0,)
    ]  # fmt: skip


def find_source(source: str, task: str, seed: int) -> str:
    """Replace "{task}" and "{seed}" in the `source` of a policy; see `make_jobs`.

    If `source` is the name of a shipped agent, return the agent's folder for this seed.
    """
    if source in library.names():
        source = str(library.SHELF / source / "seed-{seed}")
    return source.replace("{task}", task).replace("{seed}", str(seed))


def digest_source(source: str) -> str:
    """Compute the digest of a policy's files. Return "" if `source` is neither file nor folder."""
    place = Path(source.rpartition(":")[0] or source)
    files = sorted(place.rglob("*")) if place.is_dir() else [place]
    made, found = hashlib.sha256(), False
    for file in files:
        if file.is_file():
            made.update(file.name.encode() + file.read_bytes())
            found = True
    return made.hexdigest()[:16] if found else ""


def keep_rows(
    entry: BenchmarkEntry, file: Path, source: str, jobs: Sequence[PolicyJob]
) -> BenchmarkEntry:
    """Add to `entry` the rows of an earlier entry that are still valid; return the result.

    So tasks can be run on different days. Rows for the tasks and seeds of `jobs` are not added. If
    the policy's source or the package's version has changed, no row is added. If the policy's files
    for a row's task and seed have changed, the row is not added. Missing files count as unchanged.

    Args:
        file: file of the earlier entry; it may be missing.
        source: source of the policy, in the form that `make_jobs` takes.
    """
    if not file.is_file():
        return entry
    old = read_entry(file)
    if (old.source, old.version) != (entry.source, entry.version):
        return entry
    new = {(test.task, job.seed) for job in jobs for test in job.tests}
    others = {(row.task, row.seed) for row in old.rows} - new
    now = {each: digest_source(find_source(source, *each)) for each in others}
    kept = (
        row
        for row in old.rows
        if (digest := now.get((row.task, row.seed))) is not None
        and (not row.source_digest or digest in ("", row.source_digest))
    )
    return replace(entry, rows=(*entry.rows, *kept))


def describe_machine() -> str:
    """Name the processor of this machine."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()[:TEXT]
    return f"{platform.machine()} {platform.system()}"


def write_entry(entry: BenchmarkEntry, file: Path) -> None:
    """Write an entry as JSON. Each row of results is one line of the file."""
    head = {name: value for name, value in asdict(entry).items() if name != "rows"}
    lines = [json.dumps(asdict(row), separators=(",", ":")) for row in entry.rows]
    text = json.dumps(head, indent=1)[:-2] + ',\n "rows": [\n' + ",\n".join(lines) + "\n]\n}\n"
    with replacing(file) as part:
        part.write_text(text)


def read_entry(file: Path) -> BenchmarkEntry:
    """Read an entry.

    Raises:
        ValueError: the file holds no entry; the message names the file and the reason.
    """
    try:
        found = json.loads(read_text(file, SIZE))
        # Old entries have one digest. It tells nothing about a row if files differ by row.
        whole = found.pop("source_digest", "")
        is_one = ":" in found["source"] and "{" not in found["source"]
        for row in found["rows"]:
            row.setdefault("source_digest", whole if is_one else "")
            row["scores"], row["times"] = tuple(row["scores"]), tuple(row["times"])
        return BenchmarkEntry(**{**found, "rows": tuple(Row(**row) for row in found["rows"])})
    except FileNotFoundError:
        raise ValueError(f"{file} does not exist") from None
    except DAMAGE as error:
        raise ValueError(f"{file} holds no entry: {describe_damage(error)}") from None


def read_entries(folder: Path) -> list[BenchmarkEntry]:
    """Read all entries of a folder, sorted by kind and name.

    Raises:
        ValueError: a file holds no entry, or two entries have the same name.
    """
    found = [read_entry(file) for file in sorted(folder.glob("*.json"))]
    names = [each.name for each in found]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"name must be unique on the board, got {name!r} twice in {folder}")
    return sorted(found, key=lambda each: (KINDS.index(each.kind), each.name))
