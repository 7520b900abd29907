"""Methods that are compared on single parcels: fixed layouts, rules, the planner and agents."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from surface_gym.config import EnvConfig, Preset
from surface_gym.tasks import TASKS, Task

from .. import library
from ..base import Controller
from ..learning.config import NOMINAL
from ..learning.runs import CONFIG, read_config, task_name
from ..rules import Rule, find_apart, find_rules

FIXED = "fixed layout"
BEST_FIXED = "best fixed layout"
ANY_ANGLE = "fixed layout, any angle"
PLANNER = "planner"
SEARCH_STARTS = 40  # starts on which methods that search run
SHARED = "modules"  # the algorithm whose weights all modules share
LABELS = {"ppo": "PPO", "dqn": "DQN", SHARED: "PPO per module"}


@dataclass(frozen=True)
class Method:
    """A controller of one task, in as many seeds as it was trained in."""

    name: str
    task: str
    actions: str  # kind of action
    control_period: float  # [s]
    make: Callable[[EnvConfig, int], Controller]  # for an environment and a seed
    seeds: tuple[int, ...] = (0,)
    starts: int | None = None  # about how many it runs on, one at a time; None: all at once
    presets: tuple[str, ...] | None = None  # names; None: all
    observed_task: Callable[[Task], Task] | None = None  # that shows it more; None: the benchmark's
    orientations: str | None = None  # "any": axes at any angle; None: those of the line
    observe: tuple[str, ...] = ()  # groups of features it sees beside the task's

    def config(self, task: Task, preset: Preset) -> EnvConfig:
        return EnvConfig(
            task=task if self.observed_task is None else self.observed_task(task),
            actions=self.actions,
            control_period=self.control_period,
            orientations=self.orientations,
            observe=self.observe,
            preset=preset,
        )

    def under(self, *presets: str) -> "Method":
        return replace(self, presets=presets)


def all_methods(task: str) -> list[Method]:
    """List every method of a task, those that know most last."""
    planned = [planner(task)] if library.task_kind(task) in TASKS else []
    return [*rules(task), *shipped(task), *planned]


def rules(task: str) -> list[Method]:
    """List methods that neither learn nor plan; the fixed layout first, then the best of such."""
    kind = library.task_kind(task)
    more = [r for r in find_apart() if r.task == (kind if r.observed_task is None else task)]
    order = {FIXED: 0, BEST_FIXED: 1, ANY_ANGLE: 2}
    found = [_of_rule(rule, task) for rule in (*find_rules(kind), *more)]
    return sorted(found, key=lambda method: order.get(method.name, len(order)))


def planner(task: str) -> Method:
    """Make the planner: the near-optimum, slow, so on fewer starts and by exact sensors only."""
    return Method(PLANNER, task, "halves", 0.04, _planned, starts=SEARCH_STARTS, presets=("exact",))


def shipped(task: str) -> list[Method]:
    """List the package's agents of a task, such as "slow-ppo"; "slow-ppo-lab" is for a preset."""
    found = []
    for name in library.names():
        of_task, algo, *preset = name.split("-")
        if of_task == task:
            agent = trained(policy_folders(library.SHELF / name))
            found.append(replace(agent, name=", ".join((LABELS[algo], *preset))))
    labels = list(LABELS.values())

    def place(method: Method) -> tuple[int, int]:
        algo, *preset = method.name.split(", ")
        return len(preset), labels.index(algo)

    return sorted(found, key=place)


def of_runs(task: str, folder: Path) -> list[Method]:
    """Find the policies of a task that runs left below `folder`, the latest of each kind."""
    latest: dict[str, Method] = {}
    for config in sorted(folder.glob(f"*/{CONFIG}"), key=lambda file: file.stat().st_mtime):
        run = config.parent
        whole = all((each / library.CARD).is_file() for each in policy_folders(run).values())
        if task_name(config) == task and whole:
            found = of_run(run, task)
            latest[found.name] = found
    return list(latest.values())


def of_run(run: Path, task: str | None = None) -> Method:
    """Find the policies that a run left, named by the preset they were trained for."""
    agent = trained(policy_folders(run), task)
    config = run / CONFIG
    preset = read_config(config, task_name(config)).preset if config.is_file() else NOMINAL
    return agent if preset == NOMINAL else replace(agent, name=f"{agent.name}, {preset}")


def policy_folders(run: Path) -> dict[int, Path]:
    """Find the folders of a run's policies by seed; a single policy is in the run's own."""
    named = {each: each.name.removeprefix("seed-") for each in run.glob("seed-*")}
    found = {int(seed): each for each, seed in named.items() if re.fullmatch("[0-9]{1,18}", seed)}
    return dict(sorted(found.items())) or {0: run}


def trained(folders: dict[int, Path], task: str | None = None) -> Method:
    """Read the policies that a run left, a folder for each seed."""
    files = {seed: library.read_files(folder) for seed, folder in folders.items()}
    card = library.from_files(next(iter(files.values())), _own(task)).card
    label = library.ALGORITHMS.find(card.algo).label
    return Method(
        label, task or card.task, card.actions, card.control_period,
        partial(_read, files, task), tuple(folders), observe=card.observe,
    )  # fmt: skip


def rivals(methods: Iterable[Method]) -> list[Method]:
    """Pick the fixed layout, and of one task's other methods PPO, or else the last."""
    several = list(methods)
    fixed = [method for method in several if method.name == FIXED]
    others = [method for method in several if method.name not in (FIXED, PLANNER)]
    learned = [method for method in others if method.name == "PPO"]
    return [*fixed, *(learned or others[-1:])][:2]


def _of_rule(rule: Rule, task: str) -> Method:
    return Method(
        rule.name, task, rule.actions, 0.04, partial(_ruled, rule.make),
        starts=SEARCH_STARTS if rule.searches else None, observed_task=rule.observed_task,
        orientations=rule.orientations, observe=rule.observe,
    )  # fmt: skip


def _ruled(make: Callable[[EnvConfig], Controller], config: EnvConfig, _seed: int) -> Controller:
    return make(config)


def _planned(config: EnvConfig, _seed: int) -> Controller:
    from ..planning.planner import Planner

    return Planner(config)


def _read(
    files: dict[int, library.PolicyFiles], task: str | None, config: EnvConfig, seed: int
) -> Controller:
    """Build the policy of a seed; fit one whose weights all modules share to the zone."""
    policy: Any = library.from_files(files[seed], _own(task))
    columns = config.action_kind.columns
    if policy.card.algo == SHARED and columns != policy.card.env_config().action_kind.columns:
        policy = policy.for_zone((0, columns - 1))
    return policy


def _own(task: str | None) -> Task | None:
    return None if task is None or task in TASKS else library.find_task(task)
