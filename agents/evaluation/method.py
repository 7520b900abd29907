"""Compared methods: fixed layouts, rules, planners and agents of any task."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym.config import EnvConfig, Preset
from surface_gym.files import DAMAGE, describe_damage
from surface_gym.machine.estimate import Estimate
from surface_gym.registration import TASKS
from surface_gym.registry import Registry
from surface_gym.tasks import Task
from surface_gym.tasks.benchmark import Benchmark, StreamBenchmark

from .. import library
from ..base import BatchController, Controller, find_axes
from ..learning.config import NOMINAL
from ..learning.runs import CONFIG, ESTIMATE, algorithm_name, preset_name, task_name
from ..planning.belief import BeliefPlanner
from ..planning.planner import Planner, RecedingHorizon
from ..rules import RULES, Rule, find_apart, find_rules

FIXED = "fixed layout"
IDENTIFIED = "identified"  # ends the names of agents trained on an identified surface
BEST_FIXED = "best fixed layout"
ANY_ANGLE = "fixed layout, any angle"
ROLL_ON = "roll on"
BELIEF = "belief planner"
BASELINE, RULE, AGENT, PLANNER = "baseline", "rule", "agent", "planner"  # kinds of methods
PERIOD = 0.04  # [s] default time between decisions
SEARCH_STARTS = 40  # number of starts for methods that search
PLANNED = 3  # number of streams for planners
AT_ONCE = {"time slots": 8}  # rules that are compared with so few parcels on the surface, too


@dataclass(frozen=True)
class Method:
    """A controller of one task, with one or several seeds."""

    name: str
    task: str
    # called with a configuration and a seed, on streams also with the allowed touches per delivery
    # in a trial; returns None if it cannot sort the parcels
    make: Callable[..., Controller | None]
    arguments: dict[str, Any] = field(default_factory=dict)  # arguments of its environment
    kind: str = RULE
    seeds: tuple[int, ...] = (0,)
    # maximum number of episodes, run one after the other; None: all at once
    most: int | None = None
    presets: tuple[str, ...] | None = None  # names of presets; None: all
    # task with a richer observation; None: the benchmark's
    observed_task: Callable[[Task], Task] | None = None
    estimate: Estimate | None = None  # of the surface; None: the task's own surface

    @property
    def control_period(self) -> float:
        """[s] time between decisions."""
        return float(self.arguments.get("control_period", PERIOD))

    def config(self, task: Task, preset: Preset) -> EnvConfig:
        """Return the configuration of an environment with one parcel, under a preset."""
        shown = task if self.observed_task is None else self.observed_task(task)
        config = EnvConfig(task=shown, preset=preset, **self.arguments)
        return config if self.estimate is None else self.estimate.adapt(config)

    def controller(self, config: EnvConfig, seed: int, most_touches: float = 0.0) -> Any:
        """Make a controller for an environment. Return None if the method cannot sort the parcels.

        A scheduler is tuned in trials. `most_touches` limits the touches per delivery in a trial.
        """
        if most_touches:
            return self.make(config, seed, most_touches)
        return self.make(config, seed)

    def under(self, *presets: str) -> "Method":
        return replace(self, presets=presets)


# Functions that list the methods of tasks with more than rules and agents.
METHODS: Registry[Callable[[], list[Method]]] = Registry("task", f"{__package__}.streams")


@lru_cache(maxsize=32)
def find_benchmark(task: str) -> Benchmark | StreamBenchmark:
    """Return the benchmark of a task. `task` names a task of the package, or a custom task."""
    found: Any = TASKS[task]() if task in TASKS else library.find_task(task)
    return found.benchmark()


def start_benchmark(task: str) -> Benchmark:
    """Return the benchmark of a task of one parcel; raise a ValueError for other tasks."""
    if isinstance(found := find_benchmark(task), Benchmark):
        return found
    raise ValueError(f"task must be one of a single parcel, got {task!r}")


def stream_benchmark(task: str) -> StreamBenchmark:
    """Return the benchmark of a task on streams; raise a ValueError for other tasks."""
    if isinstance(found := find_benchmark(task), StreamBenchmark):
        return found
    raise ValueError(f"task must be one on streams of parcels, got {task!r}")


def is_on_streams(task: str) -> bool:
    """Return whether a task is on streams of parcels."""
    return isinstance(find_benchmark(task), StreamBenchmark)


def all_methods(task: str) -> list[Method]:
    """List all methods of a task. The default order is rules, shipped agents, planners."""
    if task in METHODS:
        return METHODS[task]()
    return [*rules(task), *shipped(task), *planner(task)]


def rules(task: str) -> list[Method]:
    """List a task's methods that neither learn nor plan, fixed layouts first."""
    kind = library.task_kind(task)
    if is_on_streams(task):
        own = [_of_rule(each, task) for each in RULES.values() if each.task == kind]
        fewer = [
            replace(
                each, name=f"{each.name}, {AT_ONCE[each.name]} at once",
                arguments=each.arguments | {"max_parcels": AT_ONCE[each.name]},
            )
            for each in own
            if each.name in AT_ONCE
        ]  # fmt: skip
        roll_on = Method(ROLL_ON, task, RollOn, {"actions": "parcels"}, BASELINE)
        return [roll_on, *sorted([*own, *fewer], key=lambda each: each.name)]
    more = [r for r in find_apart() if r.task == (kind if r.observed_task is None else task)]
    order = {FIXED: 0, BEST_FIXED: 1, ANY_ANGLE: 2}
    found = [_of_rule(rule, task) for rule in (*find_rules(kind), *more)]
    return sorted(found, key=lambda method: order.get(method.name, len(order)))


def planner(task: str) -> list[Method]:
    """List a task's planners. Planners are slow, so they get fewer episodes than other methods.

    A task with one parcel has two planners if the task or its base class is registered. The belief
    planner runs in the lab, and the near-optimal planner with exact sensors. On streams, a planner
    simulates variations of a rule's actions. This rule is the last rule in `rules` that sets no
    arguments besides `actions`. A task on streams without rules has no planner.
    """
    planned = Method(
        PLANNER,
        task,
        partial(seedless, Planner),
        {"actions": "halves"},
        PLANNER,
        most=SEARCH_STARTS,
    )
    if not is_on_streams(task):
        known = library.task_kind(task) in TASKS
        belief = replace(
            planned, name=BELIEF, make=partial(seedless, BeliefPlanner), kind=RULE,
            arguments={"actions": "halves", "observe": ("parcel", "load")}, presets=("lab",),
        )  # fmt: skip
        return [belief, planned.under("exact")] if known else []
    varied = [each for each in rules(task) if each.kind == RULE and len(each.arguments) == 1]
    return [
        replace(
            planned, make=partial(_vary, each.make), arguments=each.arguments, most=PLANNED,
            presets=("exact", "lab"),
        )
        for each in varied[-1:]
    ]  # fmt: skip


def shipped(task: str) -> list[Method]:
    """List a task's shipped agents. "PPO, lab" names an agent that PPO trained in the lab."""
    found, algorithms = [], list(library.ALGORITHMS)
    for name in library.names():
        of_task, algo, *preset = name.split("-")
        if of_task == task:
            agent = trained(policy_folders(library.SHELF / name))
            name = ", ".join((library.ALGORITHMS.find(algo).label, *preset))
            found.append((len(preset), algorithms.index(algo), replace(agent, name=name)))
    return [method for *_, method in sorted(found, key=itemgetter(0, 1))]


def of_runs(task: str, folder: Path) -> list[Method]:
    """Return a task's complete runs in `folder` as methods. Skip older runs of the same name.

    Skip the runs of `unloaded_runs`, too.
    """
    latest: dict[str, Method] = {}
    for run in _complete_runs(task, folder):
        if _unloaded(run) is None:
            found = of_run(run, task)
            latest[found.name] = found
    return list(latest.values())


def unloaded_runs(task: str, folder: Path) -> dict[Path, str]:
    """Return a task's complete runs whose algorithm is not loaded, with the algorithm's name.

    Such an algorithm is in a user's file. A run must not select code to execute, so the user names
    the algorithm as path/to/file.py:NAME.
    """
    algos = {run: _unloaded(run) for run in _complete_runs(task, folder)}
    return {run: algo for run, algo in algos.items() if algo is not None}


def _unloaded(run: Path) -> str | None:
    """Return the name of a run's algorithm if it is not loaded, else None."""
    algo = algorithm_name(run / CONFIG)
    return None if algo is None or library.card_algo(algo) in library.ALGORITHMS else algo


def _complete_runs(task: str, folder: Path) -> list[Path]:
    """List a task's runs in which each seed has a policy, the oldest first."""
    files = sorted(folder.glob(f"*/{CONFIG}"), key=lambda file: file.stat().st_mtime)
    return [
        file.parent
        for file in files
        if task_name(file) == task
        and all((each / library.CARD).is_file() for each in policy_folders(file.parent).values())
    ]


def of_run(run: Path, task: str | None = None) -> Method:
    """Return the trained policies of a run as a method. `task` is as for `trained`.

    The method's name ends with the preset of the training, unless the preset is "nominal". If the
    run was trained on an identified surface, the name ends with `IDENTIFIED` instead.
    """
    agent = trained(policy_folders(run), task)
    preset = IDENTIFIED if (run / ESTIMATE).is_file() else preset_name(run / CONFIG) or NOMINAL
    return agent if preset == NOMINAL else replace(agent, name=f"{agent.name}, {preset}")


def policy_folders(run: Path) -> dict[int, Path]:
    """Return the folder of each seed's policy. If there are no such folders, return {0: run}."""
    named = {each: each.name.removeprefix("seed-") for each in run.glob("seed-*")}
    found = {int(seed): each for each, seed in named.items() if re.fullmatch("[0-9]{1,18}", seed)}
    return dict(sorted(found.items())) or {0: run}


def trained(folders: dict[int, Path], task: str | None = None) -> Method:
    """Make one method of the policies in several folders. A key of `folders` is a seed.

    If the policies were trained on your own task, `task` is path/to/file.py:Class.
    """
    files = {seed: library.read_files(folder) for seed, folder in folders.items()}
    first = next(iter(files.values()))
    try:
        card = library.read_card(first)
    except DAMAGE as error:
        raise ValueError(
            f"{first.folder} holds a damaged or foreign policy: {describe_damage(error)}"
        ) from None
    return Method(
        library.ALGORITHMS.find(card.algo).label, task or card.task, partial(_read, files, task),
        dict(card.env_kwargs), AGENT, tuple(folders),
    )  # fmt: skip


def rivals(methods: Iterable[Method]) -> list[Method]:
    """Select a baseline and PPO for a task's pictures. Without PPO, select the last method.

    The baseline is the fixed layout. In a task on streams, the baseline is the last method that
    did not learn.
    """
    several = [each for each in methods if each.kind != PLANNER and each.name != BELIEF]
    first = [each for each in several if each.name == FIXED]
    if several and is_on_streams(several[0].task):
        first = [each for each in several if each.kind != AGENT][-1:]
    others = [each for each in several if each not in first]
    learned = [each for each in others if each.name == "PPO"]
    return [*first, *(learned or others[-1:])][:2]


class RollOn(BatchController):
    """Controller that lets every parcel of a stream roll on."""

    _shape = (None, None)

    def __init__(self, config: EnvConfig, _seed: int = 0) -> None:
        self._size = config.action_kind.size
        self._choice = find_axes(config).roll

    def _predict(self, batch: Any, *_: Any, **__: bool) -> tuple[Any, None]:
        return np.full((len(batch), self._size), self._choice), None


def _of_rule(rule: Rule, task: str) -> Method:
    given: dict[str, Any] = {"actions": rule.actions}
    if rule.orientations is not None:
        given["orientations"] = rule.orientations
    if rule.observe:
        given["observe"] = rule.observe
    return Method(
        rule.name, task, partial(seedless, rule.make), given,
        BASELINE if rule.name == FIXED else RULE, most=SEARCH_STARTS if rule.searches else None,
        observed_task=rule.observed_task,
    )  # fmt: skip


def seedless(
    make: Callable[[EnvConfig], Controller | None], config: EnvConfig, _seed: int
) -> Controller | None:
    """Call `make` without the seed, so that `partial(seedless, make)` can be a `Method.make`."""
    return make(config)


def _vary(make: Callable[..., Any], config: EnvConfig, seed: int) -> Controller:
    return RecedingHorizon(make(config, seed), config)


def _read(
    files: dict[int, library.PolicyFiles], task: str | None, config: EnvConfig, seed: int,
    most_touches: float = 0.0,
) -> Controller:  # fmt: skip
    """Build the policy of a seed from the policy's files; see `library.from_files`.

    A policy shared by all modules is adapted to the zone of `config`.
    """
    own = None if task is None or task in TASKS else library.find_task(task)
    shown = config if config.task.is_stream else None
    policy: Any = library.from_files(files[seed], own, shown, most_touches)
    if hasattr(policy, "for_zone"):
        columns = config.action_kind.columns
        if columns != policy.card.env_config().action_kind.columns:
            policy = policy.for_zone((0, columns - 1))
    return policy
