"""The request of a search, as its YAML file has it, and the command that starts or resumes one:
`surface-gym tune sweep.yml`, or `train.py --search sweep.yml`.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surface_gym import checks, files, parallel
from surface_gym.cli import TRAIN, command_line, typed
from surface_gym.files import DAMAGE, describe_damage

from ..learning.config import RENAMED, TrainConfig, defaults
from ..yaml_file import read_yaml

if TYPE_CHECKING:
    from rich.console import Console

ALGOS = ("ppo", "dqn", "modules")
METRICS = ("success", "return")
SAMPLERS = ("tpe", "random")
PRUNERS = ("median", "halving", "none")
OF_THE_SEARCH = ("task", "algo", "device", "seed", "seeds", "steps", "out", "name")
ROLLOUT = ("num_envs", "n_steps", "batch_size")  # which must go together


@dataclass(frozen=True)
class Span:
    """Numbers from `low` to `high`, integers if both are."""

    low: float
    high: float
    log: bool = False  # drawn evenly by logarithm

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            checks.number(name, getattr(self, name))
        if self.low >= self.high:
            raise ValueError(f"low must be less than high, {self.high!r}, got {self.low!r}")
        if checks.one_of("log", self.log, (True, False)):
            checks.positive("low where log is true", self.low)

    @property
    def ends(self) -> tuple[Any, ...]:
        return self.low, self.high


@dataclass(frozen=True)
class Choices:
    """Some values."""

    choices: list[Any]

    def __post_init__(self) -> None:
        if not isinstance(self.choices, list) or len(self.choices) < 2:
            raise ValueError(f"choices must be a list of two or more, got {self.choices!r}")
        try:
            texts = [json.dumps(choice) for choice in self.choices]
        except TypeError as error:
            raise ValueError(f"choices must be plain values, got {error}") from None
        if len(set(texts)) < len(texts):
            raise ValueError(f"choices must differ, got {self.choices!r}")

    @property
    def ends(self) -> tuple[Any, ...]:
        return tuple(self.choices)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """The request of a search; names in `space` and `fixed` are those of the algorithm's
    configuration.
    """

    task: str = "sort"
    algo: str = "ppo"
    trials: int = 20
    steps: int = 200_000  # control periods that a trial learns from, with each seed
    evaluations: int = 5  # of a trial during training, where it may be pruned, with each seed
    seeds: int = 1  # of a trial, whose mean counts
    seed: int = 0  # of the sampler, and the first that trials learn with
    metric: str = "success"  # or the return
    sampler: str = "tpe"
    pruner: str = "median"
    startup_trials: int = 8  # before the sampler and the median pruner start
    space: dict[str, Span | Choices] = field(default_factory=dict)
    fixed: dict[str, Any] = field(default_factory=dict)  # that differs from the task's defaults

    def __post_init__(self) -> None:
        checks.one_of("algo", self.algo, ALGOS)
        for name, allowed in (("metric", METRICS), ("sampler", SAMPLERS), ("pruner", PRUNERS)):
            checks.one_of(name, getattr(self, name), allowed)
        for name in ("trials", "evaluations", "seeds"):
            checks.integer(name, getattr(self, name), least=1)
        for name in ("seed", "startup_trials"):
            checks.integer(name, getattr(self, name), least=0)
        from ..learning.runs import CURVE_EVERY

        least = (self.evaluations + 1) * CURVE_EVERY  # each evaluation has a row of the curve
        checks.integer(f"steps, with {self.evaluations} evaluations,", self.steps, least)
        if not self.space:
            raise ValueError("space must name what to search, got nothing")
        known = [each.name for each in fields(self.default) if each.name not in OF_THE_SEARCH]
        for where, named in (("space", self.space), ("fixed", self.fixed)):
            for name in named:
                checks.one_of(f"a name in {where}", name, known)
        if both := sorted(self.space.keys() & self.fixed.keys()):
            raise ValueError(f"fixed must name nothing that space does, got {', '.join(both)}")
        # A batch must go with its rollout: if part of that is drawn, a trial is refused instead.
        any_batch = {"batch_size": 1} if any(name in self.space for name in ROLLOUT) else {}
        self._try("fixed", any_batch)
        for name, values in self.space.items():
            for value in values.ends:
                if name == "batch_size":
                    checks.integer("space: batch_size", value, least=1)
                else:
                    self._try("space", {name: value, **any_batch})

    @cached_property
    def default(self) -> TrainConfig:
        """The package's configuration of the task and the algorithm."""
        return defaults(self.task, self.algo)

    @property
    def max_reports(self) -> int:
        """Number of evaluations during a trial that is not pruned."""
        return self.seeds * self.evaluations

    def config(self, params: Mapping[str, Any]) -> TrainConfig:
        """Return the configuration of drawn values, with the first seed."""
        chosen: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in {**self.fixed, **params}.items()
        }
        return replace(self.default, **chosen, steps=self.steps, seed=self.seed, seeds=1)

    def _try(self, where: str, params: Mapping[str, Any]) -> None:
        try:
            self.config(params)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{where}: {error}") from None


def read_sweep(file: Path, task: str | None = None) -> Sweep:
    """Read the request of a search. No code is run but that of `task`."""
    try:
        return _read(read_yaml(file, by_hand=True), task)
    except DAMAGE as error:
        raise ValueError(f"{file} is not a search's: {describe_damage(error)}") from None


def differences(sweep: Sweep, other: Sweep) -> list[str]:
    """List the fields in which two searches differ, with both values."""
    return [
        f"{each.name} is {getattr(sweep, each.name)!r} there, {getattr(other, each.name)!r} here"
        for each in fields(Sweep)
        if getattr(sweep, each.name) != getattr(other, each.name)
    ]


def _read(plain: dict[str, Any], task: str | None) -> Sweep:
    from surface_gym.tasks import TASKS

    known = [each.name for each in fields(Sweep)]
    for name in plain:
        checks.one_of("a name", name, known)
    named = plain.get("task", Sweep.task)
    if named != task and not (task is None and named in TASKS):
        raise ValueError(
            f"task must be one of {', '.join(TASKS)}, or a custom one that --task names too, "
            f"got {named!r}"
        )
    for name in ("space", "fixed"):
        if not isinstance(plain.get(name, {}), dict):
            raise ValueError(f"{name} must hold names and values, got {plain[name]!r}")
    space, fixed = (
        {RENAMED.get(name, name): value for name, value in plain.get(part, {}).items()}
        for part in ("space", "fixed")
    )
    space = {name: _values(name, values) for name, values in space.items()}
    return Sweep(**{**plain, "space": space, "fixed": fixed})


def _values(name: str, values: Any) -> Span | Choices:
    given = set(values) if isinstance(values, dict) else set()
    try:
        if given == {"choices"}:
            return Choices(**values)
        if {"low", "high"} <= given <= {"low", "high", "log"}:
            return Span(**values)
        raise ValueError(f"must be {{low, high, log}} or {{choices}}, got {values!r}")
    except ValueError as error:
        raise ValueError(f"space: {name}: {error}") from None


FILE = "sweep.yml"  # in a search's folder


def main(arguments: Sequence[str] | None = None) -> None:
    """Search hyper-parameters; an error ends it with one line."""
    parser = argparse.ArgumentParser(prog=typed("tune"), description=main.__doc__)
    parser.add_argument("file", type=Path, help="what to search, as docs/search.md says")
    parser.add_argument("--task", help="custom task of the search, as path/to/file.py:Class")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="folder for searches")
    parser.add_argument("--name", help="folder in there, which is resumed if it holds the search")
    parser.add_argument("--cluster", help="address of a Ray cluster to share the trials among")
    given = parser.parse_args(arguments)
    from rich.console import Console

    from ..library import task_files

    folder = given.out / (given.name or f"search-{given.file.stem}")
    try:
        workers = parallel.choose_workers(
            given.cluster, parallel.usable_cores(), task_files(given.task)
        )
        search(given.file, folder, workers, Console(), given.task)
    except (ValueError, parallel.WorkFailed) as error:
        sys.exit(f"error: {error}")


def search(
    file: Path, folder: Path, workers: parallel.Workers, console: "Console", task: str | None = None
) -> None:
    """Search hyper-parameters and leave a report in a folder, or resume a search there."""
    parallel.check_workers(workers)
    if find_spec("optuna") is None:
        raise ValueError(
            "search needs optuna, which is not installed: pip install 'surface_gym[search]'"
        )
    from . import study

    sweep = open_folder(file, folder, task)
    with study.open_study(sweep, folder) as opened:
        try:
            study.optimize(sweep, opened, workers, console, study.run_trial)
        except KeyboardInterrupt:
            kept = len(study.finished_trials(opened))
            console.print(
                f"interrupted: {folder} holds {kept} trials; "
                f"{command_line(TRAIN, '--resume', str(folder))} resumes it",
                soft_wrap=True,
            )
            return
        study.write_report(sweep, opened, folder)
        trials = study.finished_trials(opened)
    console.print(study.summary(sweep, trials))
    best = "" if study.best_trial(trials) is None else f" and {study.BEST}"
    console.print(f"{folder} holds {study.PAGE}{best}", soft_wrap=True)


def open_folder(file: Path, folder: Path, task: str | None = None) -> Sweep:
    """Read the request of a search and keep it in the search's folder, which is made if need be."""
    sweep = read_sweep(file, task)
    kept = folder / FILE
    if kept.is_file():
        before = read_sweep(kept, task)
        if found := differences(before, sweep):
            raise ValueError(f"folder must be of this search, got {folder}: {'; '.join(found)}")
        return before
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"folder must be new, or a search's, got {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    with files.replacing(kept) as part:
        part.write_bytes(file.read_bytes())
    return sweep
