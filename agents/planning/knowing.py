"""What can be reached: a planner that knows the truth, start by start."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.settings import Settings
from surface_gym.sharing import Workers, check_workers, quiet, share
from surface_gym.state import OUT_OF_TIME, RUNNING

from ..episodes import Episodes, side_by_side
from .aims import AIMS, Aim
from .known import KnownModel
from .search import lanes_needed, make_plan

Numbers = NDArray[np.float64]

BUDGET = 256  # lanes followed at a time at most
LEAST = 8  # lanes followed at first: most starts need no more
MORE = 4  # times as many, where those have found no success
AT_ONCE = 5  # starts that a process is handed at a time


@dataclass(frozen=True, eq=False)
class Reached:
    """One start, as it goes by the best plan found."""

    outcome: str  # why it ended
    time: float  # [s] until then
    figures: tuple[float, ...]  # the task's own
    poses: Numbers  # (periods + 1, 3) [m, m, rad] true
    velocity: Numbers  # (3,) [m/s, m/s, rad/s] at the end
    actions: tuple[int, ...]  # (periods,) given
    width: int  # lanes that were followed at a time
    seconds: float  # that the search took

    @property
    def success(self) -> bool:
        """Whether the goal was reached."""
        return self.outcome == "success"


class Knowing:
    """Searches for the actions of a front and a rear half that end a start best, on lanes that know
    all of it: parcel, load, friction, stuck modules, axes.

    It needs no sensors: what comes of the plan is the result. A search that finds no success is
    made again with more lanes, as long as the budget allows.

    Args:
        settings: of the environment, with "halves" for actions, of orientations to choose from.
        budget: lanes followed at a time at most, each with every action.

    Raises:
        ValueError: other actions, any angle, or a budget below 1.
    """

    def __init__(self, settings: Settings, budget: int = BUDGET) -> None:
        checks.one_of("actions", settings.actions, ("halves",))
        if settings.action_kind.continuous:
            raise ValueError(
                f"orientations must be some to choose from, got {settings.orientations!r}"
            )
        self._settings = settings
        # What is ahead is known: a path, too, is searched to its end at once. Light parcels leave a
        # path too easily for that; then it is searched piece by piece.
        task, aim = settings.chosen_task, AIMS[settings.task_name]
        whole = replace(aim, horizon=task.periods, follow=task.periods)
        self._aims = (whole, aim) if task.has_path else (whole,)
        self._budget = checks.integer("budget", budget, least=1)
        self._models: dict[int, KnownModel] = {}

    def find(self, options: dict[str, Any], seed: int) -> Reached:
        """The best episode found for a start, that of `reset` with these arguments.

        Args:
            options: of the start; what they leave open is drawn.
            seed: of the draws.
        """
        began = time.perf_counter()
        for aim, width in product(self._aims, self._widths):
            found = self._play(aim, width, options, seed)
            if found.success:
                break
        return replace(found, seconds=time.perf_counter() - began)

    @property
    def _widths(self) -> list[int]:
        """Lanes followed at a time, in one search after another."""
        widths = [min(LEAST, self._budget)]
        while widths[-1] < self._budget:
            widths.append(min(MORE * widths[-1], self._budget))
        return widths

    def _play(self, aim: Aim, width: int, options: dict[str, Any], seed: int) -> Reached:
        """An episode by plans that follow so many lanes."""
        model = self._model(aim, width)
        model.begin(options, seed)
        poses, actions = [model.parcels.truth[0, :3].copy()], list[int]()
        running, left = True, self._settings.chosen_task.periods
        while running and len(actions) < left:
            plan = make_plan(model, aim, width)
            for action in plan.actions[: aim.follow].tolist():
                lanes = model.go_on(action).lanes
                poses.append(lanes.truth[0, :3].copy())
                actions.append(action)
                running = bool(lanes.outcome[0] == RUNNING)
                if not running or len(actions) == left:
                    break
        lanes = model.parcels
        outcome = OUT_OF_TIME if running else int(lanes.outcome[0])
        return Reached(
            outcome=model.outcomes[outcome],
            time=float(lanes.clock[0]),
            figures=tuple(lanes.metrics[0].tolist()),
            poses=np.array(poses),
            velocity=lanes.truth[0, 3:].copy(),
            actions=tuple(actions),
            width=width,
            seconds=0.0,
        )

    def _model(self, aim: Aim, width: int) -> KnownModel:
        choices = self._settings.action_kind.choices**2
        lanes = lanes_needed(aim, width, choices)
        if lanes not in self._models:
            self._models[lanes] = KnownModel(self._settings, lanes)
        return self._models[lanes]


def reachable(
    settings: Settings,
    starts: Sequence[dict[str, Any]],
    seed: int,
    budget: int = BUDGET,
    workers: Workers = 1,
) -> list[Reached]:
    """What can be reached from starts, with halves for actions, by who knows all of them.

    Args:
        settings: of the environment; its time limit is the task's own.
        starts: options of each start; what they leave open is drawn.
        seed: start i draws from `seed` + i, as in `agents.episodes.run_episodes`.
        budget: lanes followed at a time at most.
        workers: processes to share the starts among, or a cluster; results do not depend on it.

    Raises:
        ValueError: settings, a start or a number that is not allowed.
    """
    Knowing(settings, budget)
    check_workers(workers)
    firsts = range(0, len(starts), AT_ONCE)
    jobs = [
        partial(quiet, partial(_find, settings, starts[k : k + AT_ONCE], seed + k, budget))
        for k in firsts
    ]
    found = dict(share(jobs, workers))
    return [reached for k in range(len(jobs)) for reached in found[k]]


def play_knowing(
    settings: Settings,
    starts: Sequence[dict[str, Any]],
    seed: int,
    budget: int = BUDGET,
    workers: Workers = 1,
) -> Episodes:
    """`reachable`, as `agents.episodes.run_episodes` would have it of a controller."""
    runs = reachable(settings, starts, seed, budget, workers)
    names = settings.chosen_task.metrics
    figures = np.array([run.figures for run in runs]).T
    return Episodes(
        success=np.array([run.success for run in runs]),
        outcome=tuple(run.outcome for run in runs),
        time=np.array([run.time for run in runs]),
        figures=dict(zip(names, figures, strict=True)),
        pose=side_by_side([run.poses for run in runs]),
        velocity=np.array([run.velocity for run in runs]),
        decision_times=np.array([run.seconds / len(run.actions) for run in runs]),
    )


def _find(
    settings: Settings, starts: Sequence[dict[str, Any]], seed: int, budget: int
) -> list[Reached]:
    knowing = Knowing(settings, budget)
    return [knowing.find(start, seed + k) for k, start in enumerate(starts)]
