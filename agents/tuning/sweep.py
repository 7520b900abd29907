"""The request of a search, as its YAML file has it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from optuna import distributions as ranges

from surface_gym import checks
from surface_gym.files import DAMAGE, describe_damage
from surface_gym.registration import DEFAULT_TASK, TASKS

from ..learning.config import ParcelConfig, defaults
from ..learning.runs import CURVE_EVERY
from ..library import ALGORITHMS
from ..yaml_file import RENAMED, read_yaml

METRICS = ("success", "return")
SAMPLERS = ("tpe", "random")
PRUNERS = ("median", "halving", "none")
OF_THE_SEARCH = ("task", "algo", "device", "seed", "seeds", "steps", "out", "name")
ROLLOUT = ("num_envs", "n_steps", "batch_size")  # which must go together


@dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """Configuration of a search; `space` and `fixed` name fields of the algorithm."""

    task: str = DEFAULT_TASK
    algo: str = "ppo"
    trials: int = 20
    steps: int = 200_000  # control periods per trial and seed
    evaluations: int = 5  # evaluations per trial and seed, at which it may be pruned
    seeds: int = 1  # seeds per trial; the mean counts
    seed: int = 0  # seed of the sampler, and first seed of trials
    metric: str = "success"  # or the return
    sampler: str = "tpe"
    pruner: str = "median"
    startup_trials: int = 8  # before the sampler and the median pruner start
    space: dict[str, ranges.BaseDistribution] = field(default_factory=dict)
    # values that differ from the task's defaults
    fixed: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        of_one = [
            name for name, each in ALGORITHMS.items() if issubclass(each.config, ParcelConfig)
        ]
        checks.one_of("algo", self.algo, of_one)
        for name, allowed in (("metric", METRICS), ("sampler", SAMPLERS), ("pruner", PRUNERS)):
            checks.one_of(name, getattr(self, name), allowed)
        for name in ("trials", "evaluations", "seeds"):
            checks.integer(name, getattr(self, name), least=1)
        for name in ("seed", "startup_trials"):
            checks.integer(name, getattr(self, name), least=0)
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
            for value in _extremes(values):
                if name == "batch_size":
                    checks.integer("space: batch_size", value, least=1)
                else:
                    self._try("space", {name: value, **any_batch})

    @cached_property
    def default(self) -> ParcelConfig:
        """The package's configuration of the task and the algorithm."""
        found = defaults(self.task, self.algo)
        assert isinstance(found, ParcelConfig)
        return found

    @property
    def max_reports(self) -> int:
        """Number of evaluations during a trial that is not pruned."""
        return self.seeds * self.evaluations

    def config(self, params: Mapping[str, Any]) -> ParcelConfig:
        """Return the configuration of drawn values, with the first seed."""
        chosen: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in {**self.fixed, **params}.items()
        }
        return replace(self.default, **chosen, steps=self.steps, seed=self.seed, seeds=1)

    def plain_params(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values that Optuna drew in the form of a configuration."""
        return {
            name: json.loads(drawn[name])
            if isinstance(values, ranges.CategoricalDistribution)
            else drawn[name]
            for name, values in sorted(self.space.items())
        }

    def _try(self, where: str, params: Mapping[str, Any]) -> None:
        try:
            self.config(params)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{where}: {error}") from None


def read_sweep(file: Path, task: str | None = None) -> SearchConfig:
    """Read the configuration of a search. Only the code of `task` is executed."""
    try:
        return _read(read_yaml(file, by_hand=True), task)
    except DAMAGE as error:
        raise ValueError(f"{file} is not a search's: {describe_damage(error)}") from None


def differences(sweep: SearchConfig, other: SearchConfig) -> list[str]:
    """List the fields in which two searches differ, with both values."""
    return [
        f"{each.name} is {getattr(sweep, each.name)!r} there, {getattr(other, each.name)!r} here"
        for each in fields(SearchConfig)
        if getattr(sweep, each.name) != getattr(other, each.name)
    ]


def _read(plain: dict[str, Any], task: str | None) -> SearchConfig:
    known = [each.name for each in fields(SearchConfig)]
    for name in plain:
        checks.one_of("a name", name, known)
    named = plain.get("task", SearchConfig.task)
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
    space = {name: _distribution(name, values) for name, values in space.items()}
    return SearchConfig(**{**plain, "space": space, "fixed": fixed})


def make_choices(choices: Sequence[Any]) -> ranges.CategoricalDistribution:
    """Make a distribution of any plain values, kept as text, since Optuna takes no lists."""
    try:
        texts = [json.dumps(each) for each in choices] if isinstance(choices, list) else []
    except TypeError:
        texts = []
    if len(set(texts)) < max(2, len(texts)):
        raise ValueError(
            f"choices must be a list of two or more different plain values, got {choices!r}"
        )
    return ranges.CategoricalDistribution(texts)


def _extremes(values: ranges.BaseDistribution) -> list[Any]:
    if isinstance(values, ranges.IntDistribution | ranges.FloatDistribution):
        return [values.low, values.high]
    assert isinstance(values, ranges.CategoricalDistribution)
    return [json.loads(str(each)) for each in values.choices]


def _distribution(name: str, values: Any) -> ranges.BaseDistribution:
    """Make the distribution of a name in `space`."""
    given = set(values) if isinstance(values, dict) else set()
    try:
        if given == {"choices"}:
            return make_choices(**values)
        if {"low", "high"} <= given <= {"low", "high", "log"}:
            for end in ("low", "high"):
                checks.number(end, values[end])
            checks.one_of("log", values.get("log", False), (True, False))
            whole = isinstance(values["low"], int) and isinstance(values["high"], int)
            return ranges.IntDistribution(**values) if whole else ranges.FloatDistribution(**values)
        raise ValueError(f"must be {{low, high, log}} or {{choices}}, got {values!r}")
    except ValueError as error:
        raise ValueError(f"space: {name}: {error}") from None
