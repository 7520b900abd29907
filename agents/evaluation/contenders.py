"""Who is compared: fixed layouts, rules, the planner and the agents that come with the package."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from surface_gym.conditions import Condition
from surface_gym.core.actions import ANY
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS, Task, Track

from .. import library
from ..controller import Controller
from ..learning.config import NOMINAL
from ..learning.folder import CONFIG
from ..learning.hyperparams import read_config, task_of
from ..planning.shown_path import with_path_shown
from ..policy_card import CARD
from ..policy_files import PolicyFiles, read_files
from ..rules import rules_of
from ..rules.best_layout import BestTracking
from ..rules.graded import GradedLayout
from ..tasks import find_task, kind_of
from .trials import Trial

FIXED = "fixed layout"
BEST_FIXED = "best fixed layout"
ANY_ANGLE = "fixed layout, any angle"
PLANNER = "planner"
PLANNED = 40  # starts that who searches is tried on
SEARCHED = ("slow", "stop", "orient")  # tasks with a rule that searches a layout for each start
MODULES = "modules"
LABELS = {"ppo": "PPO", "dqn": "DQN", MODULES: "PPO per module"}


@dataclass(frozen=True)
class Contender:
    """A controller of one task, in as many seeds as it was trained in."""

    name: str
    task: str
    actions: str  # kind of action
    control_period: float  # [s]
    make: Callable[[Settings, int], Controller]  # for settings and a seed
    seeds: tuple[int, ...] = (0,)
    starts: int | None = None  # about how many it is tried on, one at a time; None: all at once
    conditions: tuple[str, ...] | None = None  # names; None: all
    shown: Callable[[Task], Task] | None = None  # the task that shows it more; None: the trial's
    orientations: str | None = None  # "any": axes at any angle; None: the plant's
    observe: tuple[str, ...] = ()  # groups of features it sees beside the task's

    def settings(self, trial: Trial, condition: Condition) -> Settings:
        """Those of the environment it acts in."""
        return Settings(
            task=trial.task if self.shown is None else self.shown(trial.task),
            actions=self.actions,
            control_period=self.control_period,
            orientations=self.orientations,
            observe=self.observe,
            condition=condition,
        )


def rules(task: str) -> list[Contender]:
    """Those that do not learn and do not plan; the fixed layout first, then the best of such."""
    kind = kind_of(task)
    found = [
        Contender(
            rule.name, task, rule.actions, 0.04, partial(_ruled, rule.make),
            starts=PLANNED if rule.name == BEST_FIXED and kind in SEARCHED else None,
            observe=rule.observe,
        )
        for rule in rules_of(kind)
    ]  # fmt: skip
    if task == "track":
        found.append(best_on_path())
    if kind == "sort":
        found.append(at_any_angle(task))
    order = {FIXED: 0, BEST_FIXED: 1, ANY_ANGLE: 2}
    return sorted(found, key=lambda contender: order.get(contender.name, len(order)))


def best_on_path() -> Contender:
    """The best fixed layout of Track, which is shown the whole path."""
    return Contender(
        BEST_FIXED, "track", "modules", 0.04, partial(_ruled, BestTracking), starts=PLANNED,
        shown=_with_path,
    )  # fmt: skip


def at_any_angle(task: str) -> Contender:
    """Sort's best layout where axes may stand at any angle, which all others may not."""
    return Contender(
        ANY_ANGLE, task, "modules", 0.04, partial(_ruled, GradedLayout), orientations=ANY
    )


def planner(task: str) -> Contender:
    """The near-optimum, on fewer starts and with exact sensors only: it is slow."""
    return Contender(PLANNER, task, "halves", 0.04, _planned, starts=PLANNED, conditions=("exact",))


def of_runs(task: str, folder: Path) -> list[Contender]:
    """The policies of a task that runs have left in folders of `folder`, the latest of each kind.

    Raises:
        ValueError: a run's policies are damaged.
    """
    latest: dict[str, Contender] = {}
    for config in sorted(folder.glob(f"*/{CONFIG}"), key=lambda file: file.stat().st_mtime):
        run = config.parent
        if task_of(config) == task and _is_whole(run):
            found = of_run(run, task)
            latest[found.name] = found
    return list(latest.values())


def of_run(run: Path, task: str | None = None) -> Contender:
    """The policies that a run left, named by what its configuration says they are to be ready for.

    Args:
        run: its folder.
        task: of one's own that they were trained on; None: one of the package.

    Raises:
        ValueError: a folder holds no policy, or a damaged one, or one of another task.
    """
    agent = trained(policies_of(run), task)
    config = run / CONFIG
    condition = read_config(config, task_of(config)).condition if config.is_file() else NOMINAL
    what_for = "" if condition == NOMINAL else f", {condition}"
    return replace(agent, name=agent.name + what_for)


def _is_whole(run: Path) -> bool:
    """Whether every seed of a run has left a policy."""
    return all((folder / CARD).is_file() for folder in policies_of(run).values())


def policies_of(run: Path) -> dict[int, Path]:
    """Folders of a run's policies by seed; that of a single one is the run's own."""
    found = {int(each.name.removeprefix("seed-")): each for each in run.glob("seed-*")}
    return dict(sorted(found.items())) or {0: run}


def shipped(task: str) -> list[Contender]:
    """The agents that come with the package, by names on the shelf as "slow-ppo"; one trained for a
    condition, as "slow-ppo-lab", is called by it too.
    """
    found = []
    for name in library.names():
        of_task, algo, *what_for = name.split("-")
        if of_task == task:
            card = library.load(name).card
            found.append(
                Contender(
                    ", ".join((LABELS[algo], *what_for)), task, card.actions, card.control_period,
                    partial(_loaded, name), library.seeds(name), observe=card.observe,
                )
            )  # fmt: skip
    order = {label: place for place, label in enumerate(LABELS.values())}
    return sorted(found, key=lambda each: _place(each.name, order))


def _place(label: str, order: dict[str, int]) -> tuple[int, int]:
    """Agents of all conditions in the order of their algorithms, those for one of them last."""
    algo, *what_for = label.split(", ")
    return len(what_for), order[algo]


def trained(folders: dict[int, Path], task: str | None = None) -> Contender:
    """The policies that a run left, a folder a seed.

    Args:
        folders: by seed.
        task: of one's own that they were trained on; None: one of the package.

    Raises:
        ValueError: a folder holds no policy, or a damaged one, or one of another task.
    """
    files = {seed: read_files(folder) for seed, folder in folders.items()}
    card = library.carried(next(iter(files.values())), _own(task)).card
    return Contender(
        LABELS[card.algo], task or card.task, card.actions, card.control_period,
        partial(_read, files, task), tuple(folders), observe=card.observe,
    )  # fmt: skip


def contenders(task: str) -> list[Contender]:
    """All of a task, those that know most last."""
    planned = [planner(task)] if kind_of(task) in TASKS else []
    return [*rules(task), *shipped(task), *planned]


def only(contender: Contender, conditions: tuple[str, ...]) -> Contender:
    """The same, under some conditions only."""
    return replace(contender, conditions=conditions)


def _ruled(make: Callable[[Settings], Controller], settings: Settings, seed: int) -> Controller:
    del seed  # a rule has none
    return make(settings)


def _with_path(task: Task) -> Task:
    assert isinstance(task, Track)
    return with_path_shown(task)


def _planned(settings: Settings, seed: int) -> Controller:
    from ..planner import Planner

    del seed
    return Planner(settings)


def _loaded(name: str, settings: Settings, seed: int) -> Controller:
    return _on_zone(library.load(name, seed), settings)


def _read(
    files: dict[int, PolicyFiles], task: str | None, settings: Settings, seed: int
) -> Controller:
    return _on_zone(library.carried(files[seed], _own(task)), settings)


def _on_zone(policy: Any, settings: Settings) -> Controller:
    """A policy as it is; weights that all modules share, for a zone of whatever columns."""
    found: Controller = policy
    columns = settings.action_kind.columns
    if policy.card.algo == MODULES and columns != policy.card.settings().action_kind.columns:
        found = policy.on((0, columns - 1))
    return found


def _own(task: str | None) -> Task | None:
    return None if task is None or task in TASKS else find_task(task)
