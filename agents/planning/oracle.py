"""The oracle: a planner that knows the true state and parameters.

Its results are an upper bound for other controllers.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.state import OUT_OF_TIME, RUNNING
from surface_gym.tasks.planning import PlanCost

from ..base import Numbers
from ..rollout import Episodes, stack_poses
from . import models, planner

BUDGET = 256  # maximum width of the beam
LEAST = 8  # initial width of the beam, enough for most starts
MORE = 4  # factor of the width after a search without success


@dataclass(frozen=True, eq=False)
class OracleResult:
    """Episode of one start under the best plan found."""

    outcome: str  # outcome of the episode
    time: float  # [s] duration of the episode
    metrics: tuple[float, ...]  # metrics of the task
    poses: Numbers  # (periods + 1, 3) [m, m, rad] true poses
    velocity: Numbers  # (3,) [m/s, m/s, rad/s] at the end
    actions: tuple[int, ...]  # (periods,) actions taken
    width: int  # width of the beam
    seconds: float  # computing time

    @property
    def success(self) -> bool:
        return self.outcome == "success"


class Oracle:
    """Planner of actions "halves" with the true parcel, load, friction, stuck modules and axes.

    It needs no sensors: the outcome of the plan is the result. A search without success is repeated
    with a wider beam, up to the budget.

    Args:
        budget: maximum width of the beam; each node tries every action.
    """

    def __init__(self, config: EnvConfig, budget: int = BUDGET) -> None:
        checks.one_of("actions", config.actions, ("halves",))
        if config.action_kind.continuous:
            raise ValueError(
                f"orientations must be some to choose from, got {config.orientations!r}"
            )
        self._config = config
        # The future is known, so a path is first searched to its end at once. Light parcels leave a
        # path too easily for that. Then it is searched piece by piece.
        task = config.task
        cost = task.cost()
        whole = replace(cost, horizon=task.periods, follow=task.periods)
        self._costs = (whole, cost) if task.has_path else (whole,)
        self._budget = checks.integer("budget", budget, least=1)
        self._models: dict[int, models.TrueModel] = {}

    def find(self, options: dict[str, Any], seed: int) -> OracleResult:
        began = time.perf_counter()
        for cost, width in product(self._costs, self._widths):
            found = self._play(cost, width, options, seed)
            if found.success:
                break
        return replace(found, seconds=time.perf_counter() - began)

    @property
    def _widths(self) -> list[int]:
        """Return the widths of successive searches."""
        widths = [min(LEAST, self._budget)]
        while widths[-1] < self._budget:
            widths.append(min(MORE * widths[-1], self._budget))
        return widths

    def _play(self, cost: PlanCost, width: int, options: dict[str, Any], seed: int) -> OracleResult:
        """Run an episode by plans with a beam width."""
        model = self._model(planner.nodes_needed(cost, width, self._config.action_kind.choices**2))
        model.begin(options, seed)
        poses, actions = [model.parcels.truth[0, :3].copy()], list[int]()
        running, left = True, self._config.task.periods
        while running and len(actions) < left:
            plan = planner.make_plan(model, cost, width)
            for action in plan.actions[: cost.follow].tolist():
                parcels = model.step(action).parcels
                poses.append(parcels.truth[0, :3].copy())
                actions.append(action)
                running = bool(parcels.outcome[0] == RUNNING)
                if not running or len(actions) == left:
                    break
        parcels = model.parcels
        return OracleResult(
            outcome=model.outcomes[OUT_OF_TIME if running else int(parcels.outcome[0])],
            time=float(parcels.clock[0]),
            metrics=tuple(parcels.metrics[0].tolist()),
            poses=np.array(poses),
            velocity=parcels.truth[0, 3:].copy(),
            actions=tuple(actions),
            width=width,
            seconds=0.0,
        )

    def _model(self, size: int) -> models.TrueModel:
        if size not in self._models:
            self._models[size] = models.TrueModel(self._config, size)
        return self._models[size]


def find_reachable(
    config: EnvConfig, starts: Sequence[dict[str, Any]], seed: int, budget: int = BUDGET
) -> list[OracleResult]:
    """Run the oracle with actions "halves" over starts."""
    oracle = Oracle(config, budget)
    return [oracle.find(start, seed + k) for k, start in enumerate(starts)]


def run_oracle(
    config: EnvConfig, starts: Sequence[dict[str, Any]], seed: int, budget: int = BUDGET
) -> Episodes:
    """Run an oracle over starts, like `agents.rollout.run_episodes` for controllers."""
    runs = find_reachable(config, starts, seed, budget)
    metrics = np.array([run.metrics for run in runs]).T
    return Episodes(
        success=np.array([run.success for run in runs]),
        outcome=tuple(run.outcome for run in runs),
        time=np.array([run.time for run in runs]),
        metrics=dict(zip(config.task.metrics, metrics, strict=True)),
        pose=stack_poses([run.poses for run in runs]),
        velocity=np.array([run.velocity for run in runs]),
        decision_times=np.array([run.seconds / len(run.actions) for run in runs]),
    )
