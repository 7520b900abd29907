"""What a search is asked for, as its YAML file has it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import yaml

from surface_gym import checks
from surface_gym.tasks import TASKS

from ..learning.config import TrainConfig
from ..learning.hyperparams import defaults
from ..learning.legs import CURVE_EVERY

ALGOS = ("ppo", "dqn", "modules")
METRICS = ("success", "return")
SAMPLERS = ("tpe", "random")
PRUNERS = ("median", "halving", "none")
OF_THE_SEARCH = ("task", "algo", "device", "seed", "seeds", "steps", "out", "name")
ROLLOUT = ("lanes", "n_steps", "batch_size")  # which must go together


@dataclass(frozen=True)
class Span:
    """Numbers from `low` to `high`; whole ones where both are whole.

    Raises:
        ValueError: it holds less than two numbers, or logarithms of what has none.
    """

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
        """Values that must be allowed if all are to be."""
        return self.low, self.high


@dataclass(frozen=True)
class Choices:
    """Some values.

    Raises:
        ValueError: they are less than two, not all different, or not what JSON has.
    """

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
        """Values that must be allowed if all are to be."""
        return tuple(self.choices)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What a search is asked for; names in `space` and `fixed` are those of the algorithm's
    configuration.

    Raises:
        ValueError: a field is out of its range, or a value that the configuration refuses whatever
            it is drawn with; the message names it.
    """

    task: str = "sort"
    algo: str = "ppo"
    trials: int = 20
    generation: int = 4  # trials asked for together, before any of them is told of
    steps: int = 200_000  # control periods that a trial learns from, of each seed
    evaluations: int = 5  # looks on the way, at which a trial may be pruned, of each seed
    seeds: int = 1  # of a trial, whose mean counts
    seed: int = 0  # of the sampler, and the first that trials learn with
    metric: str = "success"  # or the return
    sampler: str = "tpe"
    pruner: str = "median"
    startup_trials: int = 8  # before the sampler, and the median, have enough to go by
    space: dict[str, Span | Choices] = field(default_factory=dict)
    fixed: dict[str, Any] = field(default_factory=dict)  # what differs from the task's defaults

    def __post_init__(self) -> None:
        checks.one_of("algo", self.algo, ALGOS)
        for name, allowed in (("metric", METRICS), ("sampler", SAMPLERS), ("pruner", PRUNERS)):
            checks.one_of(name, getattr(self, name), allowed)
        for name in ("trials", "generation", "evaluations", "seeds"):
            checks.integer(name, getattr(self, name), least=1)
        for name in ("seed", "startup_trials"):
            checks.integer(name, getattr(self, name), least=0)
        least = (self.evaluations + 1) * CURVE_EVERY  # so that every look sees a row of its own
        checks.integer(f"steps, with {self.evaluations} evaluations,", self.steps, least)
        if not self.space:
            raise ValueError("space must name what to search, got nothing")
        kind = type(self.default)
        known = [each.name for each in fields(kind) if each.name not in OF_THE_SEARCH]
        for where, named in (("space", self.space), ("fixed", self.fixed)):
            for name in named:
                checks.one_of(f"a name in {where}", name, known)
        if both := sorted(self.space.keys() & self.fixed.keys()):
            raise ValueError(f"fixed must name nothing that space does, got {', '.join(both)}")
        self._check_values()

    @property
    def default(self) -> TrainConfig:
        """The configuration of the task and the algorithm as the package has it."""
        return defaults(self.task, self.algo)

    @property
    def looks(self) -> int:
        """Of a trial, if it is not pruned."""
        return self.seeds * self.evaluations

    def config(self, params: Mapping[str, Any]) -> TrainConfig:
        """The configuration that drawn values stand for, of the first seed.

        Args:
            params: value of each name in `space`, lists for tuples.

        Raises:
            ValueError: it refuses them.
        """
        chosen: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in {**self.fixed, **params}.items()
        }
        return replace(self.default, **chosen, steps=self.steps, seed=self.seed, seeds=1)

    def _check_values(self) -> None:
        """Try what is fixed, and every end of the space beside it.

        A batch goes with the rollout that it is of: where some of that is drawn, what is refused
        is seen when it is.
        """
        drawn = any(name in self.space for name in ROLLOUT)
        loose = {"batch_size": 1} if drawn else {}
        self._try("fixed", loose)
        for name, values in self.space.items():
            for value in values.ends:
                if name == "batch_size":
                    checks.integer("space: batch_size", value, least=1)
                else:
                    self._try("space", {name: value, **loose})

    def _try(self, where: str, params: Mapping[str, Any]) -> None:
        try:
            self.config(params)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{where}: {error}") from None


def read_sweep(file: Path, task: str | None = None) -> Sweep:
    """Read what a search is asked for. No code is run but that of `task`.

    Args:
        file: YAML, the fields of `Sweep`.
        task: of one's own that it is of; None: one of the package, since a file must not say what
            code is run.

    Raises:
        ValueError: there is no such file, or it holds what is not understood or not allowed.
    """
    try:
        plain = yaml.safe_load(file.read_text())
        return _sweep(plain, task)
    except (OSError, yaml.YAMLError, ValueError) as error:
        raise ValueError(f"{file} is not a search's: {' '.join(str(error).split())}") from None


def differences(sweep: Sweep, other: Sweep) -> list[str]:
    """The fields in which two searches differ, with both values."""
    return [
        f"{each.name} is {getattr(sweep, each.name)!r} there, {getattr(other, each.name)!r} here"
        for each in fields(Sweep)
        if getattr(sweep, each.name) != getattr(other, each.name)
    ]


def _sweep(plain: Any, task: str | None) -> Sweep:
    if not isinstance(plain, dict):
        raise ValueError(f"it must hold names and values, got {plain!r}")
    known = [each.name for each in fields(Sweep)]
    for name in plain:
        checks.one_of("a name", name, known)
    its = plain.get("task", Sweep.task)
    if its != task and not (task is None and its in TASKS):
        raise ValueError(
            f"task must be one of {', '.join(TASKS)}, or one's own that --task names too, "
            f"got {its!r}"
        )
    for name in ("space", "fixed"):
        if not isinstance(plain.get(name, {}), dict):
            raise ValueError(f"{name} must hold names and values, got {plain[name]!r}")
    space = {name: _values(name, values) for name, values in plain.get("space", {}).items()}
    return Sweep(**{**plain, "space": space})


def _values(name: str, values: Any) -> Span | Choices:
    asked = set(values) if isinstance(values, dict) else set()
    try:
        if asked == {"choices"}:
            return Choices(**values)
        if {"low", "high"} <= asked <= {"low", "high", "log"}:
            return Span(**values)
        raise ValueError(f"must be {{low, high, log}} or {{choices}}, got {values!r}")
    except ValueError as error:
        raise ValueError(f"space: {name}: {error}") from None
