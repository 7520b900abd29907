"""Training runs and their folders; the seeds of a run train in parallel, also on a cluster.

The folder of a run has its configuration, command, checkpoint, learning curve and card.

At each checkpoint, a run saves its state, seeds all random numbers anew and restarts all
environments. So a resumed run gives the same result as an uninterrupted run.
"""

import csv
import math
import os
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from datetime import datetime
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
import yaml
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress as Bars,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from surface_gym import checks
from surface_gym.cli import TRAIN, command_line
from surface_gym.config import REWARD
from surface_gym.executors import Cluster, Job, Report
from surface_gym.files import (
    ARCHIVE,
    DAMAGE,
    SUFFIX,
    check_plain,
    describe_at_line,
    describe_damage,
    parse_number,
    read_lines,
    replacing,
)
from surface_gym.machine.estimate import Estimate
from surface_gym.parallel import Workers, map_jobs
from surface_gym.registration import TASKS

from ..library import find_algorithm, is_known, read_yaml, task_label
from . import config as configs
from .config import TrainConfig

CONFIG = "config.yaml"
COMMAND = "command.txt"
CHECKPOINT = "checkpoint.pt"
PLAIN = 2**19  # [bytes] maximum size of plain values in a checkpoint; 1000 episodes need half of it
CURVE = "curve.csv"
TENSORBOARD = "tensorboard"  # folder
CARD = "card.yaml"
ESTIMATE = "estimate.json"  # copy of the surface's estimate, which later steps read
CURVE_EVERY = 10_000  # control periods between rows of the curve
FIGURES = ("steps", "success", "return", "length")  # columns of every curve
RECENT_EPISODES = 1000
EPISODES = "episodes"  # number of episodes in an entry of sums; an entry without it is one episode

Restored = TypeVar("Restored")
# Called with finished control periods and the success rate of the latest episodes.
OnProgress = Callable[[int, float], None]


@dataclass(frozen=True)
class TrainResult:
    """Result of a run."""

    steps: int  # number of control periods
    seconds: float  # duration since the last resume
    interrupted: bool


@dataclass(frozen=True)
class Progress:
    """Progress that a run in another process reports."""

    steps: int  # finished control periods
    success: float | None  # success rate of the latest episodes; None: unchanged
    files: dict[str, bytes] = field(default_factory=dict)  # changed files of a remote folder


class StopTraining(Exception):
    """Raised by `on_progress` to end a run early. The run ends as after an interrupt."""


def make_folder(config: TrainConfig, arguments: Sequence[str]) -> Path:
    """Make a run's folder; write the full configuration, and the command with its arguments."""
    which = f"seed{config.seed}" if config.seeds == 1 else f"{config.seeds}seeds"
    labels = task_label(config.task), task_label(config.algo), which
    name = config.name or "-".join((*labels, f"{datetime.now():%Y%m%d-%H%M%S}"))
    folder = config.out / name
    given, estimate = getattr(config, "estimate", None), None
    if given is not None:
        if not given.is_file():
            raise ValueError(f"estimate must be a file of identify, got {given}")
        estimate = Estimate.load(given)
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise ValueError(
            f"name must be a new folder, got {folder}; --resume {folder} goes on with it"
        ) from None
    if estimate is not None:
        estimate.save(folder / ESTIMATE)
    write_config(config, folder / CONFIG)
    (folder / COMMAND).write_text(command_line(TRAIN, *arguments) + "\n")
    return folder


def seed_folders(config: TrainConfig, folder: Path) -> list[tuple[TrainConfig, Path]]:
    """List configuration and folder of each seed. A single seed has the folder of the run."""
    if config.seeds == 1:
        return [(config, folder)]
    return [
        (configs.config_of_seed(config, seed), folder / f"seed-{seed}")
        for seed in range(config.seed, config.seed + config.seeds)
    ]


def write_config(config: TrainConfig, file: Path) -> None:
    """Write all fields of a configuration as YAML."""
    plain = {}
    for each in fields(config):
        value = getattr(config, each.name)
        if isinstance(value, tuple):
            value = list(value)
        plain[each.name] = str(value) if isinstance(value, Path) else value
    file.write_text(yaml.safe_dump(plain, sort_keys=False))


def read_config(file: Path, task: str | None = None, algo: str | None = None) -> TrainConfig:
    """Read a configuration written by `write_config`.

    A file must not select code to execute. So the caller must name a custom task or a custom
    algorithm.

    Args:
        task: required task. If `task` is None, any registered task is allowed.
        algo: required algorithm. If `algo` is None, any registered algorithm is allowed.

    Raises:
        ValueError: the file is damaged, or has another task or algorithm.
    """
    try:
        plain = read_yaml(file)
        known = {"task": plain["task"] in TASKS, "algo": is_known(plain["algo"])}
        for name, given in (("task", task), ("algo", algo)):
            asked = plain[name] if given is None and known[name] else given
            if plain[name] != asked:
                raise ValueError(
                    f"{name} must be {plain[name]!r}, which the run is of: name it by --{name}, "
                    f"got {given!r}"
                )
        kind = find_algorithm(plain["algo"]).config
        plain = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in plain.items()
        }
        plain["out"] = Path(plain["out"])
        if plain.get("estimate") is not None:
            plain["estimate"] = file.parent / ESTIMATE
        config: TrainConfig = kind(**plain)
        return config
    except FileNotFoundError:
        raise ValueError(f"{file.parent} holds no run: {file.name} is missing") from None
    except DAMAGE as error:
        raise ValueError(f"{file} holds no run's configuration: {describe_damage(error)}") from None


def task_name(file: Path) -> str | None:
    """Read a task's name from a configuration; execute no code. For a damaged file, return None."""
    return _read_field(file, "task")


def algorithm_name(file: Path) -> str | None:
    """Read an algorithm's name from a run's configuration, as `task_name` reads the task's name."""
    return _read_field(file, "algo")


def preset_name(file: Path) -> str | None:
    """Read the training's preset from a run's configuration. Return None if the file is damaged."""
    return _read_field(file, "preset")


def _read_field(file: Path, name: str) -> str | None:
    try:
        plain = read_yaml(file)
        return str(plain[name])
    except (OSError, ValueError, KeyError):
        return None


def training_command(config: TrainConfig) -> str:
    """Return the command for a configuration, with all options that differ from the defaults."""
    device = configs.device_of(config)
    default = configs.defaults(config.task, config.algo, preset=config.preset, device=device)
    chosen = ["--task", config.task, "--algo", config.algo]
    if config.preset != configs.NOMINAL:
        chosen += ["--preset", config.preset]
    if device != configs.CPU:
        chosen += ["--device", device]
    for each in fields(config):
        value = getattr(config, each.name)
        if each.name not in ("out", "name") and value != getattr(default, each.name):
            values = value if isinstance(value, tuple) else (value,)
            chosen += [f"--{each.name.replace('_', '-')}", *map(str, values)]
    return command_line(TRAIN, *chosen)


def write_card(
    config: TrainConfig, trained: Sequence[TrainResult], results: dict[str, Any], folder: Path
) -> None:
    """Write a run's card: the command, the seeds, each seed's steps and time, and `results`."""
    card = {
        "command": training_command(config),
        "seeds": list(range(config.seed, config.seed + config.seeds)),
        "steps": [each.steps for each in trained],
        "seconds": [round(each.seconds) for each in trained],  # per seed
        "results": results,
    }
    (folder / CARD).write_text(yaml.safe_dump(card, sort_keys=False))


def interval_at(config: TrainConfig, steps: int) -> int:
    """Return the index of the checkpoint interval that contains control period `steps`."""
    return steps // config.checkpoint_every


def interval_seed(config: TrainConfig, interval: int) -> int:
    """Return the seed of all random numbers in a checkpoint interval."""
    return config.seed + 1_000_003 * interval


def write_state(state: dict[str, Any], folder: Path) -> None:
    """Write tensors and plain values as a folder's checkpoint, atomically."""
    import torch

    with replacing(folder / CHECKPOINT) as part, part.open("wb") as file:
        torch.save(state, file)
        file.flush()
        os.fsync(file.fileno())


def read_state(folder: Path, restore: Callable[[dict[str, Any]], Restored]) -> Restored:
    """Pass a folder's checkpoint to `restore`, and return the result of `restore`.

    No code in the checkpoint is executed.
    """
    from ..tensors import load_tensors

    try:
        check_plain(folder / CHECKPOINT, ARCHIVE)
        with (folder / CHECKPOINT).open("rb") as file:
            return restore(load_tensors(file, PLAIN))
    except DAMAGE as error:
        raise ValueError(
            f"{folder / CHECKPOINT} is damaged or of another run: {describe_damage(error)}"
        ) from None


class Curve:
    """Learning curve in curve.csv and TensorBoard: means over the latest episodes.

    Args:
        terms: names of the task's reward terms; each term has a column.
        steps: number of finished control periods; later rows in the files are removed.
        recent: the latest episodes; an episode is a dictionary from columns to numbers.
    """

    def __init__(
        self, folder: Path, terms: tuple[str, ...], steps: int, recent: list[dict[str, float]]
    ) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self.folder, self._file = folder, folder / CURVE
        self._columns = (*FIGURES, *(REWARD + term for term in terms))
        _check_recent(folder / CHECKPOINT, recent, self._columns[1:])
        self.recent: deque[dict[str, float]] = deque(recent, maxlen=RECENT_EPISODES)
        self._writer: Any = SummaryWriter(str(folder / TENSORBOARD), purge_step=steps or None)
        kept = [row for row in read_curve(folder) if row["steps"] <= steps] if steps else []
        if kept and tuple(kept[0]) != self._columns:
            raise ValueError(f"{self._file} must have the columns {', '.join(self._columns)}")
        with replacing(self._file) as part:
            part.write_bytes((",".join(self._columns) + "\r\n").encode())
            for row in kept:
                self._append(row, part)

    def add_episodes(self, infos: list[dict[str, Any]]) -> None:
        for info in filter(None, infos):
            self.recent.append(
                {
                    "success": float(info["is_success"]),
                    "return": info["episode"]["r"],
                    "length": float(info["episode"]["l"]),
                    **{REWARD + term: value for term, value in info["reward_terms"].items()},
                }
            )

    def add_totals(self, totals: dict[str, float], least: int) -> None:
        """Add `totals`, which hold a rollout's number of episodes and sums over these episodes.

        Then drop old rollouts. A rollout is dropped if all later rollouts together have `least` or
        more episodes. The means cover the remaining rollouts.
        """
        if totals[EPISODES] == 0.0:
            return
        self.recent.append(totals)
        while self._count() - self.recent[0][EPISODES] >= least:
            self.recent.popleft()

    @property
    def success(self) -> float:
        """Success rate [-] of the latest episodes, or NaN if no episode has ended."""
        return self._mean("success")

    def write(self, steps: int) -> None:
        row = {name: self._mean(name) for name in self._columns[1:]}
        self._append({"steps": steps, **row})
        for name, value in row.items():
            term = name.removeprefix(REWARD)
            group = "rollout" if term == name else "reward_terms"
            self._writer.add_scalar(f"{group}/{term}", value, steps)

    def close(self) -> None:
        self._writer.close()

    def _append(self, row: dict[str, float], file: Path | None = None) -> None:
        with (file or self._file).open("a", newline="") as text:
            csv.writer(text).writerow(f"{row[name]:.8g}" for name in self._columns)

    def _count(self) -> float:
        return sum(each.get(EPISODES, 1.0) for each in self.recent)

    def _mean(self, name: str) -> float:
        values = [each[name] for each in self.recent]
        return float(np.sum(values)) / self._count() if values else float("nan")


def read_curve(folder: Path) -> list[dict[str, float]]:
    """Read the rows of a run's curve, without an incomplete last line.

    Raises:
        ValueError: the file contains no curve; the message names the file and the line.
    """
    file = folder / CURVE
    rows: list[dict[str, float]] = []
    lines = csv.reader(read_lines(file, cut=r"[0-9][0-9.,e+na-]*\r?"), strict=True)
    try:
        names = next(lines, [])
        if names[: len(FIGURES)] != list(FIGURES) or len(set(names)) < len(names):
            raise ValueError(f"it must begin with {','.join(FIGURES)}, got {','.join(names)!r:.60}")
        for row in lines:
            if len(row) != len(names):
                raise ValueError(f"a row must have {len(names)} entries, got {len(row)}")
            pairs = zip(names, row, strict=True)
            found = {k: math.nan if v == "nan" else parse_number(k, v) for k, v in pairs}
            for name, most in (("steps", 2.0**53), ("success", 1.0), ("length", math.inf)):
                if name == "steps" or not math.isnan(found[name]):
                    checks.not_negative(name, found[name], most)
            if rows and found["steps"] <= rows[-1]["steps"]:
                raise ValueError(f"steps must rise, got {found['steps']:g}")
            rows.append(found)
    except FileNotFoundError:
        return []
    except (ValueError, csv.Error) as error:
        reason = describe_at_line(error, max(1, lines.line_num))
        raise ValueError(
            f"{file} holds no learning curve: {reason}; without it a new one begins"
        ) from None
    return rows


def _check_recent(file: Path, recent: Any, names: Sequence[str]) -> None:
    """Raise a ValueError unless each episode in `recent` has a number for each name in `names`."""
    try:
        if not isinstance(recent, list):
            raise ValueError(f"recent must be a list, got a {type(recent).__name__}")
        for episode in recent:
            for name in {*names, *episode}:
                checks.number(name, episode[name])
    except DAMAGE as error:
        raise ValueError(f"{file} is damaged or of another run: {describe_damage(error)}") from None


def train(
    config: TrainConfig, folder: Path, on_progress: OnProgress = lambda *_: None
) -> TrainResult:
    """Train one seed by the configuration's algorithm, and write a policy to `folder`.

    If the folder has a checkpoint, training is resumed. An interrupt, or a `StopTraining` that
    `on_progress` raises, saves the current policy.
    """
    result: TrainResult = find_algorithm(config.algo).train(config, folder, on_progress)
    return result


def train_seeds(
    config: TrainConfig, folder: Path, console: Console, workers: Workers
) -> list[TrainResult]:
    """Train every seed of a configuration by `workers`; return the results in the seeds' order.

    If Ctrl-C interrupts the training, all current policies are saved, and results can be missing.
    """
    runs = seed_folders(config, folder)
    for _, own in runs:
        own.mkdir(exist_ok=True)
    jobs: list[Job[TrainResult]] = [
        RemoteRun(*run) if isinstance(workers, Cluster) else partial(_train, *run) for run in runs
    ]
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
        TextColumn("success {task.fields[success]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=console) as bars:
        rows = [
            bars.add_task(f"seed {run.seed} loads and compiles", total=run.steps, success="-")
            for run, _ in runs
        ]

        def on_report(index: int, progress: Progress) -> None:
            put_files(progress.files, runs[index][1])
            named = f"seed {runs[index][0].seed}"
            bars.update(rows[index], description=named, completed=progress.steps)
            if progress.success is not None:
                bars.update(rows[index], success=f"{progress.success:.3f}")

        found: dict[int, TrainResult] = {}
        with suppress(KeyboardInterrupt):
            found.update(
                map_jobs(jobs, workers, on_report, name=lambda index: f"seed {runs[index][0].seed}")
            )
        return [found[index] for index in sorted(found)]


def _train(config: TrainConfig, folder: Path, report: Report) -> TrainResult:
    return train(config, folder, lambda steps, success: report(Progress(steps, success)))


@dataclass(frozen=True)
class RemoteRun:
    """A job that trains in a temporary folder on a node of a cluster.

    The job carries the current files of the run's folder. If a node dies, another node resumes from
    the last checkpoint. The job sends changed files back whenever it reports progress.
    """

    config: TrainConfig
    folder: Path

    def __call__(self, report: Report) -> TrainResult:
        return _train_remotely(self.config, read_files(self.folder), report)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial, (_train_remotely, self.config, read_files(self.folder))


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the content of all files in a folder, by name."""
    return {name: (folder / name).read_bytes() for name in _stamps(folder)}


def put_files(files: dict[str, bytes], folder: Path) -> None:
    """Write files to a folder atomically. The checkpoint is last, as it needs the other files."""
    for name in sorted(files, key=lambda name: name == CHECKPOINT):
        with replacing(folder / name) as part:
            part.write_bytes(files[name])


def _train_remotely(config: TrainConfig, files: dict[str, bytes], report: Report) -> TrainResult:
    with TemporaryDirectory() as name:
        folder = Path(name)
        put_files(files, folder)
        sent = _stamps(folder)

        def changed() -> dict[str, bytes]:
            nonlocal sent
            before, sent = sent, _stamps(folder)
            return {
                name: (folder / name).read_bytes()
                for name, stamp in sent.items()
                if before.get(name) != stamp
            }

        result = train(
            config, folder, lambda steps, success: report(Progress(steps, success, changed()))
        )
        report(Progress(result.steps, None, changed()))
        return result


def _stamps(folder: Path) -> dict[str, tuple[int, int]]:
    return {
        file.relative_to(folder).as_posix(): (file.stat().st_mtime_ns, file.stat().st_size)
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file.suffix != SUFFIX
    }
